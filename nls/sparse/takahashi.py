r"""Blocks of H^-1 from the Cholesky factor of H, without the rest of the inverse: where H itself has any.

The columns of the factor L are worked on together in supernodes, dense fronts. Column j of L has numbers in the rows
`below` j; the first of them is the parent of j in the elimination tree, and the others are below the parent too. So the
columns of a node, merged into its parent, have no rows outside the parent's:

    front of a supernode = (J, S),   J its columns, S the rows below; S lies inside the front of its parent

Merging stores zeros and saves steps. Two nodes are merged where a model of the time says that it pays.

Source of the elimination tree: J. W. H. Liu, "The role of elimination trees in sparse factorization", SIAM J. Matrix
Anal. Appl. 11 (1990). The merging is C. Ashcraft's and R. Grimes' relaxed supernodes, ACM TOMS 15 (1989), by time.

With H = L L', J the columns of a supernode and S the rows below them, L L' Sigma = I gives, from the last supernode to
the first,

    Y         = L_SJ L_JJ^-1
    Sigma_SJ  = -Sigma_SS Y
    Sigma_JJ  = L_JJ^-T L_JJ^-1 + Y' Sigma_SS Y

Sigma_SS is known: S lies inside the front of the parent, for which all of Sigma has been computed. So one dense matrix
a supernode is all that is kept, and that only until its last child is done. Both terms of Sigma_JJ are positive
semi-definite: nothing cancels.

All 2,500 poses of sphere2500 take 0.3 s of processor time and those of city10000 0.35 s; solving for the columns of
H^-1 takes 80 to 250 times as long (benchmarks/results/marginals.md).

Source: K. Takahashi, J. Fagan, M. Chin, "Formation of a sparse bus impedance matrix", PICA 1973; A. M. Erisman,
W. F. Tinney, "On computing certain elements of the inverse of a sparse matrix", CACM 18 (1975). In fronts it is the
backward pass of the multifrontal method, I. Duff, J. Reid, ACM TOMS 9 (1983).
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index, Mask
from nls.sparse.elimination import first_of_equals
from nls.sparse.fill import refuse_larger, rows_below, tree
from nls.sparse.hessian import Hessian
from nls.sparse.threads import single_thread

STEP, GATHER, FLOP = 60e-6, 3e-9, 0.2e-9  # seconds of one supernode, of one number moved, of one operation


class Supernodes:
    """Supernodes of a symmetric matrix of blocks, in elimination order; no number of the matrix is looked at.

    Parameters
    ----------
    widths : (V,) columns of every block column.
    row, column : (P,) blocks below the diagonal, row > column; repeats allowed.

    Attributes
    ----------
    width, height : (K,) columns of each supernode, and rows below them.
    columns : (n,) columns of L, supernode by supernode; those of number k are columns[first[k] : first[k + 1]].
    node, local : (n,) supernode of every column of L, and its place among the columns of that.
    parent : (K,) supernode whose front holds the rows below; -1 for none.
    children : (K,) how many have this parent.
    """

    def __init__(self, widths: Index, row: Index, column: Index) -> None:
        members, below = _merged(widths, row, column)
        V, K, n = len(widths), len(members), int(widths.sum())
        inside, outside = (np.array([len(rows) for rows in parts]) for parts in (members, below))
        nodes = np.arange(K)
        block_node = np.empty(V, dtype=np.intp)
        block_node[np.concatenate(members)] = np.repeat(nodes, inside)
        self.parent = np.array([block_node[rows[0]] if len(rows) else -1 for rows in below], dtype=np.intp)
        self.children = np.bincount(self.parent[self.parent >= 0], minlength=K)

        # Fronts: the block rows of J and S, one front after the other, then the rows themselves.
        blocks = np.concatenate([part for pair in zip(members, below, strict=True) for part in pair])
        owner = np.repeat(nodes, inside + outside)
        tall = widths[blocks]
        begin = np.cumsum(tall) - tall  # of a block row, in the rows of all fronts
        self._rows = np.repeat((np.cumsum(widths) - widths)[blocks] - begin, tall) + np.arange(int(tall.sum()))
        self._front = np.concatenate([[0], np.cumsum(np.bincount(owner, weights=tall, minlength=K))]).astype(np.intp)
        of_S = np.arange(len(blocks)) - (np.cumsum(inside + outside) - inside - outside)[owner] >= inside[owner]
        self.width = np.bincount(owner[~of_S], weights=tall[~of_S], minlength=K).astype(np.intp)
        self.height = np.diff(self._front) - self.width
        self.first = np.concatenate([[0], np.cumsum(self.width)])
        self.columns = self._rows[np.repeat(~of_S, tall)]
        self.node, self.local = np.empty(n, dtype=np.intp), np.empty(n, dtype=np.intp)
        self.node[self.columns] = np.repeat(nodes, self.width)
        self.local[self.columns] = np.arange(n) - np.repeat(self.first[:-1], self.width)

        # Where the rows S are in the front of the parent: the keys (front, block row) rise.
        up = self.parent[owner[of_S]]
        places = np.searchsorted(owner * V + blocks, up * V + blocks[of_S])
        rows, tall_S = begin[places] - self._front[up], tall[of_S]
        ends = np.cumsum(tall_S)
        self._place = np.repeat(rows - (ends - tall_S), tall_S) + np.arange(int(tall_S.sum()))
        self._below = np.concatenate([[0], np.cumsum(self.height)])

    def __len__(self) -> int:
        return len(self.width)

    def rows(self, k: int) -> Index:
        """Rows of L in the front of supernode k: its columns, then the rows below."""
        return self._rows[self._front[k] : self._front[k + 1]]

    def below(self, k: int) -> Index:
        """Where the rows below supernode k are in the front of its parent."""
        return self._place[self._below[k] : self._below[k + 1]]

    def place_below(self, k: Index, row: Index) -> Index:
        """Places of rows of L, given by (p,) supernode and row, among those below these supernodes, from 0."""
        rows = np.repeat(np.arange(len(self)), np.diff(self._front)) * len(self.node) + self._rows  # rising
        return np.searchsorted(rows, k * len(self.node) + row) - self._front[k] - self.width[k]

    @property
    def numbers(self) -> int:
        """Most numbers in fronts that are needed at one time, from the last supernode to the first."""
        size = ((self.width + self.height) ** 2).tolist()
        waiting, now, most = self.children.tolist(), 0, 0
        for k in range(len(self) - 1, -1, -1):
            now += size[k]
            most = max(most, now)
            if not waiting[k]:
                now -= size[k]
            p = int(self.parent[k])
            if p >= 0:
                waiting[p] -= 1
                if not waiting[p]:
                    now -= size[p]
        return most


def _merged(widths: Index, row: Index, column: Index) -> tuple[list[Index], list[Index]]:
    """Block columns of every supernode and block rows below them, both rising, by the last block column of each."""
    order = np.lexsort((column, row))
    row, column = row[order], column[order]
    members = _together(widths, rows_below(widths, row, column), tree(row, column, len(widths)))
    node = np.empty(len(widths), dtype=np.intp)
    node[np.concatenate(members)] = np.arange(len(members)).repeat([len(J) for J in members])
    order = np.argsort(node[column], kind="stable")
    rows = np.split(row[order], np.cumsum(np.bincount(node[column], minlength=len(members)))[:-1])
    inside: list[list[Index]] = [[J, S] for J, S in zip(members, rows, strict=True)]  # and what children have below
    below = []
    for J, parts in zip(members, inside, strict=True):
        S = np.unique(np.concatenate(parts))
        below.append(S[S > J[-1]])
        if len(below[-1]):
            inside[node[below[-1][0]]].append(below[-1])
    return members, below


def _together(widths: Index, below: Index, parent: list[int]) -> list[Index]:
    """Block columns of every supernode, rising: a child joins its parent in the tree where that saves time.

    The loop over block columns takes 10 ms for sphere2500.
    """
    width, height = widths.tolist(), below.tolist()
    V = len(width)
    members: list[list[int]] = [[j] for j in range(V)]
    seconds = [0.0] * V
    children: list[list[int]] = [[] for _ in range(V)]
    for j in range(V):
        now = _seconds(width[j], height[j])
        for child in children[j]:
            merged = _seconds(width[j] + width[child], height[j])
            if merged < now + seconds[child]:
                now = merged
                width[j] += width[child]
                members[j] += members[child]
                members[child] = []
        seconds[j] = now
        if parent[j] >= 0:
            children[parent[j]].append(j)
    return [np.array(sorted(J)) for J in members if J]


def _seconds(w: int, h: int) -> float:
    """Time a supernode of w columns and h rows below takes in the recursion of `nls.sparse.takahashi`."""
    return STEP + GATHER * (h * h + 0.5 * (w + h) ** 2) + FLOP * (2 * h * h * w + 3 * h * w * w + w * w * w)


def supernodes(hessian: Hessian, p: Index) -> Supernodes:
    """Supernodes of L with H[p][:, p] = L L', the columns of H in the order in which they were given."""
    dims, V = hessian.dims, len(hessian.dims)
    owner = np.repeat(np.arange(V), dims)[p]
    eliminated = owner[first_of_equals(owner)]  # every variable once
    position = np.empty(V, dtype=np.intp)
    position[eliminated] = np.arange(V)
    u, v = position[hessian.elimination.u], position[hessian.elimination.v]
    return Supernodes(dims[eliminated], np.maximum(u, v), np.minimum(u, v))


