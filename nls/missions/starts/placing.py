r"""The start of a mission in the world: dead reckoning turned and moved to its fixes, and beacons from their ranges.

Pairs of places in the horizontal, u_i in the world and v_i by dead reckoning. They are the fixes, the vehicle where a
ship saw it, and the beacons whose place is known. The motion is that of `models.alignment`, turned about the vertical
alone, with the weights of a Cauchy kernel; with a compass it does not turn.

**Beacons.** The place of a beacon from ranges alone, measured from a track that is nearly level.

With positions p_i, u_i = (p_i - c) in the horizontal and their mean c, the squared ranges less their mean are linear:

    sum u_i u_i' l = sum u_i (|u_i|^2 - rho_i^2) / 2,   rho_i^2 = r_i^2 - (z - p_z,i)^2     l from c, in the horizontal

of a beacon of depth z. Without z the r_i themselves stand for rho_i, and the mean of r_i^2 - |l - u_i|^2 is
(z - p_z)^2, above or below. Along the shorter axis of the track the sums say little; there the mean says how far, to
one side or the other. All these candidates and their mirror images are improved by least squares with the weights of a
Cauchy kernel. The best one counts, of equal ones that below.

Source: E. Olson, J. Leonard, S. Teller, "Robust range-only beacon localization", IEEE J. Oceanic Engineering 31, 2006.
"""

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from factors import BearingRange, Position, Range, ScaledRange
from factors.base import Factor
from factors.keys import kinds
from models import SE3, euler
from models.algebra import Array, Index
from models.alignment import align
from models.errors import SingularGeometryError
from nls.graph import FactorGraph
from nls.missions.folder.calibration import Compass
from nls.values import Values

x, b, s = kinds("x", "b", "s")


def turn_to(pose: Array, x_m: float, y_m: float, yaw: float) -> Array:
    """The motion (7,) about the vertical and in the horizontal that brings a pose (7,) to x, y and yaw."""
    state = euler.from_se3(pose).reshape(-1)
    turn = euler.to_se3([0.0, 0.0, yaw - state[2], 0.0, 0.0, 0.0])
    turned = SE3.act(turn, state[3:])
    turn[:2] = x_m - turned[0], y_m - turned[1]
    return np.asarray(turn)


def turn_to_measurements(graph: FactorGraph, start: Values, places: Array, compass: Compass | None) -> Array:
    """The motion (7,) that brings dead reckoning to what was measured in the world.

    Parameters
    ----------
    graph, start : of the mission; its poses by dead reckoning.
    places : (m, 3) of the beacons in the order of their stack, nan where they are not known.
    compass : poses and their yaw by a compass.
    """
    turn = SE3.identity()[0]
    if compass is not None:
        poses, yaw = compass
        state = euler.from_se3(start[poses[[0]]])[0]
        turn = euler.to_se3([0.0, 0.0, float(yaw[0]) - float(state[2]), 0.0, 0.0, 0.0])
    u, v = _pairs(graph, start, places)
    if not len(u):
        return np.asarray(turn)
    v = SE3.act(turn, np.column_stack([v, np.zeros(len(v))]))[:, :2]
    w = np.ones(len(u))
    motion = np.zeros(3)
    for _ in range(10):
        motion = _motion(u, v, w, compass is not None)
        c, sn = np.cos(motion[2]), np.sin(motion[2])
        away = np.linalg.norm(u - v @ np.array([[c, sn], [-sn, c]]) - motion[:2], axis=1)
        scale = max(2.385 * float(np.median(away)), 1e-9)
        w = 1 / (1 + np.square(away / scale))
    return np.asarray(SE3.compose(euler.to_se3([0.0, 0.0, motion[2], *motion[:2], 0.0]), turn)).reshape(-1)


def along_measurements(graph: FactorGraph, start: Values, places: Array, compass: Compass | None) -> None:
    """Put poses (n,) that nothing moves on the straight lines between those that were measured, in their order.

    Parameters are those of `turn_to_measurements`; a compass says the yaw of its poses.
    """
    X = euler.from_se3(start[x])
    if compass is not None:
        X[start.stack(x).index(compass[0]), 2] = compass[1]
    start[x] = euler.to_se3(X)
    numbers, away = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    heard = ((factor, places[start.stack(b).index(factor.keys[1])], p) for factor, p in _heard(graph, start))
    for factor, u, v in (*_positions(graph, start), *heard):
        if np.isfinite(u).all():
            numbers.append(factor.keys[factor.keys[0].kind == s.name].numbers)
            away.append(u - v)
    k, p = np.concatenate(numbers), np.concatenate(away)
    if len(k):
        order = np.argsort(k, kind="stable")
        X[:, 3:] += np.column_stack([np.interp(start.stack(x).numbers, k[order], c) for c in p[order].T])
        start[x] = euler.to_se3(X)


