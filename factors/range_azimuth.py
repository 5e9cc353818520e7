"""A contact of an imaging sonar: range and azimuth of a point in space, its elevation lost."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.keys import Keys
from factors.noise import Noise
from factors.sighting import Sighting
from models import SE3, Manifold, Measured
from models.algebra import Array
from models.sensors import cartesian, range_azimuth

__all__ = ["RangeAzimuth"]


class InSpace(Sighting):
    """Range and azimuth of a target by a sonar that looks into space, in the order of `measures`.

    Attributes
    ----------
    measures : names of the measured numbers.
    """

    measures: tuple[str, ...] = ()

    def __init__(
        self, pose: Keys, target: Keys, z: npt.ArrayLike, noise: Noise, offset: npt.ArrayLike | Keys | None = None
    ) -> None:
        super().__init__(pose, target, z, noise, offset)
        self.slots = (SE3, *self.slots[1:])

    def sizes(self) -> tuple[int, ...]:
        return (len(self.measures),)

    def measured(self, d: int) -> Manifold:
        return Measured(*self.measures)


class RangeAzimuth(InSpace):
    r"""Range and azimuth of a target in the frame of an imaging sonar; x ahead, y to starboard, z down.

    .. math:: h(X, l) = (|p|, \mathrm{atan2}(p_y, p_x)), \quad p = (X \circ O)^{-1} l

    Parameters
    ----------
    pose : the vehicle(s), SE3.
    target : the point(s), R(3); or other poses, of which the position is meant.
    z : (n, 2) measured range, m, and azimuth, rad.
    noise : of ``range`` (m) and ``azimuth`` (rad), in this order or by name.
    offset : pose of the sonar on the vehicle, (7,) or (n, 7), or a variable in SE3; None: no offset.

    Raises
    ------
    GraphError
        Spaces or shapes that do not fit; a range below 0, an angle beyond a turn.
    SingularGeometryError
        At evaluation: a target at the sonar, or on its z axis, where it has no azimuth.

    Notes
    -----
    One view leaves the target on an arc of the aperture. A second one determines it if the sonar rolled or moved along
    its own z in between. Yaw never does. Surge and sway do not where the elevation is 0. See the page on sonar, and
    `sonar_factors` for what to do about it. T. Huang, M. Kaess, "Towards acoustic structure from motion for imaging
    sonar", IROS 2015.

    Examples
    --------
    A contact seen before and after a heave of half a meter:

    >>> import numpy as np
    >>> from factors import Diagonal, RangeAzimuth
    >>> from models import SE3, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> noise = Diagonal(range=0.01, azimuth=0.005)
    >>> graph = FactorGraph([RangeAzimuth(x[[0, 1]], l[0], [[5.0, 0.0], [4.717, 0.0]], noise)])
    >>> graph.fix(x[[0, 1]])
    >>> values = Values({x: (SE3, np.array([[0, 0, 0, 0, 0, 0, 1], [0, 0, 0.5, 0, 0, 0, 1]])), l: (R(3), [5, 0, 0.1])})
    >>> graph.optimize(values).values[l[0]].round(2)
    array([4., 0., 3.])
    """

    measures = ("range", "azimuth")
    contact = True

    def sense(self, p: Array) -> tuple[Array, Array]:
        return range_azimuth(p)  # with its Jacobian in models.sensors.spherical

    @staticmethod
    def arc(z: Array, elevation: npt.ArrayLike) -> Array:
        """Where measurements z (n, 2) leave their targets: points (n, 3), m, in the frame of the sonar.

        Parameters
        ----------
        z : (n, 2) range, m, and azimuth, rad.
        elevation : one for all, or (n,), rad.

        Examples
        --------
        >>> import numpy as np
        >>> RangeAzimuth.arc(np.array([[5.0, 0.0]]), np.arcsin(0.6)).round(6)
        array([[4., 0., 3.]])
        """
        return cartesian(np.column_stack([z, np.broadcast_to(elevation, len(z))]))[0]