def inverse_blocks(
    nodes: Supernodes, L: sp.csc_array, p: Index, dims: Index, i: Index, j: Index, memory_limit: float
) -> Array:
    """Blocks (i, j) of H^-1, (d_i, d_j) row by row, one after the other.

    Parameters
    ----------
    nodes : the supernodes of L.
    L, p : with H[p][:, p] = L L', the columns of H in the order in which they were given.
    dims : (V,) columns of every variable.
    i, j : (k,) variables; any two that share a block, or one twice.
    memory_limit : bytes the dense fronts may take.

    Raises
    ------
    ResourceLimitError
        They would take more.
    """
    needed = 8.0 * (nodes.numbers + 2 * int(((nodes.width + nodes.height) ** 2).max()) + 4 * L.nnz)
    words = f"the marginal covariances of {len(dims)} variables need"
    cure = "ask for single variables, or raise memory_limit"
    refuse_larger(needed, memory_limit, "marginal covariances", words, cure)
    place = np.empty(len(p), dtype=np.intp)
    place[p] = np.arange(len(p))
    start, size = place[np.cumsum(dims) - dims], dims[i] * dims[j]
    offset, inside = np.cumsum(size) - size, nodes.node[start[i]] == nodes.node[start[j]]
    Sigma = np.empty(int(size.sum()))
    parts = [_places(nodes, start, dims, i, j, offset, pairs) for pairs in (inside, ~inside)]
    import_module("scipy.linalg.lapack")  # its BLAS must be there before single_thread looks for it
    with single_thread():
        for k, *blocks in takahashi(L, nodes):
            for (source, target, first), block in zip(parts, blocks, strict=True):
                span = slice(first[k], first[k + 1])
                Sigma[target[span]] = np.take(block, source[span])
    return Sigma


