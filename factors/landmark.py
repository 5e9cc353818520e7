"""A point measured by its coordinates in the frame of the sensor."""

from __future__ import annotations

import numpy.typing as npt

from factors.keys import Keys
from factors.noise import Noise
from factors.sighting import Sighting
from models import Manifold, R
from models.algebra import Array

__all__ = ["Landmark"]


class Landmark(Sighting):
    r"""A point in the frame of the sensor: stereo camera, lidar or profiler feature, laser corner.

    .. math:: h(X, l) = (X \circ O)^{-1} l, \quad H_S = [-I, [p]_\times], \quad H_l = R_S^T

    Parameters
    ----------
    pose : the vehicle(s), SE2 or SE3.
    point : the point(s), R(2) for SE2, R(3) for SE3; or poses of the same group, of which the position is meant.
    z : (n, 2) or (n, 3) measured coordinates, m.
    noise : of x, y(, z) in the frame of the *sensor*, m.
    offset : pose of the sensor on the vehicle, (size,) or (n, size), or a variable of the group; None: no offset.

    Raises
    ------
    GraphError
        A pose of the plane with a point of space, or the other way round; shapes that do not fit.

    Notes
    -----
    One measurement determines the point; the pose is determined by two points in the plane, by three not in line in
    space. Nothing is singular. R. Smith, M. Self, P. Cheeseman, "Estimating uncertain spatial relationships in
    robotics", 1990.

    Examples
    --------
    >>> from factors import Isotropic, Landmark
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([Landmark(x[0], l[0], [2.0, 0.5], Isotropic(0.1), offset=[1.0, 0.0, 0.0])])
    >>> graph.optimize(Values({x: (SE2, [0.0, 0.0, 0.0]), l: (R(2), [0.0, 0.0])})).values[l[0]].round(6)
    array([3. , 0.5])
    """

    locates = True
    frame = "sensor"

    def __init__(
        self, pose: Keys, point: Keys, z: npt.ArrayLike, noise: Noise, offset: npt.ArrayLike | Keys | None = None
    ) -> None:
        super().__init__(pose, point, z, noise, offset)

    def measured(self, d: int) -> Manifold:
        return R(d)

    def sense(self, p: Array) -> tuple[Array, None]:
        return p, None

    def point(self, z: Array) -> Array:
        return z
