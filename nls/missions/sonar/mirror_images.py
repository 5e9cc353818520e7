r"""May landmarks be mirrored? Their chi2 on the other side of the plane of the sonar, the poses as they are.

    p(e) = S p(r, az, e),     f(e) = sum |b_i(p(e))|^2,     other = argmin f over elevations e of the other sign

After motion in the plane of the sonar f(e) = f(-e), and nothing tells the sign. Two places count as alike where f
differs by less than `ALIKE`. They are two places where they are farther apart than `APART` standard deviations.
Nearer ones are one place, which its standard deviation describes.

A level vehicle with a level sonar, 50 landmarks: 39 are named, among them all 23 that are on the wrong side; with 4
for `ALIKE` 31 and 16. Of 340 landmarks over the sea floor, seen by a tilted sonar, none is.
"""

from __future__ import annotations

import numpy as np

from factors.keys import Keys
from models.algebra import Array, Mask
from nls.graph import FactorGraph
from nls.starts.elevation import Arcs, aperture_of, misfit_of
from nls.values import Values

__all__ = ["mirrored"]

ALIKE = 9.0  # chi2: the poses have settled with the side that stands, so that the other one is a little worse
APART = 2.0  # standard deviations between two places
STEPS = 24  # elevations of the other side that are tried
FINER = (6, 36)  # parts of such a step, three to either side of the best so far


def mirrored(graph: FactorGraph, values: Values, points: Keys, S: Array, h: Array, sigma: Array) -> Mask:
    """Which landmarks fit as well on the other side of the sonar that saw them first.

    Parameters
    ----------
    graph, values : with the contacts, at the optimum.
    points : (n,) the landmarks.
    S : (n, 7) poses of the sonar.
    h : (n, 3) the landmarks in its frame: range, azimuth, elevation, m and rad.
    sigma : (n,) standard deviations of the elevations, rad; where one is nan nothing can be told, and it is False.

    Returns
    -------
    (n,) array of bool

    Raises
    ------
    SingularGeometryError
        A place that is tried is on the z axis of one of the sonars.

    Examples
    --------
    Half a meter ahead leaves the sign open, half a meter down does not:

    >>> import numpy as np
    >>> from factors import Diagonal, RangeAzimuth
    >>> from models import SE3, R
    >>> from models.sensors import spherical
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> point = np.array([[4.0, 0.5, 0.4]])
    >>> for step in ([0.5, 0.0, 0.0], [0.0, 0.0, 0.5]):
    ...     poses = np.array([[0, 0, 0, 0, 0, 0, 1], [*step, 0, 0, 0, 1]])
    ...     z = spherical(np.concatenate([point, point - step]))[0]
    ...     contacts = RangeAzimuth(x[[0, 1]], l[[0, 0]], z[:, :2], Diagonal(range=0.01, azimuth=0.005))
    ...     values = Values({x: (SE3, poses), l: (R(3), point)})
    ...     mirrored(FactorGraph([contacts]), values, l[[0]], poses[:1], z[:1], np.array([0.01])).tolist()
    [True]
    [False]
    """
    elevation, columns = h[:, 2], np.arange(len(points))
    largest = np.maximum(aperture_of(graph, points.kind), np.abs(elevation))
    f = misfit_of(graph, values, Arcs(points.kind, values.stack(points.kind).index(points), S, h[:, :2]))
    side, step = np.where(elevation > 0, -1.0, 1.0), largest / STEPS
    other, lowest = np.zeros(len(points)), f(np.zeros(len(points)))
    for tried in (np.arange(1, STEPS + 1), *(np.arange(-3, 4) / part for part in FINER)):
        size = np.clip(side * other + step * tried[:, None], 0.0, largest)
        grid = side * size
        chi2 = np.array([f(row) for row in grid])
        best = np.argmin(chi2, axis=0)
        better = chi2[best, columns] < lowest
        other = np.where(better, grid[best, columns], other)
        lowest = np.where(better, chi2[best, columns], lowest)
    return np.asarray((lowest - f(elevation) < ALIKE) & (np.abs(other - elevation) > APART * sigma))
