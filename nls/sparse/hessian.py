"""A block-sparse symmetric matrix H as the lower triangle of a sparse matrix, filled from an array of blocks.

The structure (which block lands where) is computed once per graph. Every number of the lower triangle has a source in
one flat array S that holds the blocks, those of `Blocks` for A'A. An iteration fills S and takes from it: H.data =
S[source]. Pairs of variables that several factors share are added afterwards. (20,687 SE(2) edges: 2 ms; scipy's A.T @
A: 10 ms.)

`Blocks` fills S from the blocks of A, without forming A. S holds the summed diagonal blocks A_a'A_a of *all* variables,
of each the lower triangle. Blocks of held variables are there, and never taken. Then come the blocks A_a'A_c of all
pairs of slots, one for every measurement. Sums over measurements by variable are one `numpy.bincount` per slot of a
batch, whatever the width of its parts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache, cached_property
from itertools import combinations
from typing import Any

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index, Mask, gram, product
from models.errors import ResourceLimitError
from nls.sparse.elimination import Elimination


@cache
def triangle(d: int) -> tuple[Index, Index]:
    """Rows and columns (t, 1) of the lower triangle of a (d, d) block, by rows (`numpy.tril_indices` takes 180 us)."""
    rows, columns = np.nonzero(np.tri(d))
    return rows[:, None], columns[:, None]


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
    analyses : CHOLMOD's symbolic factorizations of this structure, by the type of the numbers.
    """

    def __init__(self, elimination: Elimination, dims: Index, diagonal: Index, off: Index) -> None:
        self.elimination, self.dims = elimination, dims
        self.analyses: dict[type, Any] = {}
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
        if self.n == V:  # every block is one number, as in chordal starts: half the time
            own, below = self.indptr[:-1], np.arange(len(column)) + column + 1
            self.indices[own], self.indices[below] = starts, e.row[e.blocks]
            self.source[own], self.source[below] = diagonal[e.variables], off[e.blocks]
            self._add = [below[e.twin], off[e.again]] if len(e.again) else None
            return
        for d in np.bincount(widths).nonzero()[0]:
            k = (widths == d).nonzero()[0]
            r, c = triangle(int(d))  # entries first: an inner loop over all blocks, and not one for each
            target = self.indptr[starts[k] + c] + (r - c)
            self.indices[target] = starts[k] + r
            self.source[target] = diagonal[e.variables[k]] + r * d + c

        def entries(pairs: Index, above: Index) -> Iterator[tuple[Index, Index, Index]]:
            """All pairs of one shape at a time: places in the data, sources in S, and rows of their numbers."""
            row, column, base = e.row[pairs], e.column[pairs], int(widths.max(initial=0)) + 1
            shapes = widths[row] * base + widths[column]  # one number a shape: unique rows are 20 times slower to find
            for height, width in (divmod(int(shape), base) for shape in np.bincount(shapes).nonzero()[0]):
                same = (shapes == height * base + width).nonzero()[0]
                r, c = np.divmod(np.arange(height * width)[:, None], width)
                target = self.indptr[starts[column[same]] + c] + (width - c + r) + above[same]
                p = pairs[same]
                inside = np.where(e.turned[p], c * height + r, r * width + c)
                yield target, off[p] + inside, starts[row[same]] + r

        for target, source, rows in entries(e.blocks, above):
            self.indices[target] = rows
            self.source[target] = source
        repeats = [(target.reshape(-1), source.reshape(-1)) for target, source, _ in entries(e.again, above[e.twin])]
        self._add = [np.concatenate(arrays) for arrays in zip(*repeats, strict=True)] or None

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "analyses": {}}  # of programs whose objects do not leave the process

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

    def matrix(self, data: Array) -> sp.csc_matrix:
        """Lower triangle as a sparse matrix of these numbers."""
        H = sp.csc_matrix((data, self.indices, self.indptr), shape=(self.n, self.n))
        H.has_sorted_indices = True
        return H


