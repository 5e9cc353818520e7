r"""Yaw of a pose: the angle itself in the plane, in space that of R = Rz(yaw) Ry(pitch) Rx(roll).

    yaw = atan2(R21, R11)
    d yaw / d phi = (0, sin roll, cos roll) / cos pitch = (0, R32, R33) / (R11^2 + R21^2),     phi: right increment

Translation has no part in it. At pitch = +-90 deg (gimbal lock) roll and yaw are one number, and yaw has no value.

Source: J. Diebel, "Representing attitude", Stanford, 2006, section 5.6.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, matrix, pack, wrap
from models.manifolds.base import LieGroup
from models.manifolds.euler import GIMBAL_LOCK
from models.sensors.singular import refuse

__all__ = ["heading", "refuse_gimbal_lock"]


def heading(group: LieGroup, X: Array) -> tuple[Array, Array]:
    """Yaw of poses.

    Parameters
    ----------
    group : SE2 or SE3.
    X : (n, size) poses, body to world.

    Returns
    -------
    yaw : (n, 1) array, rad, in [-pi, pi).
    H_X : (n, 1, dim) array.

    Raises
    ------
    SingularAt
        A pose in space at gimbal lock.

    Examples
    --------
    >>> import numpy as np
    >>> from models import SE3
    >>> yaw, H = heading(SE3, SE3.exp(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.7]])))
    >>> yaw.round(6), H.round(6)
    (array([[0.7]]), array([[[0., 0., 0., 0., 0., 1.]]]))
    """
    if group.point_dim == 2:
        return wrap(X[:, 2:].copy()), np.array([[[0.0, 0.0, 1.0]]])
    R = group.rotation(X)
    R11, R21, R32, R33 = R[:, 0, 0], R[:, 1, 0], R[:, 2, 1], R[:, 2, 2]
    cos2 = refuse_gimbal_lock(R)
    return pack([wrap(np.arctan2(R21, R11))]), matrix([[0.0, 0.0, 0.0, 0.0, R32 / cos2, R33 / cos2]])


def refuse_gimbal_lock(R: Array) -> Array:
    """cos^2 pitch (n,) of rotations R (n, 3, 3), body to world.

    Raises
    ------
    SingularAt
        A rotation at gimbal lock.
    """
    R11, R21 = R[:, 0, 0], R[:, 1, 0]
    cos2 = np.asarray(R11 * R11 + R21 * R21)
    refuse(
        cos2 < GIMBAL_LOCK**2,
        "the pose is at gimbal lock (pitch = +-90 deg), where yaw is not defined; measure its attitude by a Prior",
    )
    return cos2
