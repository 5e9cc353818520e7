"""Central differences: what every derivative of a model is checked against."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from models import Manifold, R
from models.algebra import Array

__all__ = ["difference", "on_group"]


def on_group(
    group: Manifold,
    f: Callable[[Array], Array],
    X: Array,
    h: float = 1e-6,
    minus: Callable[[Array, Array], Array] = np.subtract,
) -> Array:
    """Derivative (n, m, dim) of a function of elements (n, size) by their tangent steps; minus(a, b) is from b to a."""
    steps = [np.tile(s, (len(X), 1)) for s in h * np.eye(group.dim)]
    ends = [(f(group.retract(X, s)), f(group.retract(X, -s))) for s in steps]
    return np.stack([minus(*pair) / (2 * h) for pair in ends], axis=-1)


def difference(f: Callable[[Array], Array], x: Array, h: float = 1e-6) -> Array:
    """Derivative (n, m, k) of a function from (n, k) to (n, m)."""
    return on_group(R(x.shape[1]), f, x, h)
