r"""A car: rear wheels that roll, front wheels that steer by the angle alpha, and a point on it whose motion is wanted.

An encoder sits on a wheel of the rear axle, a distance H to the left of its middle. v_e is the speed of that wheel, and
L the distance of the axles. The point is at (a, b), ahead of the middle of the rear axle and to the left of it:

    v = v_e / (1 - H tan(alpha) / L),   w = v tan(alpha) / L         of the middle of the rear axle
    twist = (v - b w, a w, w)                                        of the point, along the axes of the vehicle

    d(v, w)/d(v_e, alpha) = [[1/D, v H q / (L D)], [tan(alpha) / (L D), v q / (L D)]],   D = 1 - H tan(alpha) / L,
                                                                                        q = 1 + tan(alpha)^2

Axes: x ahead, y to the *left*; the vehicle turns to the left for alpha > 0. Source: J. Guivant, E. Nebot, "Optimization
of the simultaneous localization and map-building algorithm for real-time implementation", IEEE Transactions on Robotics
and Automation 17(3), 2001; the derivatives are written out here.
"""

from __future__ import annotations

from math import inf

import numpy as np
import numpy.typing as npt

from models.algebra import Array, components, matrix, pack
from models.options import check_between

__all__ = ["ackermann"]


def ackermann(
    u: npt.ArrayLike, wheelbase: float, encoder: float = 0.0, at: tuple[float, float] = (0.0, 0.0)
) -> tuple[Array, Array]:
    """Velocity of a point of a car.

    Parameters
    ----------
    u : (n, 2) speed of the wheel with the encoder, m/s, negative backwards; and steering angle, rad.
    wheelbase : L, distance of the axles, m.
    encoder : H, how far to the left of the middle of the rear axle the wheel with the encoder is, m.
    at : (a, b), the point, ahead of the middle of the rear axle and to the left of it, m.

    Returns
    -------
    twist : (n, 3) velocity ahead and to the left, m/s, and rate of turn, rad/s.
    F_u : (n, 3, 2) its derivative by u.

    Raises
    ------
    OptionError
        A wheelbase that is not above 0.

    Examples
    --------
    A car of 2.83 m that steers by 0.2 rad, seen from its front bumper:

    >>> twist, _ = ackermann([[2.0, 0.2]], wheelbase=2.83, at=(3.78, 0.5))
    >>> twist.round(4)
    array([[1.9284, 0.5415, 0.1433]])
    """
    speed, alpha = components(u)
    L = check_between("ackermann: wheelbase", wheelbase, 0, inf, "the distance of the axles, m, above 0")
    H, (a, b) = encoder, at
    tan = np.tan(alpha)
    D, q = 1 - H * tan / L, 1 + tan * tan
    v = speed / D
    w = v * tan / L
    J_vw = matrix([[1 / D, v * H * q / (L * D)], [tan / (L * D), v * q / (L * D)]])
    to_point = np.array([[1.0, -b], [0.0, a], [0.0, 1.0]])
    return pack([v - b * w, a * w, w]), np.asarray(to_point @ J_vw)
