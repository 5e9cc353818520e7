r"""Direction of a point: bearing in the plane, azimuth and elevation in space. x forward, y to starboard, z down.

    plane   bearing = atan2(y, x),                         J = [-y, x] / r^2
    space   azimuth = atan2(y, x),                         J = [-y, x, 0] / rho^2,        rho = hypot(x, y)
            elevation = atan2(z, rho)                      J = [-x z / rho, -y z / rho, rho] / r^2

Positive elevation is on the side of z: below the sensor where z points down. On the z axis (rho = 0) the azimuth is not
defined, in the plane at the sensor itself. The inverse, for start values and pictures:

    p = r (cos bearing, sin bearing)       p = r (cos azimuth cos elevation, sin azimuth cos elevation, sin elevation)
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, components, matrix, pack, wrap
from models.sensors.singular import CLOSE, refuse

__all__ = ["direction", "point_from_direction_range"]


def direction(p: Array) -> tuple[Array, Array]:
    """Bearing, or azimuth and elevation, of points p in the frame of the sensor.

    Parameters
    ----------
    p : (n, 2 or 3) array, m.

    Returns
    -------
    h : (n, 1) bearing or (n, 2) azimuth and elevation, rad, in [-pi, pi).
    J : (n, 1, 2) or (n, 2, 3), rad/m.

    Raises
    ------
    SingularAt
        A point nearer than `CLOSE` to the sensor (plane) or to its z axis (space).

    Examples
    --------
    >>> import numpy as np
    >>> direction(np.array([[0.0, 2.0, -2.0]]))[0] / np.pi
    array([[ 0.5 , -0.25]])
    """
    x, y, *z = components(p)
    rho = np.sqrt(x * x + y * y)
    where = "on the z axis of the sensor, where its azimuth" if z else "at the sensor itself, where its bearing"
    refuse(rho < CLOSE, f"the target is {where} is not defined; change its initial value")
    ux, uy = x / rho, y / rho
    azimuth = wrap(np.arctan2(y, x))
    if not z:
        return pack([azimuth]), matrix([[-uy / rho, ux / rho]])
    r2 = rho * rho + z[0] * z[0]
    k = z[0] / r2
    return pack([azimuth, np.arctan2(z[0], rho)]), matrix([[-uy / rho, ux / rho, 0.0], [-ux * k, -uy * k, rho / r2]])


def point_from_direction_range(z: Array) -> Array:
    """Points (n, 2 or 3), m, from (bearing, range) (n, 2) or (azimuth, elevation, range) (n, 3), rad and m.

    Examples
    --------
    >>> import numpy as np
    >>> point_from_direction_range(np.array([[np.pi / 2, 0.0, 4.0]])).round(6)
    array([[0., 4., 0.]])
    """
    azimuth, *elevation, r = components(z)
    flat = r * np.cos(elevation[0]) if elevation else r
    p = [flat * np.cos(azimuth), flat * np.sin(azimuth)]
    return pack([*p, r * np.sin(elevation[0])] if elevation else p)