def _motion(u: Array, v: Array, w: Array, compass: bool) -> Array:
    """(x, y, yaw) of the motion of v onto u; without a turn where a compass knows it or one spot leaves it free."""
    if not compass:
        with suppress(SingularGeometryError):  # one spot
            return align(u, v, w)
    return np.append(w @ (u - v) / w.sum(), 0.0)


def _pairs(graph: FactorGraph, start: Values, places: Array) -> tuple[Array, Array]:
    """u and v (n, 2)."""
    u, v = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for _, measured, predicted in _positions(graph, start):
        u.append(measured[:, :2])
        v.append(predicted[:, :2])
    known = np.isfinite(places).all(axis=1)
    if known.any():
        at, rows = _beacons(graph, start, places)
        use = known & (rows > 0)
        u.append(np.repeat(places[use, :2], rows[use], axis=0))
        v.append(np.repeat(at[use, :2], rows[use], axis=0))
    return np.concatenate(u), np.concatenate(v)


def _positions(graph: FactorGraph, start: Values) -> Iterator[tuple[Factor, Array, Array]]:
    """Factors that say where the vehicle is, the places (n, 3), and those of the start, as z may be."""
    for factor in graph.factors:
        if isinstance(factor, Position) and (factor.components or ("x", "y"))[:2] == ("x", "y"):
            model, X = start.gather(factor)
            v = SE3.act(X[0], np.zeros(3) if factor.offset is None else factor.offset)
            yield factor, np.hstack([model.z, v[:, model.z.shape[1] :]]), v
        elif isinstance(factor, BearingRange) and factor.keys[0].kind == s.name:
            model, X = start.gather(factor)
            yield factor, factor.locate(SE3, X[0], model.z), SE3.position(X[1])


def _heard(graph: FactorGraph, start: Values) -> Iterator[tuple[Factor, Array]]:
    """Directions from the vehicle to beacons, and where (n, 3) the start heard them."""
    for factor in graph.factors:
        if isinstance(factor, BearingRange) and factor.keys[1].kind == b.name:
            model, X = start.gather(factor)
            yield factor, factor.locate(SE3, factor.sensor_pose(SE3, X[0]), model.z)


def place_beacons(graph: FactorGraph, start: Values, places: Array) -> None:
    """Put the beacons where they are known to be; the others where the poses of the start heard them."""
    if not len(places):
        return
    at, _ = _beacons(graph, start, places)
    start[b] = np.where(np.isfinite(places), places, at)


def _beacons(graph: FactorGraph, start: Values, places: Array) -> tuple[Array, Index]:
    """Where the poses of the start heard the beacons (m, 3), and in how many measurements (m,).

    A direction with a range counts before ranges.
    """
    none = np.zeros(0, dtype=np.int64)
    points = [(none, np.zeros((0, 3))), *((factor.keys[1].numbers, p) for factor, p in _heard(graph, start))]
    ranges = [(none, np.zeros((0, 4)))]
    for factor in graph.factors:
        if isinstance(factor, Range | ScaledRange):
            model, X = start.gather(factor)
            scale = 1.0 if len(X) == 2 else 1 + X[2]
            plain = factor if isinstance(factor, Range) else factor.unscaled()
            from_places = SE3.position(plain.sensor_pose(SE3, X[0]))
            ranges.append((factor.keys[1].numbers, np.hstack([from_places, model.z / scale])))
    (of_points, p), (of_ranges, r) = (map(np.concatenate, zip(*parts, strict=True)) for parts in (points, ranges))
    numbers = start.stack(b).numbers
    at, count = np.zeros((len(numbers), 3)), np.zeros(len(numbers), dtype=np.intp)
    for k, number in enumerate(numbers.tolist()):
        here, rows = p[of_points == number], r[of_ranges == number]
        if len(here):
            at[k], count[k] = np.median(here, axis=0), len(here)
        elif len(rows):
            z = None if np.isnan(places[k, 2]) else float(places[k, 2])
            at[k], count[k] = beacon_of_ranges(rows[:, :3], rows[:, 3], z), len(rows)
    return at, count


