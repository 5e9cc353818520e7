"""A block-sparse symmetric matrix H as the lower triangle of a sparse matrix, filled from an array of blocks.

The structure (which block lands where) is computed once per graph. Every number of the lower triangle has a source in
one flat array S that holds the blocks, `nls.sparse.blocks` for A'A. An iteration fills S and takes from it: H.data =
S[source]. Pairs of variables that several factors share are added afterwards. (20,687 SE(2) edges: 2 ms; scipy's A.T @
A: 10 ms.)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, cached_property
from typing import Any, TypeVar

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index
from models.errors import ResourceLimitError
from nls.sparse.elimination import Elimination

__all__ = ["Hessian", "triangle"]
T = TypeVar("T")


@cache
def triangle(d: int) -> tuple[Index, Index]:
    """Rows and columns of the lower triangle of a (d, d) block, by rows (`numpy.tril_indices` takes 180 us)."""
    rows, columns = np.nonzero(np.tri(d))
    return rows, columns


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
    elimination, dims : as given.
    n : columns.
    permutation : (n,) column k here is column permutation[k] of the given order.
    indptr, indices : of the lower triangle, compressed by column.
    source : where in S each of its numbers is.
    """

    def __init__(self, elimination: Elimination, dims: Index, diagonal: Index, off: Index) -> None:
        self.elimination, self.dims = elimination, dims
        self._analyses: dict[tuple[Callable[[sp.csc_matrix], Any], np.dtype[Any]], Any] = {}
        e, V = elimination, len(dims)
        widths = dims[e.variables]
        starts = widths.cumsum() - widths
        self.n = int(widths.sum())
        inner = np.arange(self.n) - starts.repeat(widths)  # column within its block column
        self.permutation = (dims.cumsum() - dims)[e.variables].repeat(widths) + inner

        # Rows of a block column below its diagonal block, and above each of its blocks.
        heights, column = widths[e.row[e.blocks]], e.column[e.blocks]
        total = np.bincount(column, weights=heights, minlength=V).astype(np.intp)
        above = heights.cumsum() - heights - (total.cumsum() - total)[column]

        # Column k of a block column: the diagonal block from its row k on, then the blocks below.
        ends = ((widths + total).repeat(widths) - inner).cumsum()
        if len(ends) and ends[-1] > np.iinfo(np.int32).max:
            raise ResourceLimitError(f"H has {ends[-1]} numbers, more than 32-bit indices can count", float(ends[-1]))
        self.indptr = np.concatenate([[0], ends]).astype(np.int32)
        self.indices = np.empty(self.indptr[-1], dtype=np.int32)
        self.source = np.empty(self.indptr[-1], dtype=np.intp)
        for d in np.bincount(widths).nonzero()[0]:
            k = (widths == d).nonzero()[0][:, None]
            r, c = triangle(int(d))
            target = self.indptr[starts[k] + c] + (r - c)
            self.indices[target] = starts[k] + r
            self.source[target] = diagonal[e.variables[k]] + r * d + c

        def entries(pairs: Index, above: Index) -> Iterator[tuple[Index, Index, Index]]:
            """All pairs of one shape at a time: places in the data, sources in S, and rows of their numbers."""
            row, column, base = e.row[pairs], e.column[pairs], int(widths.max(initial=0)) + 1
            shapes = widths[row] * base + widths[column]  # one number a shape: unique rows are 20 times slower to find
            for height, width in (divmod(int(shape), base) for shape in np.bincount(shapes).nonzero()[0]):
                same = (shapes == height * base + width).nonzero()[0]
                r, c = np.divmod(np.arange(height * width), width)
                target = self.indptr[starts[column[same], None] + c] + (width - c + r) + above[same, None]
                inside = np.stack([r * width + c, c * height + r])  # of a contribution as it is, and turned
                p = pairs[same]
                yield target, off[p, None] + inside[e.turned[p].astype(np.intp)], starts[row[same], None] + r

        for target, source, rows in entries(e.blocks, above):
            self.indices[target] = rows
            self.source[target] = source
        repeats = [(target.reshape(-1), source.reshape(-1)) for target, source, _ in entries(e.again, above[e.twin])]
        self._add = [np.concatenate(arrays) for arrays in zip(*repeats, strict=True)] or None

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_analyses": {}}  # of programs whose objects do not leave the process

    def analyzed(self, analyze: Callable[[sp.csc_matrix], T], H: sp.csc_matrix) -> T:
        """The analysis of a matrix of this structure by a program: made at the first of its type, then kept."""
        key = analyze, H.dtype
        if key not in self._analyses:
            self._analyses[key] = analyze(H)
        analysis: T = self._analyses[key]
        return analysis

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
        data = S.take(self.source, out=out, mode="clip")  # half the time of mode "raise"; all sources are in S
        if self._add is not None:
            np.add.at(data, self._add[0], S.take(self._add[1]))
        return data

    def diagonal(self, S: Array) -> Array:
        """Diagonal of the matrix (n,), real."""
        return S.take(self._on_diagonal).real

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
