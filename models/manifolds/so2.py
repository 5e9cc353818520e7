"""Rotations of the plane, SO(2), stored as one angle (..., 1), rad."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, matrix, wrap
from models.manifolds.base import LieGroup

__all__ = ["SO2"]


def rotation2(theta: Array) -> Array:
    """R(theta) = [[c, -s], [s, c]]; (...) to (..., 2, 2)."""
    c, s = np.cos(theta), np.sin(theta)
    return matrix([[c, -s], [s, c]])


class RotationsOfThePlane(LieGroup):
    """SO(2): the angle is its own logarithm; only the wrap to [-pi, pi) makes it a circle."""

    name, dim, size, components, point_dim = "SO2", 1, 1, ("yaw",), 2
    flat = True

    def exp(self, delta: npt.ArrayLike) -> Array:
        return wrap(np.array(delta, dtype=float))

    log = vector = exp

    def compose(self, X: npt.ArrayLike, Y: npt.ArrayLike) -> Array:
        return wrap(np.asarray(X, dtype=float) + np.asarray(Y, dtype=float))

    def inverse(self, X: npt.ArrayLike) -> Array:
        return wrap(-np.asarray(X, dtype=float))

    def _unit(self, X: npt.ArrayLike) -> Array:
        return np.ones((*np.shape(X), 1))

    adjoint = jl = jl_inv = vector_jl = vector_jr = _unit

    def rotation(self, X: npt.ArrayLike) -> Array:
        return rotation2(np.asarray(X, dtype=float)[..., 0])

    def identity(self, n: int = 1) -> Array:
        return np.zeros((n, 1))

    def position(self, X: Array) -> Array:
        return X[..., :0]


SO2 = RotationsOfThePlane()
