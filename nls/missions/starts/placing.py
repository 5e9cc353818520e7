r"""The start of a mission in the world: dead reckoning turned and moved to its fixes, and beacons from their ranges.

Pairs of places in the horizontal, u_i in the world and v_i by dead reckoning. They are the fixes, the vehicle where a
ship saw it, and the beacons whose place is known. The motion is that of `models.alignment`, turned about the vertical
alone, with the weights of a Cauchy kernel; with a compass it does not turn.
"""

from __future__ import annotations

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
from nls.missions.starts.beacons import beacon_of_ranges
from nls.values import Values

__all__ = ["along_measurements", "place_beacons", "turn_to", "turn_to_measurements"]

PASSES = 10
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
    for _ in range(PASSES):
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
    for factor, u, v in [*_positions(graph, start), *_directions(graph, start, places)]:
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


def _directions(graph: FactorGraph, start: Values, places: Array) -> Iterator[tuple[Factor, Array, Array]]:
    """Directions from the vehicle to beacons of known place, the places (n, 3) and where the start heard them."""
    for factor in graph.factors:
        if isinstance(factor, BearingRange) and factor.keys[1].kind == b.name:
            u = places[start.stack(b).index(factor.keys[1])]
            if np.isfinite(u).all():
                model, X = start.gather(factor)
                yield factor, u, factor.locate(SE3, factor.sensor_pose(SE3, X[0]), model.z)


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
    points, ranges = [(none, np.zeros((0, 3)))], [(none, np.zeros((0, 4)))]
    for factor in graph.factors:
        if isinstance(factor, BearingRange) and factor.keys[1].kind == b.name:
            model, X = start.gather(factor)
            p = factor.locate(SE3, factor.sensor_pose(SE3, X[0]), model.z)
            points.append((factor.keys[1].numbers, p))
        elif isinstance(factor, Range | ScaledRange):
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
