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
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from factors import Factor, Sighting
from factors.mount import named_singularity
from models import LieGroup
from models.algebra import Array, Index, Mask, Numbers, apply
from nls.gauge import fixed_of
from nls.graph import FactorGraph
from nls.values import Stack, Values

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
