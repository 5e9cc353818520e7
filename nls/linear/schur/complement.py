r"""The Schur complement of a block-diagonal part of H, block by block, without forming anything dense.

::

    H = [ H_ll  H_lp ]     H_ll block diagonal:  X_l' X_l = H_ll^-1  for every l on its own
        [ H_pl  H_pp ]     Y_lp = X_l H_lp       for every pair l, p that shares a factor

    S_pq = H_pq - sum_l Y_lp' Y_lq               over the l that p and q both share a factor with

With X_l the inverse of the Cholesky factor of H_ll nothing grows where a landmark is weakly determined: Y'Y is part of
H_pp and no larger. (H_pl H_ll^-1 H_lp as it is written passes through numbers as large as the condition of H_ll.)

Which pairs (Y_lp, Y_lq) make which S_pq is listed once per graph. All S_pq of one shape with lists of one length are
one stacked product. The lists are filled up to one of the lengths 1, 2, 3, 4, 6, 8, 12, ... with a block of zeros. So
there are few stacked products however many lengths there are. Variables p that see the same l, a camera and its lens,
count as one with both their columns. So there are a fourth of the pairs, and half of the numbers to be gathered.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import sparse as sp

from models.algebra import Array, Index
from nls.linear.schur.inverses import BlockInverse, cholesky_root, inverse_root
from nls.sparse.elimination import Elimination, first_of_equals
from nls.sparse.hessian import Hessian, triangle


class Products(NamedTuple):
    """Stacked products of one shape: block `target` of S loses sum_k Y[first[., k]]' Y[second[., k]]."""

    first: npt.NDArray[np.int32]  # (m, length), which of the Y_lp of its dimension
    second: npt.NDArray[np.int32]
    target: Index  # (m,)
    shape: tuple[int, int]


class Pairs:
    """All pairs of neighbors of every eliminated variable, by the block of S they belong to.

    Parameters
    ----------
    l, p : (n,) neighbors p of every l, by rising l and then p, each once.
    count, groups : how many l and p there are.
    own : only the pairs of a neighbor with itself, which make the diagonal blocks of S.

    Attributes
    ----------
    first, second : (pairs,) places in l and p; the p of the second is not above that of the first.
    length, high, low : (blocks,) how many pairs every block of S has, one block after the other, and its p.
    """

    def __init__(self, l: Index, p: Index, count: int, groups: int, own: bool = False) -> None:
        if own:
            first = second = np.arange(len(l), dtype=np.int32)
        else:
            first, second = _all_pairs(l)
        block = p[first] * groups + p[second]
        order = np.argsort(block, kind="stable")
        block = block[order]
        begins = np.flatnonzero(first_of_equals(block))
        self.first, self.second = first[order], second[order]
        self.length = np.diff(np.append(begins, len(block)))
        self.count = count
        self.high, self.low = np.divmod(block[begins], max(groups, 1))

    def products(self, height: Index, dims: Index, target: Index) -> list[Products]:
        """The pairs as stacked products.

        Parameters
        ----------
        height : (n,) dimension of the p of every pair (l, p), which are counted anew for each dimension.
        dims : dimension of every p.
        target : where every block of S begins.
        """
        local = np.empty(len(height), dtype=np.int32)
        dummy = {}
        for D in np.unique(height):
            same = np.flatnonzero(height == D)
            local[same], dummy[int(D)] = np.arange(len(same)), len(same)
        filled, base = _filled_up(self.length), int(dims.max(initial=0)) + 1
        shape = (filled * base + dims[self.high]) * base + dims[self.low]
        within = np.arange(len(self.first)) - np.repeat(np.cumsum(self.length) - self.length, self.length)
        every, out = np.repeat(shape, self.length), []
        for code in np.unique(shape):
            high_digits, C = divmod(int(code), base)
            length, D = divmod(high_digits, base)
            blocks, pairs = np.flatnonzero(shape == code), np.flatnonzero(every == code)
            at = np.repeat(np.arange(len(blocks)), self.length[blocks]) * length + within[pairs]
            sides = []
            for side, size in ((self.first, D), (self.second, C)):
                index = np.full(len(blocks) * length, dummy[size], dtype=np.int32)
                index[at] = local[side[pairs]]
                sides.append(index.reshape(-1, length))
            out.append(Products(sides[0], sides[1], target[blocks], (D, C)))
        return out


