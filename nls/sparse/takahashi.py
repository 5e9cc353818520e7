r"""Blocks of H^-1 from the Cholesky factor of H, without the rest of the inverse: where H itself has any.

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
from models.errors import ResourceLimitError
from nls.sparse.elimination import first_of_equals
from nls.sparse.hessian import Hessian
from nls.sparse.supernodes import Supernodes
from nls.sparse.threads import single_thread

__all__ = ["inverse_blocks", "supernodes"]


def supernodes(hessian: Hessian, p: Index) -> Supernodes:
    """Those of L with H[p][:, p] = L L', the columns of H in the order in which they were given."""
    dims, V = hessian.dims, len(hessian.dims)
    owner = np.repeat(np.arange(V), dims)[p]
    eliminated = owner[first_of_equals(owner)]  # every variable once
    position = np.empty(V, dtype=np.intp)
    position[eliminated] = np.arange(V)
    u, v = position[hessian.elimination.u], position[hessian.elimination.v]
    return Supernodes(dims[eliminated], np.maximum(u, v), np.minimum(u, v))


def inverse_blocks(
    nodes: Supernodes, dims: Index, L: sp.csc_array, p: Index, i: Index, j: Index, memory_limit: float
) -> Array:
    """Blocks (i, j) of H^-1, (d_i, d_j) row by row, one after the other.

    Parameters
    ----------
    nodes : the supernodes of L.
    dims : (V,) columns of every variable.
    L, p : with H[p][:, p] = L L', the columns of H in the order in which they were given.
    i, j : (k,) variables; any two that share a block, or one twice.
    memory_limit : bytes the dense fronts may take.

    Raises
    ------
    ResourceLimitError
        They would take more.
    """
    needed = 8.0 * (nodes.numbers + 2 * int(((nodes.width + nodes.height) ** 2).max()) + 4 * L.nnz)
    if needed > memory_limit:
        raise ResourceLimitError(
            f"the marginal covariances of {len(dims)} variables need {needed / 1e9:.1f} GB, the limit is "
            f"{memory_limit / 1e9:.1f} GB; ask for single variables, or raise memory_limit",
            needed,
            memory_limit,
            "marginal covariances",
        )
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


def takahashi(L: sp.csc_array, nodes: Supernodes) -> Iterator[tuple[int, Array, Array]]:
    """Sigma_JJ (w, w), symmetric, and Sigma_SJ (h, w) of every supernode k, the last first.

    Parameters
    ----------
    L : lower triangular, no zero pivot.
    nodes : its supernodes.
    """
    from scipy.linalg.lapack import dtrtri

    columns = sp.csc_array(L[:, nodes.columns])
    data, rows, indptr = columns.data, columns.indices, columns.indptr
    local = np.repeat(nodes.local[nodes.columns], np.diff(indptr))
    where, waiting = np.empty(L.shape[0], dtype=np.intp), nodes.children.tolist()
    fronts: list[Array | None] = [None] * len(nodes)
    for k in range(len(nodes) - 1, -1, -1):
        w, h, parent = int(nodes.width[k]), int(nodes.height[k]), int(nodes.parent[k])
        where[nodes.rows(k)] = np.arange(w + h)
        entries = slice(indptr[nodes.first[k]], indptr[nodes.first[k + 1]])
        L_J = np.zeros((w + h, w))
        L_J.reshape(-1)[where[rows[entries]] * w + local[entries]] = data[entries]
        L_JJ_inv = dtrtri(L_J[:w].T, lower=0)[0].T  # the transpose of a C array is what LAPACK takes without a copy
        Sigma_JJ, Sigma_SJ = L_JJ_inv.T @ L_JJ_inv, L_J[w:]
        if h:
            Y = L_J[w:] @ L_JJ_inv
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