Slots = Sequence[Sequence[tuple[Index, int]]]
"""Per batch and slot the variables (k,) of its measurements, and their dimension."""


class Scatter:
    """Adds numbers that belong to measurements into a flat array that belongs to variables.

    Parameters
    ----------
    slots : of every batch.
    first : (V,) where in the flat array the numbers of each variable begin.
    size : of the flat array.
    inner : for a variable of dimension d the places (c,) of its numbers from there; all d of them when omitted.
    """

    def __init__(self, slots: Slots, first: Index, size: int, inner: Callable[[int], Index] = np.arange) -> None:
        self.slots, self.first, self.size, self.inner = slots, first, size, inner
        self._places: dict[tuple[int, int], Index] = {}  # by batch and slot

    def add(self, total: Array, batch: int, slot: int, addend: Array) -> None:
        """Add a part (c, k), components first, of k measurements to ``total`` (size,)."""
        places = self._places.get((batch, slot))
        if places is None:
            variables, d = self.slots[batch][slot]
            places = self._places[batch, slot] = (self.first[variables] + self.inner(d)[:, None]).reshape(-1)
        np.add.at(total, places, addend.reshape(-1))


@cache
def _lower(d: int) -> Index:
    """Places of the lower triangle of a (d, d) block stored by rows."""
    rows, columns = triangle(d)
    return np.asarray(rows * d + columns)[:, 0]


class Blocks:
    """Where every block of A'A is in S, and how S is filled.

    Parameters
    ----------
    dims : (V,) tangent dimension of every variable.
    held : (V,) which of them have no columns.
    slots : per batch and slot the variables and their dimension.

    Attributes
    ----------
    dims, diagonal : (F,) of the free variables: dimension, and where in S the diagonal block begins.
    u, v, off : (P,) pairs of free variables that share a factor, and where in S their block (dims[u], dims[v]) begins.
    size : of S.
    """

    def __init__(self, dims: Index, held: Mask, slots: Slots) -> None:
        free = (~held).nonzero()[0]
        number = np.full(len(held), -1, dtype=np.intp)
        number[free] = np.arange(len(free))
        sizes = dims * dims
        begin = sizes.cumsum() - sizes
        self.dims, self.diagonal, self.size = dims[free], begin[free], int(sizes.sum())
        self.squares = Scatter(slots, begin, self.size, _lower)
        u, v, off = [], [], []
        self.pairs: list[tuple[int, int, int, slice]] = []  # batch, two slots, place in S
        for k, batch in enumerate(slots):
            for (a, (i, d)), (c, (j, e)) in combinations(enumerate(batch), 2):
                p, q = number[i], number[j]
                pairs = ((p >= 0) & (q >= 0)).nonzero()[0]
                u.append(p[pairs])
                v.append(q[pairs])
                off.append(self.size + pairs * d * e)
                self.pairs.append((k, a, c, slice(self.size, self.size + len(p) * d * e)))
                self.size += len(p) * d * e
        none = [np.zeros(0, dtype=np.intp)]
        self.u, self.v, self.off = np.concatenate(u + none), np.concatenate(v + none), np.concatenate(off + none)

    def fill(self, A: Sequence[tuple[Array, ...]]) -> Array:
        """S from the Jacobian blocks of one linearization, per batch one (k, m, d) array per slot."""
        S = np.empty(self.size)
        diagonal = S[: self.squares.size]
        diagonal[:] = 0.0
        for k, blocks in enumerate(A):
            for slot, A_k in enumerate(blocks):
                self.squares.add(diagonal, k, slot, gram(A_k).transpose(1, 2, 0)[triangle(A_k.shape[2])][:, 0])
        for k, a, c, where in self.pairs:
            A_a, A_c = A[k][a], A[k][c]
            S[where].reshape(len(A_a), A_a.shape[2], A_c.shape[2])[...] = product(A_a.mT, A_c)
        return S