def _all_pairs(l: Index) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Places in l, rising, of the two members of every pair with one l, the second not behind the first."""
    degree = np.bincount(l)
    begin = np.cumsum(degree) - degree
    firsts, seconds = [np.zeros(0, dtype=np.int32)], [np.zeros(0, dtype=np.int32)]
    for k in np.flatnonzero(np.bincount(degree)):
        i, j = np.tril_indices(int(k))
        at = begin[degree == k, None]
        firsts.append((at + i).reshape(-1).astype(np.int32))
        seconds.append((at + j).reshape(-1).astype(np.int32))
    return np.concatenate(firsts), np.concatenate(seconds)


def _filled_up(length: Index) -> Index:
    """The next of 1, 2, 3, 4, 6, 8, 12, 16, ..., at most a third longer."""
    power = 1 << np.ceil(np.log2(np.maximum(length, 1))).astype(np.intp)
    return np.where(length <= 3 * power // 4, np.maximum(3 * power // 4, 1), power)


CHUNK = 1 << 17  # numbers of Y gathered at a time, 1 MB; for 2 million pairs 0.31 s up to 2 MB, 0.52 with 128


class Group(NamedTuple):
    """Eliminated variables of one dimension d, one after the other in the order of elimination."""

    d: int
    columns: slice
    diagonal: Index  # (k, d, d): places of their blocks of H_ll among the numbers of H
    owner: dict[int, Index]  # by dimension D of the others: which of the k every pair (l, p) belongs to
    place: dict[int, Index]  # (pairs, d, D): places of H_lp
    products: list[Products]


class Filled(NamedTuple):
    """The numbers of one H.

    Attributes
    ----------
    flat : the flat blocks of S.
    L : (n + the others, n), the first columns of the Cholesky factor of H; those of an inverse that was given have no
        L_ll, and zeros there.
    roots : X_l (k, d, d), by dimension d.
    pivots : (n,) squared pivots of H_ll.
    H_pp : its lower triangle.
    """

    flat: Array
    L: sp.csc_array
    roots: list[Array]
    pivots: Array
    H_pp: sp.csc_array


class Complement:
    """Structure and numbers of S.

    Parameters
    ----------
    hessian : structure of H, in its order the eliminated variables first, by dimension.
    gone : how many variables are eliminated.
    block_inverse : None for the exact inverse.
    group : (kept,) a number for every variable that is kept, equal ones next to each other. Equal are those that see
        the same eliminated ones; their columns make one block of S.
    diagonal : form the diagonal blocks of S alone.

    Attributes
    ----------
    hessian : structure of S, or of its diagonal blocks, one variable a group.
    n : eliminated columns.
    """

    def __init__(
        self,
        hessian: Hessian,
        gone: int,
        group: Index,
        block_inverse: BlockInverse | None = None,
        diagonal: bool = False,
    ) -> None:
        e, self._block_inverse, self._whole = hessian.elimination, block_inverse, hessian
        widths = hessian.dims[e.variables]
        self.n = int(widths[:gone].sum())
        member = np.cumsum(first_of_equals(group)) - 1  # group of every variable that is kept, in their order
        dims = np.bincount(member, weights=widths[gone:]).astype(np.intp)
        groups = len(dims)

        # Every pair (l, p) once, p the groups from here on, and the rows of H between the diagonal block of l and H_pl.
        row, column = e.row[e.blocks], e.column[e.blocks]
        lp = column < gone
        l, p, height = column[lp], member[row[lp] - gone], widths[row[lp]]
        total = np.bincount(l, weights=height, minlength=gone).astype(np.intp)
        above = np.cumsum(height) - height - (np.cumsum(total) - total)[l]
        starts_pair = first_of_equals(l) | first_of_equals(p)
        l, p, above = l[starts_pair], p[starts_pair], above[starts_pair]
        height = dims[p]

        # Pairs (Y_lp, Y_lq) by dimension of l, and the blocks of S that they or H_pp fill.
        ranges = [(int(d), *np.searchsorted(widths[:gone], [d, d + 1])) for d in np.unique(widths[:gone])]
        mine = [slice(*np.searchsorted(l, [begin, end])) for _, begin, end in ranges]
        every = [
            Pairs(l[m] - r[1], p[m], int(r[2] - r[1]), groups, diagonal) for r, m in zip(ranges, mine, strict=True)
        ]
        owner = np.repeat(member, widths[gone:])  # of every column that is kept
        i, j = hessian.indices[hessian.indptr[self.n] :] - self.n, np.arange(len(owner))
        j = np.repeat(j, np.diff(hessian.indptr[self.n :]))
        block = owner[i] * groups + owner[j]
        place = np.arange(groups) * (groups + 1)
        if not diagonal:
            place = np.unique(np.concatenate([place, block, *(q.high * groups + q.low for q in every)]))
        high, low = np.divmod(place, max(groups, 1))
        first = np.cumsum(dims[high] * dims[low])
        self.size = int(first[-1]) if groups else 0
        first -= dims[high] * dims[low]
        off = high != low
        self.hessian = Hessian(Elimination(high[off], low[off], groups, None), dims, first[~off], first[off])

        # Where in S the numbers of H_pp are.
        inner = np.arange(len(owner)) - (np.cumsum(dims) - dims)[owner]
        self._same = owner[i] == owner[j] if diagonal else np.ones(len(i), dtype=bool)
        i, j, block = i[self._same], j[self._same], block[self._same]
        self._target = first[np.searchsorted(place, block)] + inner[i] * dims[owner[j]] + inner[j]

        self.groups = []
        for (d, begin, _), m, pairs in zip(ranges, mine, every, strict=True):
            products = pairs.products(height[m], dims, first[np.searchsorted(place, pairs.high * groups + pairs.low)])
            columns = int(widths[:begin].sum()) + np.arange(pairs.count * d)
            tops = hessian.indptr[columns].astype(np.intp).reshape(-1, d)  # where their diagonal numbers are
            self.groups.append(_group(d, columns, tops, l[m] - begin, height[m], above[m], products))

    def fill(self, S: Array) -> Filled:
        """From the flat blocks of H.

        Raises
        ------
        SingularSystemError
            A block of H_ll.
        """
        H = self._whole.data(S)
        out, pivots = np.zeros(self.size), np.empty(self.n)
        cut = int(self._whole.indptr[self.n])
        out[self._target] = H[cut:][self._same]
        below, roots = np.zeros(cut), []
        for group in self.groups:
            H_ll = H[group.diagonal]
            block = pivots[group.columns].reshape(-1, group.d)
            if self._block_inverse is None:
                L_ll, X, block[:] = cholesky_root(H_ll)
                r, c = triangle(group.d)
                below[group.diagonal[:, r, c]] = L_ll[:, r, c]
            else:
                X, known = inverse_root(self._block_inverse, H_ll), H_ll.diagonal(axis1=1, axis2=2)
                block[:] = np.where(known > 0, known, 1.0)  # passed whatever it is: these blocks are not judged
            roots.append(X)
            Y = {}
            for D, place in group.place.items():
                Y[D] = np.zeros((len(place) + 1, group.d, D))  # the last one fills up the lists
                np.matmul(X[group.owner[D]], H[place], out=Y[D][:-1])
                below[place] = Y[D][:-1]
            for products in group.products:
                _subtract(out, products, Y, group.d)
        n, indices, indptr = self.n, self._whole.indices, self._whole.indptr
        L = sp.csc_array((below, indices[:cut], indptr[: n + 1]), shape=(self._whole.n, n))
        size = self._whole.n - n
        H_pp = sp.csc_array((H[cut:], indices[cut:] - n, indptr[n:] - cut), shape=(size, size))
        return Filled(out, L, roots, pivots, H_pp)


def _group(
    d: int, columns: Index, tops: Index, owner: Index, height: Index, above: Index, products: list[Products]
) -> Group:
    """Where the numbers of the blocks of one dimension are.

    Parameters
    ----------
    columns, tops : (k d,) of H, and (k, d) where in its numbers they begin, each with its diagonal entry.
    owner, height, above : (pairs,) of H_lp: which of the k, its dimension, and the rows between it and H_ll.
    """
    r = np.arange(d)
    diagonal = tops[:, np.minimum(r[:, None], r)] + np.abs(r[:, None] - r)
    owners, places = {}, {}
    for D in np.unique(height):
        same = np.flatnonzero(height == D)
        owners[int(D)] = owner[same]
        begins = tops[owner[same]] + (d - r) + above[same, None]
        places[int(D)] = begins[:, :, None] + np.arange(D)
    return Group(d, slice(int(columns[0]), int(columns[-1]) + 1), diagonal, owners, places, products)


def _subtract(out: Array, products: Products, Y: dict[int, Array], d: int) -> None:
    """Subtract stacked products from blocks of S, as many at a time as `CHUNK` allows."""
    first, second, target, (D, C) = products
    inner, inside = first.shape[1] * d, np.arange(D * C)
    step = max(1, CHUNK // (inner * (D + C)))
    for begin in range(0, len(target), step):
        rows = slice(begin, begin + step)
        Y_p = Y[D].take(first[rows], axis=0, mode="clip").reshape(-1, inner, D)
        Y_q = Y[C].take(second[rows], axis=0, mode="clip").reshape(-1, inner, C)
        out[target[rows, None] + inside] -= np.matmul(Y_p.mT, Y_q).reshape(-1, D * C)
