"""A distance: acoustic beacon, transponder, radio range, another vehicle."""

from __future__ import annotations

from factors.sighting import Sighting
from models import Manifold, Measured
from models.algebra import Array
from models.sensors import distance

__all__ = ["Range"]


class Range(Sighting):
    r"""Distance from the sensor to a target.

    .. math:: h(X, l) = |p|, \quad p = (X \circ O)^{-1} l, \quad J_g = p^T / |p|

    Parameters
    ----------
    pose : the vehicle(s), SE2 or SE3, or points, R(2) or R(3).
    target : the point(s), R(2) in the plane, R(3) in space; or poses of the same group, whose position is meant.
    z : (n,) measured ranges, m.
    noise : of ``range``, m.
    offset : pose of the antenna on the vehicle, (size,) or (n, size), or a variable of the group; None: no offset. A
        point has none.

    Raises
    ------
    GraphError
        Spaces or shapes that do not fit; a range below 0.
    SingularGeometryError
        At evaluation: zero range, where there is no line of sight.

    Notes
    -----
    A range from one position leaves the target on a sphere. Ranges from positions in one line leave it on a circle (in
    the plane: in two places, one on either side). Without an offset the attitude of the pose is not measured at all.
    E. Olson, J. Leonard, S. Teller, "Robust range-only beacon localization", 2006.

    Examples
    --------
    >>> from factors import Isotropic, Range
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([Range(x[[0, 1, 2]], l[0], [5.0, 4.0, 3.0], Isotropic(0.1))])
    >>> values = Values({x: (SE2, [[0, 0, 0], [3, 0, 0], [0, 4, 0]]), l: (R(2), [2.0, 3.0])})
    >>> graph.fix(x[[0, 1, 2]])
    >>> graph.optimize(values).values[l[0]].round(6)
    array([3., 4.])
    """

    from_points = True

    def measured(self, d: int) -> Manifold:
        return Measured("range")

    def sense(self, p: Array) -> tuple[Array, Array]:
        return distance(p)

    def ranges(self, z: Array) -> Array:
        return z[:, 0]
