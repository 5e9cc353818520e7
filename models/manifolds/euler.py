r"""Roll, pitch and yaw, and the Euler 6-vector (roll, pitch, yaw, x, y, z) of a vehicle pose, z down.

    R = Rz(yaw) Ry(pitch) Rx(roll),                       body to world
    roll = atan2(R32, R33),  pitch = atan2(-R31, hypot(R11, R21)),  yaw = atan2(R21, R11)
    w = T d(roll, pitch, yaw)                             w: right (body) rotation increment, rad
    T = [[1, 0, -sin pitch], [0, cos roll, sin roll cos pitch], [0, -sin roll, cos roll cos pitch]],  det T = cos pitch

At pitch = +-90 deg (gimbal lock) roll and yaw are no longer two numbers but one; functions that would have to choose
raise `SingularGeometryError`. (roll, pitch, yaw) and (roll + pi, pi - pitch, yaw + pi) are the same rotation. Pitch in
[-pi/2, pi/2] is the canonical form, and the one returned.

Source: J. Diebel, "Representing attitude", Stanford, 2006, sections 5.6 and 8.2.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array, components, matrix, pack, wrap
from models.errors import OptionError, SingularGeometryError
from models.manifolds.se3 import SE3, join
from models.manifolds.so3 import rotation3

__all__ = [
    "angles_from_quaternion",
    "covariance_from_se3",
    "covariance_to_se3",
    "from_se3",
    "quaternion_from_angles",
    "rate_matrix",
    "rate_matrix_inv",
    "to_se3",
]

GIMBAL_LOCK = 1e-6  # cos(pitch) below this (0.00006 deg from vertical): ten digits of roll and yaw are noise


def quaternion_from_angles(rpy: npt.ArrayLike) -> Array:
    """Unit quaternions (..., 4) of (roll, pitch, yaw) (..., 3), rad.

    Examples
    --------
    >>> import numpy as np
    >>> quaternion_from_angles([0.0, 0.0, np.pi / 2]).round(6)
    array([0.      , 0.      , 0.707107, 0.707107])
    """
    roll, pitch, yaw = components(rpy) / 2
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    return pack(
        [
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
            cy * cp * cr + sy * sp * sr,
        ]
    )


def angles_from_quaternion(q: npt.ArrayLike) -> Array:
    """(roll, pitch, yaw) (..., 3), rad, pitch in [-pi/2, pi/2], of quaternions (..., 4).

    Raises
    ------
    SingularGeometryError
        At gimbal lock, |pitch| = 90 deg, where roll and yaw are not two numbers.

    Examples
    --------
    >>> angles_from_quaternion(quaternion_from_angles([0.1, -0.2, 0.3])).round(12)
    array([ 0.1, -0.2,  0.3])
    """
    x, y, z, w = components(q)
    s = 2 / (x * x + y * y + z * z + w * w)
    r11, r21, r31 = 1 - s * (y * y + z * z), s * (x * y + w * z), s * (x * z - w * y)
    r32, r33 = s * (y * z + w * x), 1 - s * (x * x + y * y)
    cos_pitch = np.hypot(r11, r21)
    _refuse_gimbal_lock(cos_pitch)
    return pack([wrap(np.arctan2(r32, r33)), np.arctan2(-r31, cos_pitch), wrap(np.arctan2(r21, r11))])


def rate_matrix(rpy: npt.ArrayLike) -> Array:
    """T (..., 3, 3): body rotation increment from increments of roll, pitch and yaw."""
    roll, pitch, _ = components(rpy)
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    return matrix([[1.0, 0.0, -sp], [0.0, cr, sr * cp], [0.0, -sr, cr * cp]])


def rate_matrix_inv(rpy: npt.ArrayLike) -> Array:
    """T^-1 (..., 3, 3): increments of roll, pitch and yaw from a body rotation increment.

    Raises
    ------
    SingularGeometryError
        At gimbal lock, where T has no inverse.
    """
    roll, pitch, _ = components(rpy)
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    _refuse_gimbal_lock(np.abs(cp))
    return matrix([[1.0, sr * sp / cp, cr * sp / cp], [0.0, cr, -sr], [0.0, sr / cp, cr / cp]])


def to_se3(state: npt.ArrayLike) -> Array:
    """SE(3) poses (..., 7) of Euler 6-vectors (roll, pitch, yaw, x, y, z) (..., 6).

    Raises
    ------
    OptionError
        Not 6 numbers a vector.
    """
    state = np.asarray(state, dtype=float)
    if state.shape[-1:] != (6,):
        raise OptionError("state", state.shape, "a shape of (..., 6): roll, pitch, yaw, x, y, z")
    return join(state[..., 3:], quaternion_from_angles(state[..., :3]))


def from_se3(T: npt.ArrayLike) -> Array:
    """Euler 6-vectors (roll, pitch, yaw, x, y, z) (..., 6) of SE(3) poses (..., 7).

    Raises
    ------
    SingularGeometryError
        At gimbal lock.
    """
    T = np.asarray(T, dtype=float)
    return np.concatenate([angles_from_quaternion(T[..., 3:]), SE3.position(T)], axis=-1)


def covariance_to_se3(state: npt.ArrayLike, P: npt.ArrayLike) -> Array:
    """Covariances (..., 6, 6) in the tangent space of SE(3), translation first, body axes, from those of Euler vectors.

    The tangent step of errors d of the Euler vector is (R' d(x, y, z), T d(roll, pitch, yaw)).

    Parameters
    ----------
    state : (..., 6) roll, pitch, yaw, x, y, z, rad and m, where the covariances hold.
    P : (..., 6, 6) covariances of that vector.

    Examples
    --------
    >>> import numpy as np
    >>> level = np.zeros(6)
    >>> np.diag(covariance_to_se3(level, np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))).tolist()
    [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]
    """
    state = np.asarray(state, dtype=float)
    G = np.zeros((*state.shape[:-1], 6, 6))
    G[..., :3, 3:] = rotation3(quaternion_from_angles(state[..., :3])).mT
    G[..., 3:, :3] = rate_matrix(state[..., :3])
    return np.asarray(G @ np.asarray(P, dtype=float) @ G.mT)


def covariance_from_se3(T: npt.ArrayLike, Sigma: npt.ArrayLike) -> Array:
    """Covariances (..., 6, 6) of Euler vectors (roll, pitch, yaw, x, y, z) from those in the tangent space at T.

    Parameters
    ----------
    T : (..., 7) poses SE3.
    Sigma : (..., 6, 6) covariances of tangent steps, translation first, in body axes.

    Raises
    ------
    SingularGeometryError
        At gimbal lock.

    Examples
    --------
    >>> import numpy as np
    >>> T, P = to_se3([0.1, -0.2, 0.3, 1.0, 2.0, 5.0]), np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    >>> np.diag(covariance_from_se3(T, covariance_to_se3(from_se3(T), P))).round(9).tolist()
    [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    """
    J = SE3.euler_axes(np.asarray(T, dtype=float))
    return np.asarray(J @ np.asarray(Sigma, dtype=float) @ J.mT)


def _refuse_gimbal_lock(cos_pitch: Array) -> None:
    bad = np.atleast_1d(cos_pitch < GIMBAL_LOCK)
    if bad.any():
        raise SingularGeometryError(
            f"Euler angles: element {int(np.argmax(bad))} of the batch is at gimbal lock (pitch = +-90 deg), where "
            "roll and yaw are not two numbers; keep the state on SE3 and use its rotation vector"
        )