class DenseColumns:
    """The columns of L, lower triangular without a zero pivot, supernode by supernode."""

    def __init__(self, L: sp.csc_array, nodes: Supernodes) -> None:
        self._nodes, self._columns = nodes, sp.csc_array(L[:, nodes.columns])
        self._local = np.repeat(nodes.local[nodes.columns], np.diff(self._columns.indptr))
        self._where = np.empty(L.shape[0], dtype=np.intp)

    def of(self, k: int) -> tuple[Array, Array]:
        """L_JJ^-1 (w, w) and L_SJ (h, w) of supernode k."""
        from scipy.linalg.lapack import dtrtri

        nodes, columns = self._nodes, self._columns
        w, rows = int(nodes.width[k]), nodes.rows(k)
        self._where[rows] = np.arange(len(rows))
        entries = slice(columns.indptr[nodes.first[k]], columns.indptr[nodes.first[k + 1]])
        L_J = np.zeros((len(rows), w))
        L_J.reshape(-1)[self._where[columns.indices[entries]] * w + self._local[entries]] = columns.data[entries]
        return dtrtri(L_J[:w].T, lower=0)[0].T, L_J[
            w:
        ]  # the transpose of a C array is what LAPACK takes without a copy


def takahashi(L: sp.csc_array, nodes: Supernodes) -> Iterator[tuple[int, Array, Array]]:
    """Sigma_JJ (w, w), symmetric, and Sigma_SJ (h, w) of every supernode k, the last first.

    Parameters
    ----------
    L : lower triangular, no zero pivot.
    nodes : its supernodes.
    """
    waiting, columns = nodes.children.tolist(), DenseColumns(L, nodes)
    fronts: list[Array | None] = [None] * len(nodes)
    for k in range(len(nodes) - 1, -1, -1):
        w, h, parent = int(nodes.width[k]), int(nodes.height[k]), int(nodes.parent[k])
        L_JJ_inv, L_SJ = columns.of(k)
        Sigma_JJ, Sigma_SJ = L_JJ_inv.T @ L_JJ_inv, L_SJ
        if h:
            Y = L_SJ @ L_JJ_inv
            Sigma_SS = _submatrix(fronts[parent], nodes.below(k))
            Sigma_SJ = -Sigma_SS @ Y
            Sigma_JJ -= Y.T @ Sigma_SJ
            waiting[parent] -= 1
            if not waiting[parent]:
                fronts[parent] = None
        Sigma_JJ = (Sigma_JJ + Sigma_JJ.T) / 2
        if waiting[k]:
            front = fronts[k] = np.empty((w + h, w + h))
            front[:w, :w] = Sigma_JJ
            if h:
                front[w:, :w], front[:w, w:], front[w:, w:] = Sigma_SJ, Sigma_SJ.T, Sigma_SS
        yield k, Sigma_JJ, Sigma_SJ


