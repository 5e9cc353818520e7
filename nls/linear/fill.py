r"""Size of a Cholesky factor before it is computed: no number of the matrix is looked at.

Row i of L has a number in column j when j lies on the way from a neighbor of i (eliminated before it) up the
elimination tree to i. So column j is counted by summing over its subtree

    + w_i  at every neighbor of i and at i itself,
    - w_i  where the ways of two neighbors, next to each other in postorder, meet
    - w_i  at the parent of i

with w_i the rows of block row i. The tree takes one loop over the pairs of variables, the rest is arrays: 0.2 s for
100,000 poses in the plane with 160,000 measurements, where ordering and analyzing take 0.46 s.

Sources: J. Liu, "A compact row storage scheme for Cholesky factors using elimination trees", ACM TOMS 12 (1986);
J. Gilbert, E. Ng, B. Peyton, "An efficient algorithm to compute row and column counts for sparse Cholesky
factorization", SIAM J. Matrix Anal. Appl. 15 (1994).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

if TYPE_CHECKING:
    import numpy.typing as npt

    from nls.assemble import Pattern
    from nls.elimination import Index

__all__ = ["Fill", "counted", "fill_in", "rows_below"]


@dataclass(frozen=True)
class Fill:
    """Numbers in R, and multiplications and additions to compute it."""

    nnz: int
    flops: float


def fill_in(pattern: Pattern, held: npt.NDArray[np.bool_]) -> Fill:
    """Fill of R with A'A = R'R, in the order the default solver would eliminate the variables that are not held."""
    from nls.elimination import eliminated
    from nls.linear import best_factorization

    free = np.flatnonzero(~held)
    number = np.full(len(held), -1, dtype=np.intp)
    number[free] = np.arange(len(free))
    pairs = [
        (number[a], number[b]) for f in pattern.batches for k, a in enumerate(f.variables) for b in f.variables[k + 1 :]
    ]
    none = np.zeros(0, dtype=np.intp)
    u, v = (np.concatenate([none, *(p[s] for p in pairs)]) for s in (0, 1))
    both = (u >= 0) & (v >= 0)
    u, v = u[both], v[both]
    order = eliminated(u, v, len(free), best_factorization().order).variables if len(free) else none
    return counted(pattern.dims[free], u, v, order)


def counted(dims: Index, u: Index, v: Index, eliminated: Index) -> Fill:
    """Fill of R when variables are eliminated in an order.

    Parameters
    ----------
    dims : (V,) sizes of the variables.
    u, v : (P,) variables that share a factor, u != v; repeats allowed.
    eliminated : (V,) the variables in their order.
    """
    if not len(dims):
        return Fill(0, 0.0)
    position = np.empty(len(dims), dtype=np.intp)
    position[eliminated] = np.arange(len(dims))
    u, v, widths = position[u], position[v], dims[eliminated]
    below = rows_below(widths, np.maximum(u, v), np.minimum(u, v))
    nnz = widths * (widths + 1) // 2 + widths * below
    column = np.arange(1, int(widths.max()) + 1)
    flops = np.where(column <= widths[:, None], (below[:, None] + column).astype(float) ** 2, 0.0).sum()
    return Fill(int(nnz.sum()), float(flops))


def rows_below(widths: Index, row: Index, column: Index) -> Index:
    """Rows (V,) of L below the diagonal block of every block column.

    Parameters
    ----------
    widths : (V,) columns of every block column, in elimination order.
    row, column : (P,) blocks below the diagonal, row > column; repeats allowed.
    """
    V = len(widths)
    parent = _tree(row, column, V)
    size, post = _postorder(parent)
    up = np.full(V, V)  # parent of the nodes in postorder; V of a root
    up[post] = np.where(parent >= 0, post[parent], V)
    weight = np.empty(V, dtype=np.intp)
    weight[post] = widths
    here = np.arange(V)
    neighbors = sp.csr_array(
        (np.ones(len(row) + V, dtype=np.int8), (np.append(post[row], here), np.append(post[column], here))),
        shape=(V, V),
    )
    neighbors.sort_indices()
    r, c = np.repeat(here, np.diff(neighbors.indptr)), neighbors.indices.astype(np.intp)
    along = np.flatnonzero(r[1:] == r[:-1])
    meet = _range_maximum(up, c[along], c[along + 1])  # all nodes between two lie below the one where they meet
    change = np.bincount(c, weights=weight[r], minlength=V + 1)
    change -= np.bincount(meet, weights=weight[r[along]], minlength=V + 1)
    change -= np.bincount(up, weights=weight, minlength=V + 1)
    total = np.concatenate([[0.0], np.cumsum(change[:V])])
    below: Index = (total[post + 1] - total[post + 1 - size]).astype(
        np.intp
    ) - widths  # of postorder, a subtree is a run
    return below


def _tree(row: Index, column: Index, V: int) -> Index:
    """Parent (V,) of every node in the elimination tree, -1 of a root; ways already gone are shortened."""
    by_row = sp.csr_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(V, V))
    rows = np.repeat(np.arange(V), np.diff(by_row.indptr))
    parent, highest = [-1] * V, [-1] * V
    for i, j in zip(rows.tolist(), by_row.indices.tolist(), strict=True):
        while (above := highest[j]) != i:
            highest[j] = i
            if above < 0:
                parent[j] = i
                break
            j = above
    return np.array(parent, dtype=np.intp)


def _postorder(parent: Index) -> tuple[Index, Index]:
    """Nodes (V,) in every subtree, and the place (V,) of every node in a postorder."""
    V, above = len(parent), parent.tolist()
    size, begin, roots = [1] * V, [0] * V, 0
    for j, p in enumerate(above):
        if p >= 0:
            size[p] += size[j]
    post = [0] * V
    for j in range(V - 1, -1, -1):  # begin: where the next subtree of a node goes
        p = above[j]
        if p < 0:
            begin[j], roots = roots, roots + size[j]
        else:
            begin[j] = begin[p]
            begin[p] += size[j]
        post[j] = begin[j] + size[j] - 1
    return np.array(size), np.array(post)


def _range_maximum(x: Index, begin: Index, end: Index) -> Index:
    """max x[begin:end] for many ranges, from the maxima of all windows of 1, 2, 4, ... numbers."""
    out = np.empty(len(begin), dtype=np.intp)
    level = np.frexp((end - begin).astype(float))[1] - 1  # floor(log2(length))
    window = x
    for k in range(int(level.max(initial=-1)) + 1):
        if k:
            half = 1 << (k - 1)
            window = np.maximum(window[:-half], window[half:])
        at = np.flatnonzero(level == k)
        out[at] = np.maximum(window[begin[at]], window[end[at] - (1 << k)])
    return out
