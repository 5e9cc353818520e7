"""Direction and distance together: sonar and radar contacts, laser features, ultra-short baseline positioning."""

from __future__ import annotations

import numpy as np

from factors.sighting import Sighting
from models import Manifold, Measured
from models.algebra import Array
from models.sensors import direction, distance, point_from_direction_range

__all__ = ["BearingRange"]


class BearingRange(Sighting):
    r"""Direction and distance from the sensor to a target.

    .. math:: h(X, l) = (\mathrm{atan2}(p_y, p_x) \; [, \mathrm{atan2}(p_z, \sqrt{p_x^2 + p_y^2})], \; |p|), \quad
              p = (X \circ O)^{-1} l

    Angles are from the x axis of the sensor, ahead, towards its y axis: to starboard where z is down, as in space here;
    to the left where z is up, as on most maps of the plane.

    Parameters
    ----------
    pose : the vehicle(s), SE2 or SE3.
    target : the point(s), R(2) for SE2, R(3) for SE3; or poses of the same group, of which the position is meant.
    z : (n, 2) bearing and range in the plane, (n, 3) azimuth, elevation and range in space; rad and m.
    noise : of ``bearing, range`` or ``azimuth, elevation, range``, in this order or by name.
    offset : pose of the sensor on the vehicle, (size,) or (n, size), or a variable of the group; None: no offset.

    Raises
    ------
    GraphError
        Spaces or shapes that do not fit; a range below 0, an angle beyond a turn.
    SingularGeometryError
        At evaluation: zero range, or a target on the z axis of the sensor in space.

    Notes
    -----
    One measurement determines the target. S. Thrun, W. Burgard, D. Fox, Probabilistic Robotics, 2005, section 6.6.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import BearingRange, Diagonal
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([BearingRange(x[0], l[0], [np.pi / 2, 3.0], Diagonal(bearing=0.01, range=0.1))])
    >>> values = Values({x: (SE2, [1.0, 0.0, 0.0]), l: (R(2), [2.0, 2.0])})
    >>> graph.optimize(values).values[l[0]].round(6)
    array([1., 3.])
    """

    locates = True

    def measured(self, d: int) -> Manifold:
        return Measured("bearing", "range") if d == 2 else Measured("azimuth", "elevation", "range")

    def sense(self, p: Array) -> tuple[Array, Array]:
        r, J_r = distance(p)
        angles, J_angles = direction(p)
        return np.concatenate([angles, r], axis=1), np.concatenate([J_angles, J_r], axis=1)

    def point(self, z: Array) -> Array:
        return point_from_direction_range(z)
