"""Pairs of variables that share a block of A'A although nothing measures them together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from factors.base import Factor, Jacobians
from factors.keys import Keys
from factors.noise import Isotropic
from models import Manifold, R
from models.algebra import Array

__all__ = ["Pair", "paired"]


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
