r"""Range, azimuth and elevation of a point, and the image an imaging sonar makes of it. x forward, y right, z down.

    p = r (cos az cos el, sin az cos el, sin el)              el > 0 is below the plane of the sonar
    r = |p|,   az = atan2(y, x),   el = atan2(z, rho),        rho = hypot(x, y)

    d(r, az, el)/dp = [[x/r, y/r, z/r], [-y/rho^2, x/rho^2, 0], [-x z/(rho r^2), -y z/(rho r^2), rho/r^2]]
    dp/d(r, az, el) = [[ca ce, -r sa ce, -r ca se], [sa ce, r ca ce, -r sa se], [se, 0, r ce]],   det = r^2 cos el

An imaging sonar measures (r, az); el is lost: all points of the arc (r, az, el in the aperture) have one image,

    r (cos az, sin az) = (x, y) / cos el                      the arc turned down onto the plane el = 0

which is written without the division, so that it has a value up to el = +-90 deg. On the z axis (rho = 0) az has none.

Source: T. Huang, M. Kaess, "Towards acoustic structure from motion for imaging sonar", IROS 2015.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, components, matrix, pack
from models.sensors.direction import direction, point_from_direction_range
from models.sensors.distance import distance

__all__ = ["cartesian", "elevation", "plane_projection", "range_azimuth", "spherical"]


def spherical(p: Array) -> tuple[Array, Array]:
    """Range, azimuth and elevation of points p in the frame of the sonar.

    Parameters
    ----------
    p : (n, 3) array, m.

    Returns
    -------
    h : (n, 3) range, m, azimuth and elevation, rad.
    J : (n, 3, 3).

    Raises
    ------
    SingularAt
        A point at the sonar or on its z axis, nearer than `CLOSE`.

    Examples
    --------
    >>> import numpy as np
    >>> h, J = spherical(np.array([[3.0, 4.0, 0.0]]))
    >>> h.round(4), J[0].round(2).tolist()
    (array([[5.    , 0.9273, 0.    ]]), [[0.6, 0.8, 0.0], [-0.16, 0.12, 0.0], [-0.0, -0.0, 0.2]])
    """
    r, J_r = distance(p)
    angles, J_angles = direction(p)
    return np.concatenate([r, angles], axis=1), np.concatenate([J_r, J_angles], axis=1)


def cartesian(h: Array) -> tuple[Array, Array]:
    """Points (n, 3), m, in the frame of the sonar, and dp/dh (n, 3, 3), of (range, azimuth, elevation) (n, 3).

    The third column of dp/dh is the tangent of the arc a single image leaves the point on.

    Examples
    --------
    >>> import numpy as np
    >>> p, J = cartesian(np.array([[2.0, 0.0, np.pi / 6]]))
    >>> p.round(4), J[0, :, 2].round(4)
    (array([[1.7321, 0.    , 1.    ]]), array([-1.    , -0.    ,  1.7321]))
    """
    r, azimuth, elevation = components(h)
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    J = matrix([[ca * ce, -r * sa * ce, -r * ca * se], [sa * ce, r * ca * ce, -r * sa * se], [se, 0.0, r * ce]])
    return point_from_direction_range(pack([azimuth, elevation, r])), J


def range_azimuth(p: Array) -> tuple[Array, Array]:
    """Measurement of points p (n, 3) by an imaging sonar: (range, azimuth) (n, 2), m and rad, and J (n, 2, 3).

    Raises
    ------
    SingularAt
        As `spherical`.
    """
    h, J = spherical(p)
    return h[:, :2], J[:, :2]


def elevation(p: Array) -> tuple[Array, Array]:
    """The unmeasured elevation (n, 1) of points p (n, 3), rad, and J (n, 1, 3).

    Raises
    ------
    SingularAt
        As `spherical`.
    """
    h, J = direction(p)
    return h[:, 1:], J[:, 1:]


def plane_projection(p: Array) -> Array:
    """Where points p (n, 3) appear in the fan image, r (cos az, sin az) (n, 2), m.

    Raises
    ------
    SingularAt
        As `spherical`.

    Examples
    --------
    >>> import numpy as np
    >>> plane_projection(np.array([[3.0, 0.0, 4.0]])).round(6)
    array([[5., 0.]])
    """
    h, _ = range_azimuth(p)
    r, azimuth = components(h)
    return pack([r * np.cos(azimuth), r * np.sin(azimuth)])
