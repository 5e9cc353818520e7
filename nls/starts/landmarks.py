r"""Start values of points from the poses that saw them, all points at once.

A point with a measurement of direction and distance is put where the first of them (by the number of the pose) has it,
l = S p. One whose information is nothing beside that of the others is passed over. Other points follow from sums over
all their measurements, from sensors at s_i:

    ranges      M = sum u_i u_i',        v = sum u_i (|u_i|^2 - r_i^2) / 2,   u_i = s_i - c,  c = mean of s_i
    directions  M = sum (I - d_i d_i'),  v = sum (I - d_i d_i') u_i           d_i the unit vector of the ray

and l = c + M^-1 v. The first subtracts squared ranges, |l - s_i|^2 = r_i^2, from their mean, which leaves a linear
system; the second is the point nearest to all rays. Where M says nothing in some direction (ranges from fewer than
three places not in line, in space four not in one plane; rays that are parallel), or where the value given fits the
measurements better, the value given stays. So do fixed points. The pixels of a camera are directions, too. A point that
would be behind a camera that saw it is left where it was: no image of it exists there.

Source: W. Murphy, W. Hereman, "Determination of a position in three dimensions using trilateration and approximate
distances", Colorado School of Mines, 1995 (the squared ranges).

**Landmarks of an imaging sonar** begin on the arc of the first contact, at an elevation or at the best. A contact
(r, az) of a sonar at S leaves its landmark on an arc. The other views decide the place on the arc:

    l(el) = S p(r, az, el),     f(el) = sum |b_i(l(el))|^2 over all sightings of the landmark,     |el| <= limit

f is evaluated on a grid, all landmarks at once, and its smallest value refined by the parabola through it and its two
neighbors. After motion in the plane of the sonar f(el) = f(-el), and 0 is a maximum from which no Newton step leads
away. The search takes one of the two minima; their mean would be as wrong as the start. Where f is flat (one view, or
turns only) the landmark stays at elevation 0.

Source: the search over the aperture is that of aldoteran/fs-slam, src/BundleAdjuster.py, after E. Westman, M. Kaess,
"Degeneracy-aware imaging sonar simultaneous localization and mapping", IEEE Journal of Oceanic Engineering 45, 2020.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from math import pi, radians
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from factors import Factor, Sighting
from factors.keys import Keys
from factors.mount import named_singularity
from factors.sonar import first_contacts
from models import SE3, LieGroup
from models.algebra import Array, Index, Mask, Numbers, apply
from models.options import check_between, check_whole
from models.sensors import cartesian
from nls.gauge import fixed_of
from nls.graph import FactorGraph
from nls.values import Stack, Values, take

DETERMINED = 1e-6  # smallest over largest eigenvalue of M: 1 mm across for 1 m along, rays that meet at 0.1 degrees


class Sightings(NamedTuple):
    """Measurements of the points of one kind: row of the point, number and pose of the sensor, and measured value.
    `least` is the least singular value of the whitener."""

    factor: Sighting
    group: LieGroup
    point: Index
    number: Numbers
    S: Array
    z: Array
    least: Array


def sees_landmarks(factor: Factor, values: Values) -> bool:
    """Whether a factor is of sightings from poses, and what it sees are no poses."""
    if not isinstance(factor, Sighting):
        return False
    manifolds = values.gather(factor)[0].manifolds
    return manifolds[1] is not manifolds[0]


def locate_points(graph: FactorGraph, values: Values) -> Values:
    """Points where the poses saw them; poses, fixed points and points nothing locates keep their values.

    Parameters
    ----------
    graph : every `Sighting` of points is used, equally weighted, that locates its target, or says its range or its
        direction as pixels do. Ranges and directions of one point are not combined. All other factors are passed over:
        sightings of poses; `RangeAzimuth` and `Elevation`, for which `search_elevation` and `rig` are the starts;
        priors of points, and lines.
    values : every variable; poses and variable offsets are taken as they are.

    Returns
    -------
    Values

    Raises
    ------
    SingularGeometryError
        A pixel without a ray; names the measurement.

    Examples
    --------
    >>> from factors import Isotropic, Range
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([Range(x[[0, 1, 2]], l[0], [5.0, 4.0, 3.0], Isotropic(0.1))])
    >>> values = Values({x: (SE2, [[0, 0, 0], [3, 0, 0], [0, 4, 0]]), l: (R(2), [0.0, 0.0])})
    >>> locate_points(graph, values)[l[0]].round(6)
    array([3., 4.])
    """
    sightings: dict[str, list[Sightings]] = {}
    for factor in graph.factors:
        if isinstance(factor, Sighting) and len(factor):
            model, X = values.gather(factor)
            group, target = model.manifolds[:2]
            assert isinstance(group, LieGroup)
            if target is not group:
                S = factor.sensor_pose(group, X[0], *X[2:])
                point = values.stack(factor.keys[1].kind).index(factor.keys[1])
                least = np.abs(model.W).min(axis=1) if model.W.ndim == 2 else np.linalg.svd(model.W)[1][:, -1]
                least = np.broadcast_to(least, len(factor))
                sighting = Sightings(factor, group, point, factor.keys[0].numbers, S, model.z, least)
                sightings.setdefault(factor.keys[1].kind, []).append(sighting)
    return values.replaced({kind: _located(values.stack(kind), views, graph) for kind, views in sightings.items()})


def _located(stack: Stack, sightings: list[Sightings], graph: FactorGraph) -> Array:
    """The points (n, d) of one kind."""
    X = np.array(stack.X)
    todo = ~fixed_of(graph.fixed, stack)

    complete = [s for s in sightings if s.factor.locates]
    if complete:
        point, number = (np.concatenate([getattr(s, name) for s in complete]) for name in ("point", "number"))
        at = np.concatenate([s.factor.locate(s.group, s.S, s.z) for s in complete])
        says = np.concatenate([s.least for s in complete])
        most = np.zeros(len(X))
        np.maximum.at(most, point, says)
        informed = np.flatnonzero((says > 0) & (says >= 1e-3 * most[point]))
        point, number, at = point[informed], number[informed], at[informed]
        first = np.lexsort((number, point))
        points, place = np.unique(point[first], return_index=True)
        rows = first[place][todo[points]]
        X[point[rows]] = at[rows]
        todo[point] = False
    ranges = [s.factor.ranges(s.z) for s in sightings]
    for measured, system, misfit in (
        (ranges, _ranges, _range_misfit),
        (map(_directions, sightings), _rays, _ray_misfit),
    ):
        views = [
            (s.point, s.group.position(s.S), z, np.full(len(z), s.factor.states("rays")))
            for s, z in zip(sightings, measured, strict=True)
            if z is not None
        ]
        if views:
            point, s, z, camera = (np.concatenate(column) for column in zip(*views, strict=True))
            todo &= ~_solve(X, todo, point, s, z, system, partial(misfit, camera=camera))
    return X


@np.errstate(over="ignore", invalid="ignore")  # a point that is too far away is no better, and stays
def _solve(
    X: Array,
    todo: Mask,
    point: Index,
    s: Array,
    z: Array,
    system: Callable[[Array, Array], tuple[Array, Array]],
    misfit: Callable[[Array, Array], Array],
) -> Mask:
    """Put the points of X that are still to do where M and v say; returns which were (n,)."""
    n, d = X.shape
    count = np.maximum(np.bincount(point, minlength=n), 1)
    c = _sums(point, s, n) / count[:, None]
    M_i, v_i = system(s - c[point], z)
    M, v = _sums(point, M_i.reshape(-1, d * d), n).reshape(n, d, d), _sums(point, v_i, n)
    eigenvalues = np.linalg.eigvalsh(M)
    good = todo & (eigenvalues[:, 0] > DETERMINED * np.maximum(eigenvalues[:, -1], np.finfo(float).tiny))
    Y = X.copy()
    Y[good] = c[good] + np.linalg.solve(M[good], v[good][..., None])[..., 0]
    before, after = (np.bincount(point, misfit(at[point] - s, z), minlength=n) for at in (X, Y))
    better: Mask = good & (after < before)
    X[better] = Y[better]
    return better


def _ranges(u: Array, r: Array) -> tuple[Array, Array]:
    """u u' and u (|u|^2 - r^2) / 2."""
    return u[:, :, None] * u[:, None, :], u * ((np.sum(u * u, axis=1) - r * r) / 2)[:, None]


