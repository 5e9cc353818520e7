"""A straight line of the plane seen from a pose: walls and quays in the scan of a sonar or laser."""

from __future__ import annotations

import numpy.typing as npt

from factors.keys import Keys
from factors.mount import check_offset
from factors.noise import Noise
from factors.sighting import Sighting
from models import LINE, SE2, LieGroup, Manifold
from models.algebra import Array
from models.sensors import line_from_frame, line_in_frame

__all__ = ["Line"]


class Line(Sighting):
    r"""A line as it is in the frame of the sensor: direction of its normal and distance along it.

    .. math:: h(X, l) = (\alpha - \theta, \; r - x \cos\alpha - y \sin\alpha), \quad
              (x, y, \theta) = X \circ O, \quad l = (\alpha, r)

    Parameters
    ----------
    pose : the vehicle(s), SE2.
    line : the line(s), `models.LINE`: x cos(alpha) + y sin(alpha) = r in the world.
    z : (n, 2) measured alpha, rad, and r, m, of either normal: (alpha, r) and (alpha + pi, -r) are one line.
    noise : of ``alpha`` and ``r``, in this order or by name; uncorrelated, unless the normal of the variable is known.
    offset : pose of the sensor on the vehicle, (3,) or (n, 3), or a variable in SE2; None: no offset.

    Raises
    ------
    GraphError
        Variables not in SE2 and LINE; z of the wrong shape.

    Notes
    -----
    Which normal is meant follows from the angle, never from the sign of r, which changes where the vehicle crosses the
    line or its extension. The residual is along the normal of the prediction; a correlation of alpha and r, which
    changes its sign with the normal, is taken to be along that one too. The line has no ends: nothing is said of where
    along it the vehicle is, and parallel walls leave that direction free. Far from the origin r is poorly known, by
    sigma_alpha times the distance: keep the origin near the walls. R. Siegwart, I. Nourbakhsh, D. Scaramuzza,
    Introduction to Autonomous Mobile Robots, 2011, section 5.6.8.

    Examples
    --------
    A vehicle that looks along y has the wall x = 10 to its right, at 2 m:

    >>> import numpy as np
    >>> from factors import Diagonal, Line
    >>> from models import LINE, SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([Line(x[0], l[0], [-np.pi / 2, 2.0], Diagonal(alpha=0.01, r=0.03))])
    >>> values = Values({x: (SE2, [8.0, 3.0, np.pi / 2]), l: (LINE, [0.1, 9.0])})
    >>> graph.optimize(values).values[l[0]].round(6) + 0.0
    array([ 0., 10.])
    """

    locates = True

    def __init__(
        self, pose: Keys, line: Keys, z: npt.ArrayLike, noise: Noise, offset: npt.ArrayLike | Keys | None = None
    ) -> None:
        super().__init__(pose, line, z, noise, offset)
        self.slots = (SE2, LINE, *self.slots[2:])

    def measured(self, d: int) -> Manifold:
        return LINE

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        check_offset(self, self.offset, SE2, manifolds[-1])
        return LINE

    def sense(self, p: Array) -> tuple[Array, None]:
        return p, None  # the line in the frame of the sensor is what is measured

    def locate(self, group: LieGroup, S: Array, z: Array) -> Array:
        return line_from_frame(S, z)

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, tuple[Array, ...]]:
        h, (H_S, H_l) = line_in_frame(self.sensor_pose(SE2, X[0], *X[2:]), X[1])
        return h, self._through_mount(SE2, H_S, H_l, *X[2:])
