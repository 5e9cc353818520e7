r"""Poses in space, SE(3), stored as (x, y, z, qx, qy, qz, qw): meters and a unit quaternion, body to world.

With w the rotation vector, P = [rho]x, K = [w]x and the Stumpff functions c_k(|w|^2):

    Exp(rho, w) = (V rho, Exp(w)),      V = J_l(w) of SO(3)
    J_l = [[V, Q], [0, V]],             Q = c2 P + c3 (KP + PK) + b ((2 c4 - c3) K + (3 c5 - c4) K^2),  b = w'rho
    J_l^-1 = [[V^-1, U], [0, V^-1]],    U = -P/2 + d (KP + PK) + 2 b d' K^2,  d = (c3 - 2 c4) / (2 c2),
                                        d' = d^2 + (5 c5 - c4 - 8 c6) / (4 c2)
    Ad = [[R, [t]x R], [0, R]],         Ad^-1 = [[R', -R' [t]x], [0, R']]

Q and U are the derivatives of V and of V^-1 along rho: with x = |w|^2, dx = 2 b and dc_k/dx = (k c_{k+2} - c_{k+1})/2.
Source: T. Barfoot, State Estimation for Robotics, 2017, equations (7.86) and (7.95); rewritten in Stumpff functions,
where nothing cancels near 0, and without the products of three and four matrices: KPK = -b K.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, apply, components, dot, matrix, pack, product, skew, stumpff
from models.errors import GraphError
from models.finite import finite
from models.manifolds.base import LieGroup, block_triangular
from models.manifolds.rigid import rigid_parts
from models.manifolds.se2 import SE2
from models.manifolds.so3 import (
    IDENTITY,
    SO3,
    conjugate_product,
    not_unit,
    quaternion_from_matrix,
    quaternion_product,
    quaternion_vector,
    quaternion_vector_jl,
    quaternion_vector_jr,
    rotation3,
    upper_half,
    w_minus_v,
    w_plus_v,
)

__all__ = ["SE3"]

_ZERO = matrix([[0.0] * 3] * 3)


def split(X: npt.ArrayLike) -> tuple[Array, Array]:
    """Translation (..., 3) and quaternion (..., 4) of poses (..., 7)."""
    X = np.asarray(X, dtype=float)
    return X[..., :3], X[..., 3:]


def join(t: Array, q: Array) -> Array:
    """Poses (..., 7) of translations (..., 3) and quaternions (..., 4)."""
    return np.concatenate([t, q], axis=-1)


class PosesOfSpace(LieGroup):
    """SE(3): a o b = (t_a + R_a t_b, q_a q_b).

    Examples
    --------
    >>> import numpy as np
    >>> T = SE3.exp([1.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2])
    >>> SE3.act(T, [0.0, 0.0, 1.0]).round(6)
    array([0.63662, 0.63662, 1.     ])
    """

    name, dim, size, point_dim = "SE3", 6, 7, 3
    components = ("x", "y", "z", "roll", "pitch", "yaw")
    body_axes = True

    def from_matrix(self, T: npt.ArrayLike) -> Array:
        """Poses (7,) or (n, 7) of homogeneous matrices (4, 4) or (n, 4, 4), body to world; `matrix` is the inverse.

        Raises
        ------
        GraphError
            No such matrices; a matrix that is no rigid motion, by more than 0.001 in an entry of R'R.

        Examples
        --------
        >>> SE3.from_matrix([[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]).round(6)
        array([5.      , 6.      , 7.      , 0.      , 0.      , 0.707107, 0.707107])
        """
        R, t = rigid_parts("SE3.from_matrix", T, 3)
        return join(t, quaternion_from_matrix(R))

    def from_rpy(
        self,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        z: npt.ArrayLike,
        roll: npt.ArrayLike,
        pitch: npt.ArrayLike,
        yaw: npt.ArrayLike,
    ) -> Array:
        """Poses (7,), or (n, 7) where some of the numbers are (n,): R = Rz(yaw) Ry(pitch) Rx(roll), m and rad.

        `models.euler.from_se3` is the inverse.

        Raises
        ------
        GraphError
            Arrays of different lengths; a number that is not finite.

        Examples
        --------
        >>> import numpy as np
        >>> SE3.from_rpy(1, 2, [3, 4], 0, 0, np.radians(90)).round(6)
        array([[1.      , 2.      , 3.      , 0.      , 0.      , 0.707107, 0.707107],
               [1.      , 2.      , 4.      , 0.      , 0.      , 0.707107, 0.707107]])
        """
        from models.manifolds import euler  # which builds on this file

        names = ("roll", "pitch", "yaw", "x", "y", "z")
        given = zip(names, (roll, pitch, yaw, x, y, z), strict=True)
        numbers = [finite("SE3.from_rpy", name, value) for name, value in given]
        try:
            state = np.stack(np.broadcast_arrays(*numbers), axis=-1)
        except ValueError as error:
            shapes = ", ".join(f"{name} {number.shape}" for name, number in zip(names, numbers, strict=True))
            raise GraphError(f"SE3.from_rpy: the shapes differ: {shapes}; give one number, or n, of each") from error
        return euler.to_se3(state)

    def exp(self, delta: npt.ArrayLike) -> Array:
        delta = np.asarray(delta, dtype=float)
        rho, w = delta[..., :3], delta[..., 3:]
        K, (c2, c3) = skew(w), stumpff(dot(w, w)[..., None], 2, 3)
        turned = apply(K, rho)
        return join(rho + c2 * turned + c3 * apply(K, turned), SO3.exp(w))

    def log(self, X: npt.ArrayLike) -> Array:
        t, q = split(X)
        w = SO3.log(q)
        c2, c3, c4 = stumpff(dot(w, w)[..., None], 2, 3, 4)
        K = skew(w)
        turned = apply(K, t)
        return np.concatenate([t - 0.5 * turned + (c3 - 2 * c4) / (2 * c2) * apply(K, turned), w], axis=-1)

    def coordinates(self, X: Array) -> Array:
        return np.concatenate([X[:, :3], 2 * X[:, 3:6]], axis=1)  # of a turn, 2 sin(angle / 2)

    def compose(self, X: npt.ArrayLike, Y: npt.ArrayLike) -> Array:
        (ta, qa), (tb, qb) = split(X), split(Y)
        return join(ta + apply(rotation3(qa), tb), quaternion_product(qa, qb))

    def inverse(self, X: npt.ArrayLike) -> Array:
        t, q = split(X)
        q = SO3.inverse(q)
        return join(-apply(rotation3(q), t), q)

    def between(self, X: npt.ArrayLike, Y: npt.ArrayLike) -> Array:
        (ta, qa), (tb, qb) = split(X), split(Y)
        qa = SO3.inverse(qa)
        return join(apply(rotation3(qa), tb - ta), quaternion_product(qa, qb))

    def framed(self, X: Array) -> Array:
        if X.shape[-1] > self.size:
            return X
        R = rotation3(X[:, 3:])
        return components(np.concatenate([X.T, R.transpose(1, 2, 0).reshape(9, -1)]))

    def misfit(self, X: Array, Y: Array, Z: Array, jacobians: bool = True) -> tuple[Array, Array | None]:
        (ta, qa, Ra), (tb, qb, Rb), (tz, qz, Rz) = map(_framed_parts, (X, Y, Z))
        h, turned = apply(Ra.mT, tb - ta), Rz.mT
        q = upper_half(conjugate_product(qz, conjugate_product(qa, qb)))
        off = np.concatenate([apply(turned, h - tz).T, q[:, :3].T]).T
        if not jacobians:
            return off, None
        q *= 0.5
        J = np.zeros((len(h), 6, 12))
        J[:, :3, :3], J[:, :3, 3:6], J[:, 3:, 3:6] = -turned, product(turned, skew(h)), -product(w_minus_v(q), turned)
        J[:, :3, 6:9], J[:, 3:, 9:] = product(product(Ra, Rz).mT, Rb), w_plus_v(q)
        return off, J

    def adjoint(self, X: npt.ArrayLike) -> Array:
        t, q = split(X)
        R = rotation3(q)
        return block_triangular(R, product(skew(t), R), R)

    def adjoint_inverse(self, X: npt.ArrayLike) -> Array:
        t, q = split(X)
        R_inv = rotation3(SO3.inverse(q))
        return block_triangular(R_inv, -product(R_inv, skew(t)), R_inv)

    def jl(self, delta: npt.ArrayLike) -> Array:
        delta = np.asarray(delta, dtype=float)
        x, b, K, KK, P, S = _products(delta)
        c2, c3, c4, c5 = stumpff(x, 2, 3, 4, 5)
        V = IDENTITY + c2 * K + c3 * KK
        Q = c2 * P + c3 * S + b * ((2 * c4 - c3) * K + (3 * c5 - c4) * KK)
        return block_triangular(V, Q, V)

    def jl_inv(self, delta: npt.ArrayLike) -> Array:
        delta = np.asarray(delta, dtype=float)
        x, b, K, KK, P, S = _products(delta)
        c2, c3, c4, c5, c6 = stumpff(x, 2, 3, 4, 5, 6)
        d = (c3 - 2 * c4) / (2 * c2)
        V_inv = IDENTITY - 0.5 * K + d * KK
        U = -0.5 * P + d * S + 2 * b * (d * d + (5 * c5 - c4 - 8 * c6) / (4 * c2)) * KK
        return block_triangular(V_inv, U, V_inv)

    def motion(self, X0: Array, X: Array) -> tuple[Array, Array]:
        r"""How far X was moved from X0, with depth and tilt apart from what gravity leaves free, and its derivative J.

        .. math:: c = (s_1, s_2, \, z - z_0, \, M_{32}, -M_{31}, \, \psi), \quad M = R R_0^T, \quad
                  \psi = \mathrm{atan2}(M_{21}, M_{11}), \quad s = \mathrm{Log}(x - x_0, \, y - y_0, \, \psi)

        A shift in the plane and a turn about any vertical axis change s alone, and from X0 along a straight line. M
        may tilt by less than 90 degrees.
        """
        M = product(self.rotation(X), self.rotation(X0).mT)
        M11, M12, M21, M22, M31, M32 = (M[..., i, j] for i in range(3) for j in range(2))
        dx, dy, dz = components(self.position(X) - self.position(X0))
        shift = pack([dx, dy, np.arctan2(M21, M11)])
        s = SE2.log(shift)
        k = -M31 / (M11 * M11 + M21 * M21)  # of the change of psi with a tilt of the world
        P = product(SE2.jr_inv(s), SE2.vector_jr(shift).mT)
        p, q, f, u, v, g = (P[..., i, j] for i in range(2) for j in range(3))
        J = matrix(
            [
                [p, q, 0.0, f * k * M11, f * k * M21, f],
                [u, v, 0.0, g * k * M11, g * k * M21, g],
                [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
                [0.0, 0.0, 0.0, M22, -M12, 0.0],
                [0.0, 0.0, 0.0, -M21, M11, 0.0],
                [0.0, 0.0, 0.0, k * M11, k * M21, 1.0],
            ]
        )
        s1, s2, psi = components(s)
        return pack([s1, s2, dz, M32, -M31, psi]), product(J, self.world_axes(X))

    def vector(self, X: npt.ArrayLike) -> Array:
        t, q = split(X)
        return np.concatenate([t, quaternion_vector(q)], axis=-1)

    def vector_jl(self, X: npt.ArrayLike) -> Array:
        t, q = split(X)
        return block_triangular(np.eye(3), -skew(t), quaternion_vector_jl(q))

    def vector_jr(self, X: npt.ArrayLike) -> Array:
        _, q = split(X)
        return block_triangular(rotation3(q), _ZERO, quaternion_vector_jr(q))

    def world_axes(self, X: Array) -> Array:
        R = self.rotation(X)
        return block_triangular(R, _ZERO, R)

    def euler_axes(self, X: Array) -> Array:
        from models.manifolds import euler  # which builds on this file

        T_inv = euler.rate_matrix_inv(euler.angles_from_quaternion(split(X)[1]))
        turned = block_triangular(self.rotation(X), _ZERO, T_inv)  # (x, y, z, roll, pitch, yaw)
        return turned[..., [3, 4, 5, 0, 1, 2], :]

    def rotation(self, X: npt.ArrayLike) -> Array:
        return rotation3(split(X)[1])

    def identity(self, n: int = 1) -> Array:
        return np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (n, 1))

    def position(self, X: Array) -> Array:
        return X[..., :3]

    def invalid(self, X: Array) -> tuple[int, str] | None:
        return super().invalid(X) or not_unit(X[..., 3:])


def _framed_parts(X: Array) -> tuple[Array, Array, Array]:
    """Translations (n, 3), quaternions (n, 4) and rotation matrices (n, 3, 3) of poses with their frames (n, 16)."""
    return X[:, :3], X[:, 3:7], X.T[7:].reshape(3, 3, -1).transpose(2, 0, 1)


def _products(delta: Array) -> tuple[Array, ...]:
    """|w|^2 and w'rho (..., 1, 1), K, K^2, P and KP + PK (..., 3, 3) of delta = (rho, w)."""
    rho, w = delta[..., :3], delta[..., 3:]
    K, P = skew(w), skew(rho)
    KP = product(K, P)
    return dot(w, w)[..., None, None], dot(w, rho)[..., None, None], K, product(K, K), P, KP + KP.mT


SE3 = PosesOfSpace()
