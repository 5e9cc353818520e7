"""The blocks of H = A'A from the blocks of A, in one flat array S, without forming A.

S holds the summed diagonal blocks A_a'A_a of *all* variables, of each the lower triangle. Blocks of held variables are
there, and never taken. Then come the blocks A_a'A_c of all pairs of slots, one for every measurement. Sums over
measurements by variable are one `numpy.bincount` per slot of a batch, whatever the width of its parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from itertools import combinations

import numpy as np

from models.algebra import Array, Index, Mask, gram, product
from nls.sparse.hessian import triangle

__all__ = ["Blocks", "Scatter"]


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
        total += np.bincount(places, addend.reshape(-1), self.size)


@cache
def _lower(d: int) -> Index:
    """Places of the lower triangle of a (d, d) block stored by rows."""
    rows, columns = triangle(d)
    return np.asarray(rows * d + columns)


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
                self.squares.add(diagonal, k, slot, gram(A_k).transpose(1, 2, 0)[triangle(A_k.shape[2])])
        for k, a, c, where in self.pairs:
            A_a, A_c = A[k][a], A[k][c]
            S[where].reshape(len(A_a), A_a.shape[2], A_c.shape[2])[...] = product(A_a.mT, A_c)
        return S