def _rays(u: Array, direction: Array) -> tuple[Array, Array]:
    """I - d d' and its product with u."""
    across = np.eye(u.shape[1]) - direction[:, :, None] * direction[:, None, :]
    return across, apply(across, u)


def _range_misfit(p: Array, r: Array, camera: Mask) -> Array:
    """(|p| - r)^2."""
    return np.asarray(np.square(np.linalg.norm(p, axis=1) - r))


def _ray_misfit(p: Array, direction: Array, camera: Mask) -> Array:
    """1 - cos of the angle between the ray and where the point is; 2 for a point behind, 1 for one at the sensor.

    Infinite for a point behind a camera.
    """
    length, along = np.linalg.norm(p, axis=1), np.sum(p * direction, axis=1)
    return np.where(camera & (along <= 0), np.inf, 1 - along / np.where(length > 0, length, 1.0))


def _directions(sighting: Sightings) -> Array | None:
    """Unit vectors (m, d) to the points, in world axes."""
    factor, z = sighting.factor, sighting.z
    if (unit := factor.directions(z)) is None and factor.states("rays"):
        with named_singularity(factor):
            rays = factor.rays(z)
        unit = None if rays is None else rays[0]
    return None if unit is None else apply(sighting.group.rotation(sighting.S), unit)


