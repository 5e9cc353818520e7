r"""The Schur complement of a block-diagonal part of H, block by block, without forming anything dense.

    H = [ H_ll  H_lp ]     H_ll block diagonal:  X_l' X_l = H_ll^-1  for every l on its own
        [ H_pl  H_pp ]     Y_lp = X_l H_lp       for every pair l, p that shares a factor

    S_pq = H_pq - sum_l Y_lp' Y_lq               over the l that p and q both share a factor with

With X_l the inverse of the Cholesky factor of H_ll nothing grows where a landmark is weakly determined: Y'Y is part of
H_pp and no larger. (H_pl H_ll^-1 H_lp as it is written passes through numbers as large as the condition of H_ll.)

Which pairs (Y_lp, Y_lq) make which S_pq is listed once per graph. All S_pq of one shape with lists of one length are
one stacked product (`nls.linear.pairs`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from models.algebra import Array
from nls.elimination import Elimination
from nls.hessian import Hessian, triangle
from nls.linear.pairs import Pairs, Products
from nls.linear.roots import BlockInverse, cholesky_root, inverse_root

if TYPE_CHECKING:
    from nls.elimination import Index
    from nls.hessian import Blocks

__all__ = ["Complement"]

CHUNK = 1 << 17  # numbers of Y gathered at a time, 1 MB; for 2 million pairs 0.31 s up to 2 MB, 0.52 with 128


@dataclass(frozen=True)
class Group:
    """Eliminated variables of one dimension d, one after the other in the order of elimination."""

    d: int
    columns: slice
    diagonal: Index  # (k, d, d): places of their blocks of H_ll among the numbers of H
    owner: dict[int, Index]  # by dimension D of the others: which of the k every pair (l, p) belongs to
    place: dict[int, Index]  # (pairs, d, D): places of H_lp
    products: list[Products]


class Complement:
    """Structure and numbers of S.

    Parameters
    ----------
    blocks : the variables, and which of them share a factor.
    elimination : the order of all variables, the eliminated ones first, by dimension.
    gone : how many variables are eliminated.
    hessian : structure of H in that order.
    block_inverse : None for the exact inverse.

    Attributes
    ----------
    hessian : structure of S.
    n : eliminated columns.
    """

    def __init__(
        self, blocks: Blocks, elimination: Elimination, gone: int, hessian: Hessian, block_inverse: BlockInverse | None
    ) -> None:
        e, self._block_inverse, self._whole, self.size = elimination, block_inverse, hessian, blocks.size
        widths, kept = blocks.dims[e.variables], len(e.variables) - gone
        dims, diagonal = widths[gone:], blocks.diagonal[e.variables[gone:]]
        self.n = int(widths[:gone].sum())

        # Every pair (l, p) once, and the rows of H between the diagonal block of l and H_pl.
        row, column = e.row[e.blocks], e.column[e.blocks]
        lp = column < gone
        l, p, height = column[lp], row[lp] - gone, widths[row[lp]]
        total = np.bincount(l, weights=height, minlength=gone).astype(np.intp)
        above = np.cumsum(height) - height - (np.cumsum(total) - total)[l]

        # Pairs (Y_lp, Y_lq) by dimension of l; the blocks of S that they fill go behind those of H.
        ranges = [(int(d), *np.searchsorted(widths[:gone], [d, d + 1])) for d in np.unique(widths[:gone])]
        mine = [slice(*np.searchsorted(l, [begin, end])) for _, begin, end in ranges]
        every = [Pairs(l[m] - r[1], p[m], int(r[2] - r[1]), kept) for r, m in zip(ranges, mine, strict=True)]
        off = [pairs.high != pairs.low for pairs in every]
        filled = [pairs.high[o] * kept + pairs.low[o] for pairs, o in zip(every, off, strict=True)]
        place = np.unique(np.concatenate([*filled, np.zeros(0, dtype=np.intp)]))
        high, low = np.divmod(place, max(kept, 1))
        ends = blocks.size + np.cumsum(dims[high] * dims[low])
        first, self.total = ends - dims[high] * dims[low], int(ends[-1]) if len(ends) else blocks.size

        self.groups = []
        for (d, begin, _), m, pairs, o, here in zip(ranges, mine, every, off, filled, strict=True):
            target = np.empty(len(o), dtype=np.intp)
            target[~o] = diagonal[pairs.high[~o]]
            target[o] = first[np.searchsorted(place, here)]
            products = pairs.products(height[m], dims, target)
            columns = int(widths[:begin].sum()) + np.arange(pairs.count * d)
            tops = hessian.indptr[columns].astype(np.intp).reshape(-1, d)  # where their diagonal numbers are
            self.groups.append(_group(d, columns, tops, l[m] - begin, height[m], above[m], products))

        # S has the pairs of H that are kept, and the filled ones.
        position = np.empty(len(e.variables), dtype=np.intp)
        position[e.variables] = np.arange(-gone, kept)
        u, v = position[blocks.u], position[blocks.v]
        both = (u >= 0) & (v >= 0)
        u, v = np.concatenate([u[both], high]), np.concatenate([v[both], low])
        self.hessian = Hessian(Elimination(u, v, kept, None), dims, diagonal, np.concatenate([blocks.off[both], first]))

    def fill(self, S: Array) -> tuple[Array, sp.csc_array, list[Array], Array]:
        """From the flat blocks of H.

        Returns
        -------
        flat : the flat blocks of S.
        L : (n + the others, n), the first columns of the Cholesky factor of H; those of an inverse that was given have
            no L_ll, and zeros there.
        roots : X_l (k, d, d), by group.
        pivots : (n,) squared pivots of H_ll.

        Raises
        ------
        SingularSystemError
            A block of H_ll.
        """
        H = self._whole.data(S)
        out, pivots = np.zeros(self.total), np.empty(self.n)
        out[: self.size] = S
        cut = int(self._whole.indptr[self.n])
        below, roots = np.zeros(cut), []
        for group in self.groups:
            H_ll = H[group.diagonal]
            here = pivots[group.columns].reshape(-1, group.d)
            if self._block_inverse is None:
                L_ll, X, here[:] = cholesky_root(H_ll)
                r, c = triangle(group.d)
                below[group.diagonal[:, r, c]] = L_ll[:, r, c]
            else:
                X, known = inverse_root(self._block_inverse, H_ll), H_ll.diagonal(axis1=1, axis2=2)
                here[:] = np.where(known > 0, known, 1.0)  # passed whatever it is: these blocks are not judged
            roots.append(X)
            Y = {}
            for D, place in group.place.items():
                Y[D] = np.zeros((len(place) + 1, group.d, D))  # the last one fills up the lists
                np.matmul(X[group.owner[D]], H[place], out=Y[D][:-1])
                below[place] = Y[D][:-1]
            for products in group.products:
                _subtract(out, products, Y, group.d)
        L = sp.csc_array(
            (below, self._whole.indices[:cut], self._whole.indptr[: self.n + 1]), shape=(self._whole.n, self.n)
        )
        return out, L, roots, pivots


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
        part = slice(begin, begin + step)
        Y_p = Y[D].take(first[part], axis=0, mode="clip").reshape(-1, inner, D)
        Y_q = Y[C].take(second[part], axis=0, mode="clip").reshape(-1, inner, C)
        out[target[part, None] + inside] -= np.matmul(Y_p.mT, Y_q).reshape(-1, D * C)
