r"""Start values of the landmarks of an imaging sonar: on the arc of the first contact, at an elevation or at the best.

A contact (r, az) of a sonar at S leaves its landmark on an arc. The other views decide the place on the arc:

    l(el) = S p(r, az, el),     f(el) = sum |b_i(l(el))|^2 over all sightings of the landmark,     |el| <= limit

f is evaluated on a grid, all landmarks at once, and its smallest value refined by the parabola through it and its two
neighbors. After motion in the plane of the sonar f(el) = f(-el), and 0 is a maximum from which no Newton step leads
away. The search takes one of the two minima; their mean would be as wrong as the start. Where f is flat (one view, or
turns only) the landmark stays at elevation 0.

Source: the search over the aperture is that of aldoteran/fs-slam, src/BundleAdjuster.py, after E. Westman, M. Kaess,
"Degeneracy-aware imaging sonar simultaneous localization and mapping", IEEE Journal of Oceanic Engineering 45, 2020.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import pi, radians
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from factors import Factor, Sighting
from factors.keys import Keys
from factors.sonar import first_contacts
from models import SE3
from models.algebra import Array, Index, Numbers
from models.options import check_between, check_whole
from models.sensors import cartesian
from nls.gauge import fixed_of
from nls.graph import FactorGraph
from nls.values import Values, take

FLAT = 1e-2  # a chi2 that falls by less, a tenth of a sigma, is no reason to leave elevation 0


class Arcs(NamedTuple):
    """Landmarks of one kind that a sonar saw: rows (k,) of the stack, and the first contacts: poses (k, 7),
    measurements (k, 2)."""

    kind: str
    rows: Index
    S: Array
    z: Array

    def points(self, elevation: npt.ArrayLike) -> Array:
        """The landmarks (k, 3) at elevations (k,) or one for all, rad."""
        arc = cartesian(np.column_stack([self.z, np.broadcast_to(elevation, len(self.z))]))[0]
        return np.asarray(SE3.act(self.S, arc))


def first_sighting(graph: FactorGraph, values: Values, elevation: float = 0.0) -> Values:
    """Every landmark with a `RangeAzimuth` on the arc of its first contact (by the number of the pose).

    Parameters
    ----------
    graph : fixed landmarks keep their values.
    values : every variable; those of the poses are used.
    elevation : in the frame of the sonar, rad; positive below.

    Returns
    -------
    Values

    Raises
    ------
    OptionError
        Not an elevation.

    Examples
    --------
    >>> from factors import Isotropic, RangeAzimuth
    >>> from models import SE3, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([RangeAzimuth(x[0], l[0], [5.0, 0.0], Isotropic(0.01))])
    >>> values = Values({x: (SE3, SE3.identity()), l: (R(3), [0.0, 0.0, 0.0])})
    >>> first_sighting(graph, values, elevation=0.6435)[l[0]].round(3)
    array([4., 0., 3.])
    """
    expected = "an angle in (-pi / 2, pi / 2), rad"
    check_between("first_sighting: elevation", elevation, -pi / 2, pi / 2, expected)
    every = first_arcs(graph.factors, values, graph.fixed)
    return values.replaced({arcs.kind: _placed(values, arcs, arcs.points(elevation)) for arcs in every})


def search_elevation(graph: FactorGraph, values: Values, limit: float | None = None, steps: int = 14) -> Values:
    """Every landmark with a `RangeAzimuth` on the arc of its first contact, at the elevation that fits all views best.

    Parameters
    ----------
    graph : every `Sighting` factor of these landmarks takes part, weighted by its noise and robust kernel; fixed
        landmarks keep their values.
    values : every variable; those of the poses are used.
    limit : largest elevation that is tried, half of the aperture, rad; the widest of the graph's `ElevationHinge` when
        omitted, 7 deg where there is none.
    steps : elevations that are tried on either side of 0.

    Returns
    -------
    Values

    Raises
    ------
    OptionError
        A limit that is no elevation, no steps.
    SingularGeometryError
        A landmark that is tried on the z axis of one of its sonars.

    Examples
    --------
    A contact seen again after half a meter of heave:

    >>> from factors import Diagonal, RangeAzimuth
    >>> from models import SE3, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> noise = Diagonal(range=0.01, azimuth=0.005)
    >>> graph = FactorGraph([RangeAzimuth(x[[0, 1]], l[0], [[5.0, 0.0], [4.717, 0.0]], noise)])
    >>> poses = [[0, 0, 0, 0, 0, 0, 1], [0, 0, 0.5, 0, 0, 0, 1]]
    >>> search_elevation(graph, Values({x: (SE3, poses), l: (R(3), [0, 0, 0])}), limit=0.8)[l[0]].round(2)
    array([4., 0., 3.])
    """
    if limit is not None:
        check_between("search_elevation: limit", limit, 0, pi / 2, "half an aperture in (0, pi / 2), rad")
    check_whole("search_elevation: steps", steps, 1, "a whole number of at least 1, on either side")
    landmarks = {}
    for arcs in first_arcs(graph.factors, values, graph.fixed):
        widest = aperture_of(graph, arcs.kind) if limit is None else limit
        elevation = _best(misfit_of(graph, values, arcs), len(arcs.rows), widest, steps)
        landmarks[arcs.kind] = _placed(values, arcs, arcs.points(elevation))
    return values.replaced(landmarks)


def aperture_of(graph: FactorGraph, kind: str) -> float:
    """Half of the aperture, rad: the widest limit of the hinges of a kind of landmarks, 7 deg where there is none."""
    limits = [f.limit for f in graph.factors if isinstance(f, Sighting) and f.limit_only and f.keys[1].kind == kind]
    return max(limits, default=radians(14.0) / 2)  # half that of a DIDSON


def first_arcs(factors: Sequence[Factor], values: Values, fixed: Sequence[Keys] = ()) -> Iterator[Arcs]:
    """The first contacts of all landmarks that are not fixed, kind by kind."""
    contacts: dict[str, list[tuple[Array, Numbers, Numbers, Array]]] = {}
    for factor in factors:
        if isinstance(factor, Sighting) and factor.contact and len(factor):
            model, X = values.gather(factor)
            if model.manifolds[1] is not SE3:
                pose, target = factor.keys[:2]
                S = factor.sensor_pose(SE3, X[0], *X[2:])
                contacts.setdefault(target.kind, []).append((S, pose.numbers, target.numbers, model.z))
    for kind, views in contacts.items():
        S, pose_numbers, numbers, z = (np.concatenate(parts) for parts in zip(*views, strict=True))
        first = first_contacts(Keys("pose", pose_numbers), Keys(kind, numbers))
        rows = values.stack(kind).index(Keys(kind, numbers[first]))
        free = ~fixed_of(fixed, values.stack(kind))
        first = first[free[rows]]
        yield Arcs(kind, rows[free[rows]], S[first], z[first])


def _placed(values: Values, arcs: Arcs, points: Array) -> Array:
    """The stack with these landmarks."""
    X = np.array(values.stack(arcs.kind).X)
    X[arcs.rows] = points
    return X


def misfit_of(graph: FactorGraph, values: Values, arcs: Arcs) -> Callable[[Array], Array]:
    """The function that takes elevations (k,) to the chi2 (k,) of all sightings of each landmark."""
    sightings = [f for f in graph.factors if isinstance(f, Sighting) and len(f) and f.keys[1].kind == arcs.kind]
    stack = values.stack(arcs.kind)
    bound = [(factor, *values.gather(factor), stack.index(factor.keys[1])) for factor in sightings]

    def misfit(elevation: Array) -> Array:
        L, chi2 = _placed(values, arcs, arcs.points(elevation)), np.zeros(len(stack))
        for factor, model, X, row in bound:
            s = np.square(model.error(X[0], take(L, row), *X[2:])).sum(axis=1)
            chi2 += np.bincount(row, s if factor.kernel is None else factor.kernel.rho(s), minlength=len(stack))
        return chi2[arcs.rows]

    return misfit


def _best(misfit: Callable[[Array], Array], k: int, limit: float, steps: int) -> Array:
    """Elevations (k,) of smallest misfit within +-limit: on a grid, then at the lowest point of a parabola."""
    grid = limit * np.arange(-steps, steps + 1) / steps
    f = np.array([misfit(np.full(k, elevation)) for elevation in grid])  # (2 steps + 1, k)
    columns, lowest = np.arange(k), np.argmin(f, axis=0)
    best = np.where(f[steps] - f[lowest, columns] < FLAT, steps, lowest)
    inside = (best > 0) & (best < 2 * steps) & (best == lowest)
    left, center, right = f[best - inside, columns], f[best, columns], f[best + inside, columns]
    curvature = left - 2 * center + right  # 0 where not inside
    bent = curvature > 0
    shift = np.where(bent, (left - right) / (2 * np.where(bent, curvature, 1.0)), 0.0)
    refined = grid[best] + shift * limit / steps
    return np.where(misfit(refined) < center - FLAT, refined, grid[best])
