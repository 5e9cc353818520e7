r"""Navigation of a hovering vehicle: relative (x, y, heading) and absolute (z, pitch, roll).

Depth, pitch and roll are measured without drift; x, y and heading are integrated and drift. With a pose X = (R, t),
R = Rz(yaw) Ry(pitch) Rx(roll) body to world, and its right increment (rho, phi):

    dt = R rho,   d yaw = w_yaw' phi,     w_yaw   = (0, sin roll, cos roll) / cos pitch
                  d pitch = w_pitch' phi, w_pitch = (0, cos roll, -sin roll)
                  d roll = w_roll' phi,   w_roll  = (1, sin roll tan pitch, cos roll tan pitch)

    levelled    h = (Rz(yaw_i)' (t_j - t_i), yaw_j - yaw_i), the first two components of the vector
                H_i = [[-Rz(yaw_i)' R_i, (h_y, -h_x, 0)' w_yaw_i'], [0, -w_yaw_i']]
                H_j = [[ Rz(yaw_i)' R_j, 0                       ], [0,  w_yaw_j']]
    relative    h = (x, y, yaw) of E = X_i^-1 X_j
                H_j = [[R_E, 0], [0, w_yaw_E']],   H_i = -H_j Ad(E)^-1

The two agree only where roll and pitch are 0 and at one depth. `levelled` is what a vehicle that knows its tilt
integrates: velocities turned into the horizontal. At pitch = +-90 deg (gimbal lock) yaw and roll have no value.

Source: J. Diebel, "Representing attitude", Stanford, 2006, sections 5.6 and 8.2, for the angles; the derivatives follow
from R Exp(phi) = R + R [phi]x + ... and are written out on the page on sonar.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, apply, components, matrix, pack, product, wrap
from models.manifolds import SE3, euler
from models.sensors.heading import heading, refuse_gimbal_lock

__all__ = ["levelled", "relative_xyh", "zpr"]


def levelled(X_i: Array, X_j: Array) -> tuple[Array, tuple[Array, Array]]:
    """Step from pose i to pose j in the horizontal axes of pose i: ahead, to starboard, and turned.

    Parameters
    ----------
    X_i, X_j : (n, 7) poses SE3, body to world.

    Returns
    -------
    h : (n, 3) x and y, m, and yaw, rad, in [-pi, pi).
    H_i, H_j : (n, 3, 6).

    Raises
    ------
    SingularAt
        A pose at gimbal lock.

    Examples
    --------
    >>> import numpy as np
    >>> from models import euler
    >>> X = euler.to_se3([[0.0, 0.2, np.pi / 2, 1.0, 2.0, 5.0], [0.1, 0.0, np.pi, 1.0, 5.0, 4.0]])
    >>> levelled(X[:1], X[1:])[0].round(4)
    array([[3.    , 0.    , 1.5708]])
    """
    (yaw_i, w_i), (yaw_j, w_j) = heading(SE3, X_i), heading(SE3, X_j)
    Rz_inv = _turn_back(yaw_i[:, 0])  # (n, 3, 3)
    x, y, _ = components(apply(Rz_inv, SE3.position(X_j) - SE3.position(X_i)))
    h = pack([x, y, wrap((yaw_j - yaw_i)[:, 0])])
    H_i, H_j = _rows(-product(Rz_inv, SE3.rotation(X_i)), -w_i), _rows(product(Rz_inv, SE3.rotation(X_j)), w_j)
    H_i[:, :2] += product(pack([y, -x])[..., None], w_i)
    return h, (H_i, H_j)


def relative_xyh(X_i: Array, X_j: Array) -> tuple[Array, tuple[Array, Array]]:
    """The components x, y and yaw of the relative pose X_i^-1 X_j, in the tilted axes of pose i.

    Parameters, result and exception as for `levelled`; gimbal lock is that of the relative pose.

    Examples
    --------
    >>> import numpy as np
    >>> from models import euler
    >>> X = euler.to_se3([[0.0, 0.2, 0.0, 0.0, 0.0, 5.0], [0.0, 0.2, 0.0, 1.0, 0.0, 5.0]])
    >>> relative_xyh(X[:1], X[1:])[0].round(4), levelled(X[:1], X[1:])[0].round(4)
    (array([[0.9801, 0.    , 0.    ]]), array([[1., 0., 0.]]))
    """
    E = SE3.between(X_i, X_j)
    yaw, w = heading(SE3, E)
    H_j = _rows(SE3.rotation(E), w)
    x, y, _ = components(SE3.position(E))
    return pack([x, y, yaw[:, 0]]), (-product(H_j, SE3.adjoint_inverse(E)), H_j)


def zpr(X: Array) -> tuple[Array, Array]:
    """Depth, pitch and roll of poses.

    Parameters
    ----------
    X : (n, 7) poses SE3, body to world.

    Returns
    -------
    h : (n, 3) z, m, pitch and roll, rad.
    H : (n, 3, 6).

    Raises
    ------
    SingularAt
        A pose at gimbal lock.

    Examples
    --------
    >>> from models import euler
    >>> zpr(euler.to_se3([[0.1, -0.2, 0.3, 1.0, 2.0, 5.0]]))[0].round(6)
    array([[ 5. , -0.2,  0.1]])
    """
    R = SE3.rotation(X)
    refuse_gimbal_lock(R)
    angles = euler.angles_from_quaternion(X[:, 3:])
    H = np.zeros((len(X), 3, 6))
    H[:, 0, :3] = R[:, 2]  # dz = (R rho)_z
    H[:, 1:, 3:] = euler.rate_matrix_inv(angles)[:, [1, 0]]  # w_pitch', w_roll'
    roll, pitch, _ = components(angles)
    return pack([SE3.position(X)[:, 2], pitch, roll]), H


def _turn_back(yaw: Array) -> Array:
    """Rz(yaw)' (n, 3, 3)."""
    c, s = np.cos(yaw), np.sin(yaw)
    return matrix([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _rows(R: Array, w: Array) -> Array:
    """[[first two rows of R, 0], w] (n, 3, 6), of R (n, 3, 3) and w (n, 1, 6)."""
    H = np.zeros((len(R), 3, 6))
    H[:, :2, :3] = R[:, :2]
    H[:, 2:] = w
    return H