# --- a beacon from ranges ---------------------------------------------------------------------------------------------

EXACT = 1e-9  # of the longest range: a scatter of rounding


def beacon_of_ranges(p: Array, r: Array, z: float | None = None) -> Array:
    """The beacon (3,), m, of ranges r (n,) from positions p (n, 3), z down.

    Parameters
    ----------
    p : (n, 3) positions, m.
    r : (n,) ranges, m; some may be wrong by far.
    z : depth of the beacon, m; None where it is not known, and then below where above fits as well.

    Examples
    --------
    >>> import numpy as np
    >>> p = np.array([[0.0, 0, 1], [10, 0, 1], [10, 10, 1], [0, 10, 1], [5, 5, 1]])
    >>> r = np.linalg.norm(p - [40.0, -20.0, 12.0], axis=1)
    >>> beacon_of_ranges(p, r, 12.0).round(6), beacon_of_ranges(p, r).round(3)
    (array([ 40., -20.,  12.]), array([ 40., -20.,  12.]))
    """
    candidates = [_improved(candidate, p, r, z is None) for candidate in _candidates(p, r, z)]
    candidates += [_improved(_mirrored(candidate, p), p, r, z is None) for candidate in candidates]
    candidates.sort(key=lambda candidate: -candidate[2])  # those below first
    errors = [np.abs(np.linalg.norm(p - candidate, axis=1) - r) for candidate in candidates]
    scale = max(min(1.4826 * float(np.median(e)) for e in errors), EXACT * float(r.max()))
    best, least = 0, np.inf
    for k, e in enumerate(errors):
        misfit = float(np.log1p(np.square(e / scale)).sum())
        if misfit < 0.99 * least - 1e-3:  # one that is no better keeps the one before it
            best, least = k, misfit
    return candidates[best]


def _candidates(p: Array, r: Array, z: float | None) -> list[Array]:
    """Places (3,) where the beacon may be."""
    c = p.mean(axis=0)
    u = p[:, :2] - c[:2]
    drop = np.zeros(len(r)) if z is None else z - p[:, 2]
    rho2 = np.maximum(np.square(r) - np.square(drop), 0.0)
    spread, axes = np.linalg.eigh(u.T @ u)
    v = axes.T @ (u * ((np.square(u).sum(axis=1) - rho2) / 2)[:, None]).sum(axis=0)
    known = spread > EXACT * max(float(spread[1]), 1e-12)
    along = np.divide(v, spread, out=np.zeros(2), where=known)  # across the track, and along it
    left = float(rho2.mean() - np.square(u).sum(axis=1).mean() - along[1] ** 2)
    beside = np.sqrt(max(left, 0.0))
    over = np.sqrt(max(left - along[0] ** 2, 0.0)) if z is None else 0.0
    depth = c[2] if z is None else z
    places = [(along[0], depth + over)]
    if z is None:
        places += [(along[0], depth - over)]
        places += [(side * beside * np.sqrt(0.5), depth + beside * np.sqrt(0.5)) for side in (1, -1)]
    places += [(side * beside, depth) for side in (1, -1)]
    return [np.append(c[:2] + axes @ [across, along[1]], down) for across, down in places]


def _mirrored(place: Array, p: Array) -> Array:
    """A place on the other side of the longer axis of the track, from where ranges nearly fit as well."""
    c = p[:, :2].mean(axis=0)
    across = np.linalg.eigh((p[:, :2] - c).T @ (p[:, :2] - c))[1][:, 0]
    return np.append(place[:2] - 2 * across * (across @ (place[:2] - c)), place[2])


def _improved(place: Array, p: Array, r: Array, free: bool) -> Array:
    """A candidate moved by Gauss-Newton with the weights of a Cauchy kernel; its depth is held unless it is free."""
    l, dims = place.copy(), 3 if free else 2
    for _ in range(30):
        d = l - p
        h = np.maximum(np.linalg.norm(d, axis=1), 1e-9)
        e = r - h
        scale = max(2.385 * 1.4826 * float(np.median(np.abs(e))), EXACT * float(r.max()))
        w = 1 / np.sqrt(1 + np.square(e / scale))
        H = (d / h[:, None])[:, :dims]
        step = np.linalg.lstsq(H * w[:, None], e * w, rcond=1e-4)[0]
        length = np.linalg.norm(step)
        l[:dims] += step * min(1.0, float(np.median(h)) / max(float(length), 1e-12))
        if length < 1e-9 * float(r.max()):
            break
    return l