def _sums(point: Index, x: Array, n: int) -> Array:
    """Rows of x (m, k) summed by point, (n, k)."""
    return np.stack([np.bincount(point, column, minlength=n) for column in x.T], axis=1)


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


TOGETHER = 20_000  # sightings times elevations, at most, that are evaluated in one call


def misfit_of(graph: FactorGraph, values: Values, arcs: Arcs) -> Callable[[Array], Array]:
    """The function that takes elevations (g, k) to the chi2 (g, k) of all sightings of each landmark."""
    sightings = [f for f in graph.factors if isinstance(f, Sighting) and len(f) and f.keys[1].kind == arcs.kind]
    stack = values.stack(arcs.kind)
    bound = [(factor, *values.gather(factor), stack.index(factor.keys[1])) for factor in sightings]

    def evaluated(elevations: Array) -> Array:
        g, V, copies = len(elevations), len(stack), np.arange(len(elevations))[:, None]
        moved = (V * copies + arcs.rows).reshape(-1)
        L, chi2 = np.tile(stack.X.T, g).T, np.zeros(g * V)
        L[moved] = arcs._replace(S=np.tile(arcs.S, (g, 1)), z=np.tile(arcs.z, (g, 1))).points(elevations.reshape(-1))
        for factor, model, X, row in bound:
            if g > 1:
                every = np.tile(np.arange(len(factor)), g)
                model, X = factor[every].bind(*model.manifolds), tuple([take(x, every) for x in X])
            at = (V * copies + row).reshape(-1)
            s = np.square(model.error(X[0], take(L, at), *X[2:])).sum(axis=1)
            chi2 += np.bincount(at, s if factor.kernel is None else factor.kernel.rho(s), minlength=len(chi2))
        return np.asarray(chi2[moved].reshape(g, -1))

    most = TOGETHER // max(1, sum(map(len, sightings)))
    return lambda grid: np.concatenate([*map(evaluated, [grid] if len(grid) <= most else grid[:, None])])


def _best(misfit: Callable[[Array], Array], k: int, limit: float, steps: int) -> Array:
    """Elevations (k,) of smallest misfit within +-limit: on a grid, then at the lowest point of a parabola."""
    grid = limit * np.arange(-steps, steps + 1) / steps
    f = misfit(np.repeat(grid[:, None], k, axis=1))  # (2 steps + 1, k)
    columns, lowest = np.arange(k), np.argmin(f, axis=0)
    best = np.where(f[steps] - f[lowest, columns] < FLAT, steps, lowest)
    inside = (best > 0) & (best < 2 * steps) & (best == lowest)
    left, center, right = f[best - inside, columns], f[best, columns], f[best + inside, columns]
    curvature = left - 2 * center + right  # 0 where not inside
    bent = curvature > 0
    shift = np.where(bent, (left - right) / (2 * np.where(bent, curvature, 1.0)), 0.0)
    refined = grid[best] + shift * limit / steps
    return np.where(misfit(refined[None])[0] < center - FLAT, refined, grid[best])
