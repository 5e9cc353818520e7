"""Rotations of the plane, SO(2), stored as one angle (..., 1), rad."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, matrix, wrap
from models.manifolds.base import LieGroup
from models.manifolds.rigid import rotation_parts

__all__ = ["SO2"]


def rotation2(theta: Array) -> Array:
    """R(theta) = [[c, -s], [s, c]]; (...) to (..., 2, 2)."""
    c, s = np.cos(theta), np.sin(theta)
    return matrix([[c, -s], [s, c]])


def angle2(R: Array) -> Array:
    """The angle (...) of the rotation nearest to R (..., 2, 2), rad."""
    return wrap(np.arctan2(R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1]))


class RotationsOfThePlane(LieGroup):
    """SO(2): the angle is its own logarithm; only the wrap to [-pi, pi) makes it a circle."""

    name, dim, size, components, point_dim = "SO2", 1, 1, ("yaw",), 2
    flat = True

    def from_matrix(self, R: npt.ArrayLike) -> Array:
        """Angles (1,) or (n, 1) of rotation matrices (2, 2) or (n, 2, 2); `matrix` is the inverse.

        Raises
        ------
        GraphError
            No such matrices; a matrix that is no rotation, by more than 0.001 in an entry of R'R.

        Examples
        --------
        >>> SO2.from_matrix([[0, -1], [1, 0]]).round(6)
        array([1.570796])
        """
        return angle2(rotation_parts("SO2.from_matrix", R, 2))[..., None]

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
