"""Jacobians by central differences through retract, the whole batch at once: for a prediction that has none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from models import Manifold
from models.algebra import Array

__all__ = ["central_differences", "difference_steps"]

STEP = 6e-6  # cube root of the rounding unit: where truncation and rounding of a central difference balance


def central_differences(
    space: Manifold,
    manifolds: tuple[Manifold, ...],
    predict: Callable[..., Array],
    X: tuple[Array, ...],
    h: Array,
) -> tuple[Array, ...]:
    """H_k (n, dim, dim_k) of h(X [+] d) = h [+] H d, one per variable: (h(X [+] d) - h(X [+] -d)) / 2 |d|.

    Parameters
    ----------
    space, manifolds : of the prediction, and of each variable.
    predict : h of one stack (n, size_k) per variable.
    X, h : the stacks, and h there.
    """

    def moved(slot: int, delta: Array) -> Array:
        Y = list(X)
        Y[slot] = manifolds[slot].retract(X[slot], delta)
        return space.local(h, predict(*Y))

    H = []
    for slot, manifold in enumerate(manifolds):
        H_k = np.empty((len(h), space.dim, manifold.dim))
        for d in range(manifold.dim):
            delta = np.zeros((len(h), manifold.dim))
            delta[:, d] = difference_steps(manifold, X[slot])[:, d]
            H_k[:, :, d] = (moved(slot, delta) - moved(slot, -delta)) / (2 * delta[:, d : d + 1])
        H.append(H_k)
    return tuple(H)


def difference_steps(manifold: Manifold, X: Array) -> Array:
    """Steps (n, dim) of central differences: larger for coordinates far from 0, which carry coarser rounding.

    Rounding of x moves f by eps |x| and the step h divides it, truncation is of order h^2: h = (eps |x|)^(1/3).
    """
    size = np.ones((len(X), manifold.dim))
    if manifold.dim == manifold.size and manifold.name.startswith("R"):
        size = np.maximum(size, np.abs(X))
    else:
        t = manifold.position(X)
        size[:, : t.shape[1]] = np.maximum(1.0, np.abs(t).max(axis=1, keepdims=True, initial=0.0))
    return STEP * np.cbrt(size)
