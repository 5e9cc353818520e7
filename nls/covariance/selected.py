"""The selected inverse: all blocks of H^-1 that have one in H, from one pass over its factor.

Pairs of variables that nothing measures together get a block in H by a factor that measures nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.noise import Isotropic
from models import Manifold, R
from models.algebra import Array, Index, Mask
from nls.linear.factorization import Factorization


class SelectedInverse:
    """Blocks of H^-1 of single variables, and of pairs that share a block of H.

    Parameters
    ----------
    factorization : of H.
    memory_limit : bytes the pass may take.

    Raises
    ------
    ResourceLimitError
        It would take more.
    """

    def __init__(self, factorization: Factorization, memory_limit: float) -> None:
        elimination, dims = factorization.hessian.elimination, factorization.hessian.dims
        u, v, every = elimination.u[elimination.blocks], elimination.v[elimination.blocks], np.arange(len(dims))
        low, high = np.append(every, np.minimum(u, v)), np.append(every, np.maximum(u, v))
        order = np.argsort(low * len(dims) + high)
        low, high, size = low[order], high[order], dims[low[order]] * dims[high[order]]
        self._variables, self._key, self._first = len(dims), low * len(dims) + high, np.cumsum(size) - size
        self._numbers = factorization.inverse_blocks(low, high, memory_limit)

    def lacks(self, i: Index, j: Index) -> Mask:
        """Which pairs (k,) of variables share no block."""
        key, place = self._places(i, j)
        return np.asarray(self._key[place] != key)

    def blocks(self, i: Index, j: Index, d: int, e: int) -> Array:
        """Blocks (k, d, e) of pairs (k,) of variables of these sizes: all i are of one kind, and all j."""
        turned = i > j
        shape = (e, d) if turned.all() else (d, e)
        B: Array = self._numbers[self._first[self._places(i, j)[1], None] + np.arange(d * e)].reshape(-1, *shape)
        if turned.all():
            return B.mT
        if turned.any():
            B[turned] = B[turned].mT
        return B

    def _places(self, i: Index, j: Index) -> tuple[Index, Index]:
        """Keys of pairs (k,), and where they are or would be among those there are."""
        key = np.minimum(i, j) * self._variables + np.maximum(i, j)
        return key, np.minimum(np.searchsorted(self._key, key), len(self._key) - 1)


class Pair(Factor):
    """Two variables that share a factor, which measures nothing: so the selected inverse has their block."""

    slots = (None, None)
    relative = True

    def __init__(self, i: Keys, j: Keys) -> None:
        super().__init__([i, j], [0.0], Isotropic(1.0))

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return R(1)

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        return np.zeros((len(self), 1)), tuple(np.zeros((len(self), 1, manifold.dim)) for manifold in manifolds)


def paired(pairs: Sequence[tuple[Keys, Keys]]) -> list[Factor]:
    """A factor for every batch of pairs, each pair once; none of a variable with itself."""
    factors: list[Factor] = []
    for i, j in pairs:
        numbers = np.stack([i.numbers, j.numbers])
        numbers = np.unique(numbers[:, i.numbers != j.numbers] if i.kind == j.kind else numbers, axis=1)
        if numbers.size:
            factors.append(Pair(Keys(i.kind, numbers[0]), Keys(j.kind, numbers[1])))
    return factors
