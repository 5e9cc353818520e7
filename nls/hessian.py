"""H = A'A as the lower triangle of a sparse matrix, filled from blocks without forming A.

The structure (which block lands where) is computed once per graph: every number of the lower triangle has a source in
one flat array S that holds the blocks A_a'A_b of all pairs of slots and the summed diagonal blocks. An iteration fills
S and takes from it: H.data = S[source]. Pairs of variables that several factors share are added afterwards. (20,687
SE(2) edges: 2 ms; scipy's A.T @ A: 10 ms.)
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, cached_property
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from models.algebra import Array, gram, product
from models.errors import ResourceLimitError
from nls.elimination import Elimination, Index, Order, eliminated
from nls.scatter import Scatter

if TYPE_CHECKING:
    from nls.assemble import Pattern
    from nls.system import LinearSystem

__all__ = ["Blocks", "Hessian", "triangle"]


@cache
def triangle(d: int) -> tuple[Index, Index]:
    """Rows and columns of the lower triangle of a (d, d) block, by rows (`numpy.tril_indices` takes 180 us)."""
    rows, columns = np.nonzero(np.tri(d))
    return rows, columns


@cache
def _lower(d: int) -> Index:
    """Places of the lower triangle of a (d, d) block stored by rows."""
    rows, columns = triangle(d)
    return np.asarray(rows * d + columns)


class Hessian:
    """Structure of a block-sparse symmetric (or Hermitian) matrix, columns in elimination order.

    Parameters
    ----------
    elimination : the pairs of variables that share a block, and the order.
    dims : (V,) size of every diagonal block.
    diagonal : (V,) where in S the diagonal block (d, d) of each variable begins.
    off : (P,) where in S the contribution (dims[u], dims[v]) of each pair begins.

    Attributes
    ----------
    n : columns.
    permutation : (n,) column k here is column permutation[k] of the given order.
    indptr, indices : of the lower triangle, compressed by column.
    source : where in S each of its numbers is.
    """

    def __init__(self, elimination: Elimination, dims: Index, diagonal: Index, off: Index) -> None:
        e, V = elimination, len(dims)
        widths = dims[e.variables]
        starts = np.cumsum(widths) - widths
        self.n = int(widths.sum())
        inner = np.arange(self.n) - np.repeat(starts, widths)  # column within its block column
        self.permutation = np.repeat((np.cumsum(dims) - dims)[e.variables], widths) + inner

        # Rows of a block column below its diagonal block, and above each of its blocks.
        heights, column = widths[e.row[e.blocks]], e.column[e.blocks]
        total = np.bincount(column, weights=heights, minlength=V).astype(np.intp)
        above = np.cumsum(heights) - heights - (np.cumsum(total) - total)[column]

        # Column k of a block column: the diagonal block from its row k on, then the blocks below.
        ends = np.cumsum(np.repeat(widths + total, widths) - inner)
        if len(ends) and ends[-1] > np.iinfo(np.int32).max:
            raise ResourceLimitError(f"H has {ends[-1]} numbers, more than 32-bit indices can count", float(ends[-1]))
        self.indptr = np.concatenate([[0], ends]).astype(np.int32)
        self.indices = np.empty(self.indptr[-1], dtype=np.int32)
        self.source = np.empty(self.indptr[-1], dtype=np.intp)
        for d in np.flatnonzero(np.bincount(widths)):
            k = np.flatnonzero(widths == d)[:, None]
            r, c = triangle(int(d))
            target = self.indptr[starts[k] + c] + (r - c)
            self.indices[target] = starts[k] + r
            self.source[target] = diagonal[e.variables[k]] + r * d + c

        def entries(pairs: Index, above: Index) -> Iterator[tuple[Index, Index, Index]]:
            """All pairs of one shape at a time: places in the data, sources in S, and rows of their numbers."""
            row, column, base = e.row[pairs], e.column[pairs], int(widths.max(initial=0)) + 1
            shapes = widths[row] * base + widths[column]  # one number a shape: unique rows are 20 times slower to find
            for height, width in (divmod(int(shape), base) for shape in np.flatnonzero(np.bincount(shapes))):
                same = np.flatnonzero(shapes == height * base + width)
                r, c = (grid.reshape(-1) for grid in np.indices((height, width)))
                target = self.indptr[starts[column[same], None] + c] + (width - c + r) + above[same, None]
                inside = np.stack([r * width + c, c * height + r])  # of a contribution as it is, and turned
                p = pairs[same]
                yield target, off[p, None] + inside[e.turned[p].astype(np.intp)], starts[row[same], None] + r

        for target, source, rows in entries(e.blocks, above):
            self.indices[target] = rows
            self.source[target] = source
        repeats = [(target.reshape(-1), source.reshape(-1)) for target, source, _ in entries(e.again, above[e.twin])]
        self._add = [np.concatenate(part) for part in zip(*repeats, strict=True)] or None

    @cached_property
    def _on_diagonal(self) -> Index:
        """Where in S the diagonal (n,) is."""
        return self.source[self.indptr[:-1]]

    @cached_property
    def _mirrored(self) -> tuple[Index, Index, Index]:
        """indptr and indices of both triangles, and which number of the lower one each of theirs is."""
        column = np.repeat(np.arange(self.n), np.diff(self.indptr))
        below = np.flatnonzero(self.indices != column)
        rows, columns = np.append(self.indices, column[below]), np.append(column, self.indices[below])
        order = np.lexsort((rows, columns))
        indptr = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=self.n))])
        return indptr, rows[order], np.append(np.arange(len(column)), below)[order]

    def data(self, S: Array, out: Array | None = None) -> Array:
        """Numbers of the lower triangle from the flat blocks S, in ``out`` where it is given."""
        data = np.take(S, self.source, out=out, mode="clip")  # half the time of mode "raise"; all sources are in S
        if self._add is not None:
            np.add.at(data, self._add[0], np.take(S, self._add[1]))
        return data

    def diagonal(self, S: Array) -> Array:
        """Diagonal of the matrix (n,), real."""
        return np.take(S, self._on_diagonal).real

    def damp(self, S: Array, damping: Array) -> None:
        """Add a diagonal (n,), in the given order of columns, to the flat blocks S."""
        S[self._on_diagonal] += damping[self.permutation]

    def symmetric(self, S: Array) -> sp.csc_array:
        """Both triangles as a sparse matrix; numbers that happen to be zero stay in its structure."""
        indptr, indices, place = self._mirrored
        data = self.data(S)[place]
        if np.iscomplexobj(data):
            above = indices < np.repeat(np.arange(self.n), np.diff(indptr))
            data[above] = data[above].conj()
        return sp.csc_array((data, indices, indptr), shape=(self.n, self.n))

    def matrix(self, S: Array) -> sp.csc_matrix:
        """Lower triangle as a sparse matrix."""
        H = sp.csc_matrix((self.data(S), self.indices, self.indptr), shape=(self.n, self.n))
        H.has_sorted_indices = True
        return H


class Blocks:
    """Fills the flat array S from a linear system: A_a'A_b per pair of slots, and summed A_a'A_a per variable.

    S holds the diagonal blocks of *all* variables, also of held ones, whose blocks are never taken from it; and of
    these blocks the lower triangle.

    Parameters
    ----------
    pattern : the numbering of the graph.
    """

    def __init__(self, pattern: Pattern) -> None:
        free = np.flatnonzero(~pattern.held)
        number = np.full(len(pattern.held), -1, dtype=np.intp)
        number[free] = np.arange(len(free))
        sizes = pattern.dims * pattern.dims
        begin = np.cumsum(sizes) - sizes
        self.dims, self.diagonal, self.size = pattern.dims[free], begin[free], int(sizes.sum())
        self.squares = Scatter(pattern.batches, begin, self.size, _lower)
        u, v, off = [], [], []
        self.pairs: list[tuple[int, int, int, slice]] = []  # batch, two slots, place in S
        for k, batch in enumerate(pattern.batches):
            widths = [manifold.dim for manifold in batch.model.manifolds]
            for a, c in combinations(range(len(widths)), 2):
                p, q, block = number[batch.variables[a]], number[batch.variables[c]], widths[a] * widths[c]
                both = np.flatnonzero((p >= 0) & (q >= 0))
                u.append(p[both])
                v.append(q[both])
                off.append(self.size + both * block)
                self.pairs.append((k, a, c, slice(self.size, self.size + len(batch) * block)))
                self.size += len(batch) * block
        none = [np.zeros(0, dtype=np.intp)]
        self.u, self.v, self.off = np.concatenate(u + none), np.concatenate(v + none), np.concatenate(off + none)

    def structure(self, order: Order | None = None) -> Hessian:
        """Structure of H = A'A over the free variables, eliminated in an order; None keeps theirs."""
        return Hessian(eliminated(self.u, self.v, len(self.dims), order), self.dims, self.diagonal, self.off)

    def fill(self, system: LinearSystem) -> Array:
        """S of one linearization."""
        S = np.empty(self.size)
        diagonal = S[: self.squares.size]
        diagonal[:] = 0.0
        for k, blocks in enumerate(system.blocks):
            for slot, A in enumerate(blocks):
                self.squares.add(diagonal, k, slot, gram(A).transpose(1, 2, 0)[triangle(A.shape[2])])
        for k, a, c, where in self.pairs:
            A, C = system.blocks[k][a], system.blocks[k][c]
            S[where].reshape(len(A), A.shape[2], C.shape[2])[...] = product(A.mT, C)
        return S