def _submatrix(front: Array | None, place: Index) -> Array:
    """Rows and columns of a front: a view where they follow each other."""
    assert front is not None
    begin, end = int(place[0]), int(place[-1]) + 1
    if end - begin == len(place):
        return front[begin:end, begin:end]
    return np.asarray(front[place[:, None], place])


def _places(
    nodes: Supernodes, start: Index, dims: Index, i: Index, j: Index, offset: Index, pairs: Mask
) -> tuple[Index, Index, Index]:
    """Where the numbers of some blocks are in the Sigma_JJ of their supernode, or in its Sigma_SJ, and where they go.

    Parameters
    ----------
    nodes : the supernodes.
    start : (V,) first column of every variable in L.
    dims : (V,) sizes of the variables.
    i, j : (p,) variables of the blocks.
    offset : (p,) where the numbers of a block go, by rows.
    pairs : (p,) those that are meant: all in one supernode, or none.

    Returns
    -------
    source, target, first : supernode k has the numbers first[k] to first[k + 1].
    """
    k = np.flatnonzero(pairs)
    turned = start[i[k]] < start[j[k]]  # the later one is the row
    row, column = start[np.where(turned, j[k], i[k])], start[np.where(turned, i[k], j[k])]
    node = nodes.node[column]
    same = nodes.node[row] == node
    row = nodes.local[row] if same.all() else nodes.place_below(node, row)
    order = np.argsort(node, kind="stable")
    k, turned, node, row, column = k[order], turned[order], node[order], row[order], nodes.local[column[order]]
    height, width = np.where(turned, dims[j[k]], dims[i[k]]), np.where(turned, dims[i[k]], dims[j[k]])
    size = height * width
    begin = np.cumsum(size) - size
    source, target = np.empty(int(size.sum()), dtype=np.intp), np.empty(int(size.sum()), dtype=np.intp)
    base = int(dims.max(initial=0)) + 1
    shapes = (height * base + width) * 2 + turned
    for shape in np.flatnonzero(np.bincount(shapes)):
        (h, w), back = divmod(int(shape) // 2, base), bool(shape % 2)
        q = np.flatnonzero(shapes == shape)
        r, c = (grid.reshape(-1) for grid in np.indices((h, w)))
        inner = begin[q, None] + np.arange(h * w)
        source[inner] = (row[q, None] + r) * nodes.width[node[q], None] + column[q, None] + c
        target[inner] = offset[k[q], None] + (c * h + r if back else r * w + c)
    counts = np.bincount(node, weights=size, minlength=len(nodes))
    return source, target, np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
