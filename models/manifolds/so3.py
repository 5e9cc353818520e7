r"""Rotations of space, SO(3), stored as unit quaternions (x, y, z, w), Hamilton, body to world.

A quaternion is used as it was read; every function divides by its length where that matters. So rounded input (six
digits in a file) gives exact rotations and is written back bit for bit. q and -q are the same rotation: wherever a
quaternion is reduced to three numbers, w >= 0 is taken.

With w a rotation vector, x = |w|^2, K = [w]x and the Stumpff functions c_k(x):

    R(w)      = I + c1 K + c2 K^2
    J_l(w)    = I + c2 K + c3 K^2
    J_l^-1(w) = I - K/2 + d K^2,   d = (c3 - 2 c4) / (2 c2) = 1/x - cot(|w|/2) / (2 |w|)

d in this form is regular at 0 and at pi. Source: T. Barfoot, State Estimation for Robotics, 2017, section 7.1.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import TINY, Array, apply, arrangement, components, dot, matrix, pack, product, skew, stumpff
from models.manifolds.base import LieGroup
from models.manifolds.rigid import rotation_parts

__all__ = ["SO3", "quaternion_from_matrix", "rotation3"]

UNIT_TOLERANCE = 1e-3  # six-digit files are off by 1e-6, hand-written ones by 1e-4; beyond this it is another thing


IDENTITY = matrix(np.eye(3).tolist())
_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
_right_product = arrangement([[4, 3, -2, 1], [-3, 4, 1, 2], [2, -1, 4, 3], [-1, -2, -3, 4]])
_conjugate_product = arrangement([[-4, -3, 2, 1], [3, -4, -1, 2], [-2, 1, -4, 3], [1, 2, 3, 4]])
w_plus_v = arrangement([[4, -3, 2], [3, 4, -1], [-2, 1, 4]])
w_minus_v = arrangement([[4, 3, -2], [-3, 4, 1], [2, -1, 4]])


def quaternion_product(p: Array, q: Array) -> Array:
    """Hamilton product p q of stacks (..., 4), normalized where its length is off by more than rounding."""
    pq = apply(_right_product(q), p)
    square = dot(pq, pq)
    return np.asarray(pq / np.sqrt(np.where(np.abs(square - 1) > 1e-15, square, 1.0))[..., None])


def conjugate_product(p: Array, q: Array) -> Array:
    """Hamilton product of the conjugate of p with q, stacks (n, 4), of the product of their lengths."""
    return apply(_conjugate_product(q), p)


def rotation3(q: Array) -> Array:
    """Rotation matrix (..., 3, 3) of quaternions (v, w) (..., 4) of any length but 0.

    R = ((w I + [v]x)^2 + v v') / |q|^2.
    """
    v, B = q[..., :3], w_plus_v(q)
    R = product(B, B)
    R += v[..., :, None] * v[..., None, :]
    R /= dot(q, q)[..., None, None]
    return R


def quaternion_from_matrix(R: npt.ArrayLike) -> Array:
    """Unit quaternion (..., 4), w >= 0, of rotation matrices (..., 3, 3).

    The largest of the four squared components is found first, so no division is by a small number.
    """
    R = np.asarray(R, dtype=float)
    r = np.moveaxis(R, (-2, -1), (0, 1))
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    # 4 q q', the outer product of the quaternion with itself; its row of largest diagonal is 4 q_k q
    x, y, z = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    xy, xz, yz = r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1]
    diagonal = [1 + 2 * r[0, 0] - trace, 1 + 2 * r[1, 1] - trace, 1 + 2 * r[2, 2] - trace, 1 + trace]
    outer = matrix(
        [[diagonal[0], xy, xz, x], [xy, diagonal[1], yz, y], [xz, yz, diagonal[2], z], [x, y, z, diagonal[3]]]
    )
    k = np.argmax(pack(diagonal), axis=-1)
    q = np.take_along_axis(outer, k[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(q * (np.where(q[..., 3:] < 0, -1.0, 1.0) / np.linalg.norm(q, axis=-1, keepdims=True)))


def upper_half(q: npt.ArrayLike) -> Array:
    """The unit quaternion (..., 4) with w >= 0."""
    q = np.asarray(q, dtype=float)
    return q * (np.where(q[..., 3] < 0, -1.0, 1.0) / np.sqrt(dot(q, q)))[..., None]


def quaternion_vector(q: npt.ArrayLike) -> Array:
    """Vector part (..., 3) of the unit quaternion with w >= 0."""
    return upper_half(q)[..., :3]


def quaternion_vector_jr(q: npt.ArrayLike) -> Array:
    """Derivative of the vector part of q Exp(d): (w I + [v]x) / 2."""
    return w_plus_v(0.5 * upper_half(q))


def quaternion_vector_jl(q: npt.ArrayLike) -> Array:
    """Derivative of the vector part of Exp(d) q: (w I - [v]x) / 2."""
    return w_minus_v(0.5 * upper_half(q))


class RotationsOfSpace(LieGroup):
    """SO(3) by quaternions; the logarithm is exact from 0 to pi.

    Examples
    --------
    >>> import numpy as np
    >>> SO3.log(SO3.exp([0.0, 0.0, 3.0])).round(12)
    array([0., 0., 3.])
    """

    name, dim, size, components, point_dim = "SO3", 3, 4, ("roll", "pitch", "yaw"), 3
    body_axes = True

    def from_matrix(self, R: npt.ArrayLike) -> Array:
        """Unit quaternions (4,) or (n, 4), w >= 0, of rotation matrices (3, 3) or (n, 3, 3); `matrix` is the inverse.

        Raises
        ------
        GraphError
            No such matrices; a matrix that is no rotation, by more than 0.001 in an entry of R'R.

        Examples
        --------
        >>> SO3.from_matrix([[0, -1, 0], [1, 0, 0], [0, 0, 1]]).round(6)
        array([0.      , 0.      , 0.707107, 0.707107])
        """
        return quaternion_from_matrix(rotation_parts("SO3.from_matrix", R, 3))

    def exp(self, delta: npt.ArrayLike) -> Array:
        w = np.asarray(delta, dtype=float)
        c0, c1 = stumpff(dot(w, w) / 4, 0, 1)
        return pack([*(c1 / 2 * components(w)), c0])

    def log(self, X: npt.ArrayLike) -> Array:
        x, y, z, w = components(X)
        norm = np.sqrt(x * x + y * y + z * z + TINY)
        s = np.where(w < 0, -2.0, 2.0) * (np.arctan2(norm, np.abs(w)) / norm)
        return pack([s * x, s * y, s * z])

    def compose(self, X: npt.ArrayLike, Y: npt.ArrayLike) -> Array:
        return quaternion_product(np.asarray(X, dtype=float), np.asarray(Y, dtype=float))

    def inverse(self, X: npt.ArrayLike) -> Array:
        return np.asarray(np.asarray(X, dtype=float) * _CONJUGATE)

    def rotation(self, X: npt.ArrayLike) -> Array:
        return rotation3(np.asarray(X, dtype=float))

    adjoint = world_axes = rotation

    def jl(self, delta: npt.ArrayLike) -> Array:
        w = np.asarray(delta, dtype=float)
        c2, c3 = stumpff(dot(w, w)[..., None, None], 2, 3)
        K = skew(w)
        return IDENTITY + c2 * K + c3 * product(K, K)

    def jl_inv(self, delta: npt.ArrayLike) -> Array:
        w = np.asarray(delta, dtype=float)
        c2, c3, c4 = stumpff(dot(w, w)[..., None, None], 2, 3, 4)
        K = skew(w)
        return IDENTITY - 0.5 * K + (c3 - 2 * c4) / (2 * c2) * product(K, K)

    def vector(self, X: npt.ArrayLike) -> Array:
        return quaternion_vector(X)

    def vector_jl(self, X: npt.ArrayLike) -> Array:
        return quaternion_vector_jl(X)

    def vector_jr(self, X: npt.ArrayLike) -> Array:
        return quaternion_vector_jr(X)

    def identity(self, n: int = 1) -> Array:
        return np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))

    def position(self, X: Array) -> Array:
        return X[..., :0]

    def invalid(self, X: Array) -> tuple[int, str] | None:
        return super().invalid(X) or not_unit(X)


def not_unit(q: Array) -> tuple[int, str] | None:
    """First quaternion (n, 4) whose length is not 1 up to rounding, and why."""
    with np.errstate(over="ignore"):  # a length beyond the largest number is infinite, and not 1
        length = np.linalg.norm(q, axis=-1)
    bad = np.abs(length - 1) > UNIT_TOLERANCE
    if not bad.any():
        return None
    k = int(np.argmax(bad))
    return k, f"the quaternion has length {length[k]:.6g}, expected 1; the order is x y z w"


SO3 = RotationsOfSpace()
