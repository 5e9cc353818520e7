"""A direction: camera ray, hydrophone pair, scanning sonar without range."""

from __future__ import annotations

import numpy as np

from factors.sighting import Sighting
from models import Manifold, Measured
from models.algebra import Array
from models.sensors import direction, point_from_direction_range

__all__ = ["Bearing"]


class Bearing(Sighting):
    r"""Direction from the sensor to a target, relative to the sensor's axes.

    .. math:: h(X, l) = \mathrm{atan2}(p_y, p_x) \quad [, \mathrm{atan2}(p_z, \sqrt{p_x^2 + p_y^2})], \quad
              p = (X \circ O)^{-1} l

    Angles are from the x axis of the sensor, ahead, towards its y axis: to starboard where z is down, as in space here;
    to the left where z is up, as on most maps of the plane.

    Parameters
    ----------
    pose : the vehicle(s), SE2 or SE3, or points, R(2) or R(3): their bearings are relative to the axes of the world.
    target : the point(s), R(2) in the plane, R(3) in space; or poses of the same group, whose position is meant.
    z : (n,) bearings in the plane, (n, 2) azimuth and elevation in space, rad.
    noise : of ``bearing``, or of ``azimuth`` and ``elevation``, rad.
    offset : pose of the sensor on the vehicle, (size,) or (n, size), or a variable of the group; None: no offset. A
        point has none.

    Raises
    ------
    GraphError
        Spaces or shapes that do not fit; an angle beyond a turn.
    SingularGeometryError
        At evaluation: a target at the sensor (plane) or on its z axis (space), where the azimuth is not defined.

    Notes
    -----
    The distance is not measured. A target needs two directions from positions not in line with it. A map of bearings
    alone has no scale. Across the line of sight a sigma of azimuth is worth that times the cosine of the elevation.
    Bearings from points turn with the world: beside poses they determine headings, and a shift alone is free (gauge).
    R. Hartley, A. Zisserman, Multiple View Geometry in Computer Vision, 2004, chapter 12.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Bearing, Diagonal
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([Bearing(x[[0, 1]], l[0], [np.pi / 4, 3 * np.pi / 4], Diagonal(bearing=0.01))])
    >>> graph.fix(x[[0, 1]])
    >>> values = Values({x: (SE2, [[0, 0, 0], [2, 0, 0]]), l: (R(2), [0.8, 0.7])})
    >>> graph.optimize(values).values[l[0]].round(6)
    array([1., 1.])
    """

    from_points = along_world = True

    def measured(self, d: int) -> Manifold:
        return Measured("bearing") if d == 2 else Measured("azimuth", "elevation")

    def sense(self, p: Array) -> tuple[Array, Array]:
        return direction(p)

    def directions(self, z: Array) -> Array:
        return point_from_direction_range(np.column_stack([z, np.ones(len(z))]))
