r"""A vehicle on two driven wheels, or two tracks, a base b apart: how far each has rolled, and where that leads.

    ds = (ds_r + ds_l) / 2,   dth = (ds_r - ds_l) / b,   h = dth / 2,   c, s = cos h, sin h
    X_j = X_i o E,            E = (ds c, ds s, dth)               the way ds is gone in the middle of the turn

    F_X = Ad(E)^-1,           F_u = [[ c/2 + k s,  c/2 - k s],    k = ds / (2 b)
                                     [-s/2 + k c, -s/2 - k c],
                                     [ 1/b,       -1/b      ]]    columns (ds_r, ds_l), in the axes of X_j

and the other way, from two poses to the travel of the wheels and the slip across. With (dx, dy, dth) = X_i^-1 X_j:

    ds = c dx + s dy,   lat = -s dx + c dy,   travel = (ds + b h, ds - b h, lat)

    H_i = [[-c, -s, lat/2 - b/2], [-c, -s, lat/2 + b/2], [s, -c, -ds/2]]
    H_j = [[ c, -s, lat/2 + b/2], [ c, -s, lat/2 - b/2], [s,  c, -ds/2]]

Axes: x ahead, y to the *left*, so that a faster right wheel turns the vehicle by a positive angle. Where y points to
the right (z down), exchange right and left.

ds is an arc and E takes it for the chord. The chord is ds sin(h) / h, shorter by dth^2 / 24 of it. That is 0.03 % in a
step that turns by 5 deg, 1.1 % at 30 deg, 10 % at 90 deg. Keep the turns of a step small. Two poses do not say how
often the vehicle went round between them: a step turns by less than 180 deg.

Source: R. Siegwart, I. Nourbakhsh, D. Scaramuzza, Introduction to Autonomous Mobile Robots, 2011, section 5.2.4, for
the motion; the derivatives are for increments X Exp(delta), and the slip is added here.
"""

from __future__ import annotations

from math import inf

import numpy as np
import numpy.typing as npt

from models.algebra import Array, components, matrix, pack
from models.manifolds.se2 import SE2
from models.options import check_between

__all__ = ["differential_drive", "travel_sigmas", "wheel_travel"]


def differential_drive(X: Array, u: npt.ArrayLike, base: float) -> tuple[Array, tuple[Array, Array]]:
    """Where the wheels take a vehicle.

    Parameters
    ----------
    X : (n, 3) poses SE2, body to world.
    u : (n, 2) travel of the right and of the left wheel, m, negative backwards.
    base : distance of the wheels, m.

    Returns
    -------
    X_j : (n, 3) poses after the step.
    F_X, F_u : (n, 3, 3) and (n, 3, 2), from increments of X and of u to increments of X_j.

    Raises
    ------
    OptionError
        A base that is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> differential_drive(np.array([[1.0, 2.0, np.pi / 2]]), [[1.1, 0.9]], base=0.5)[0].round(4)
    array([[0.8013, 2.9801, 1.9708]])
    """
    base = check_base("differential_drive: base", base)
    right, left = components(u)
    ds, h = (right + left) / 2, (right - left) / (2 * base)
    c, s, k = np.cos(h), np.sin(h), ds / (2 * base)
    E = pack([ds * c, ds * s, 2 * h])
    F_u = matrix([[c / 2 + k * s, c / 2 - k * s], [-s / 2 + k * c, -s / 2 - k * c], [1 / base, -1 / base]])
    return SE2.compose(X, E), (SE2.adjoint_inverse(E), F_u)


def wheel_travel(X_i: Array, X_j: Array, base: float) -> tuple[Array, tuple[Array, Array]]:
    """How far the wheels rolled from one pose to the next, and how far the vehicle slipped across.

    Parameters
    ----------
    X_i, X_j : (n, 3) poses SE2, body to world; less than half a turn apart.
    base : distance of the wheels, m.

    Returns
    -------
    h : (n, 3) travel of the right and of the left wheel, and across, along y, m.
    H_i, H_j : (n, 3, 3).

    Raises
    ------
    OptionError
        A base that is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> X = np.array([[1.0, 2.0, np.pi / 2], [0.8013, 2.9801, 1.9708]])
    >>> wheel_travel(X[:1], X[1:], base=0.5)[0].round(3) + 0.0
    array([[1.1, 0.9, 0. ]])
    """
    base = check_base("wheel_travel: base", base)
    dx, dy, dth = components(SE2.between(X_i, X_j))
    h, b = dth / 2, base / 2
    c, s = np.cos(h), np.sin(h)
    ds, lat = c * dx + s * dy, c * dy - s * dx
    H_i = matrix([[-c, -s, lat / 2 - b], [-c, -s, lat / 2 + b], [s, -c, -ds / 2]])
    H_j = matrix([[c, -s, lat / 2 + b], [c, -s, lat / 2 - b], [s, c, -ds / 2]])
    return pack([ds + base * h, ds - base * h, lat]), (H_i, H_j)


def check_base(option: str, base: float) -> float:
    """The distance of two wheels, m.

    Raises
    ------
    OptionError
        No number above 0.
    """
    return check_between(option, base, 0, inf, "the distance of the wheels, m, above 0")


def travel_sigmas(u: npt.ArrayLike, right: float, left: float, lateral: float) -> Array:
    """Standard deviations of wheel travel whose variance grows with the way, sigma^2 = k^2 |ds|, and of the slip.

    Parameters
    ----------
    u : (n, 2) travel of the right and of the left wheel, m.
    right, left : k of each wheel, m after 1 m of way.
    lateral : of the slip, m. Wheels leave it out, but three numbers move between two poses and two are measured.

    Returns
    -------
    (n, 3) array, m: 0 for a wheel that stood still, which no noise model accepts.

    Examples
    --------
    >>> travel_sigmas([[0.25, 1.0]], 0.01, 0.01, 0.001)
    array([[0.005, 0.01 , 0.001]])
    """
    ds_r, ds_l = components(u)
    return pack([right * np.sqrt(np.abs(ds_r)), left * np.sqrt(np.abs(ds_l)), lateral])
