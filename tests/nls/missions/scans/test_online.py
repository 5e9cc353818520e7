"""Loops closed while the vehicle drives: the map in the end is that of all at once, and no closure is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from factors.joined import joined
from models import SE2
from models.algebra import Array
from models.errors import GraphError
from nls import FactorGraph, Values, kinds
from nls.missions.scans import Drift, OnlineClosing, Scans, close, dead_reckoning
from nls.missions.scans.dead_reckoning import Reckoning

x, d, m = kinds("x", "d", "m")
DRIFT = Drift(mean=0.2, stretch=0.05, heading=0.02)
MOUNT = np.array([0.4, 0.0, 0.1])


def rooms(laps: int = 2, side: int = 12) -> tuple[Array, Array, list[Array]]:
    """True poses (n, 3) around a square in a hall with pillars, reckoned ones, and what a sonar ahead shows of it."""
    rng = np.random.default_rng(1)
    edge = np.arange(0, 28, 0.3) - 8.0
    pillars = rng.uniform(-7, 19, (30, 1, 2)) + rng.uniform(-0.7, 0.7, (30, 8, 2))
    walls = [np.column_stack([edge, np.full_like(edge, far)]) for far in (20.0, -8.0)]
    world = np.concatenate([*walls, *(wall[:, ::-1] for wall in walls), pillars.reshape(-1, 2)])
    turn = np.arange(laps * 4 * side) // side * np.pi / 2
    step = np.column_stack([np.cos(turn), np.sin(turn)])
    truth = np.column_stack([np.cumsum(step, axis=0) - step, turn])
    steps = SE2.between(truth[:-1], truth[1:])
    steps += np.array([0.15, -0.08, 0.0]) + rng.normal(0, [0.03, 0.03, 0.003], steps.shape)
    reckoned = [truth[0]]
    for z in steps:
        reckoned.append(SE2.compose(reckoned[-1][None], z[None])[0])
    scans = []
    for pose in SE2.compose(truth, np.tile(MOUNT, (len(truth), 1))):
        q = SE2.act(SE2.inverse(np.tile(pose, (len(world), 1))), world)
        q = q[(np.hypot(*q.T) < 15) & (np.abs(np.arctan2(q[:, 1], q[:, 0])) < 1.1)][::3]
        scans.append(q + rng.normal(0, 0.05, q.shape))
    return truth, np.array(reckoned), scans


@pytest.fixture(scope="module")
def driven() -> tuple[OnlineClosing, Array, Array]:
    """After the last keyframe; the truth, and every pose as it was estimated when it was new."""
    truth, reckoned, scans = rooms()
    online = OnlineClosing(DRIFT, mount=MOUNT)
    then = [online.update(pose, points) for pose, points in zip(reckoned, scans, strict=True)]
    return online, truth, np.array(then)


def off(poses: Array, truth: Array) -> Array:
    return np.asarray(np.linalg.norm(poses[:, :2] - truth[:, :2], axis=1))


def test_the_map_in_the_end_is_that_of_all_at_once(driven: tuple[OnlineClosing, Array, Array]) -> None:
    online, truth, then = driven
    graph, values = dead_reckoning(online.reckoned, DRIFT)
    whole = close(graph, values, online.scans, rounds=2)
    assert off(online.reckoned, truth).max() > 2.0
    assert off(online.poses, whole.values[x]).max() < 0.8
    assert off(online.poses, truth).max() < 0.6
    assert off(then, truth)[-20:].max() < 0.6  # known then, not only in the end


def test_no_closure_that_is_kept_is_wrong(driven: tuple[OnlineClosing, Array, Array]) -> None:
    online, truth, _ = driven
    matches = online.matches
    assert matches is not None
    error = SE2.local(SE2.between(truth[matches.i], truth[matches.j]), matches.pose)[matches.kept]
    assert len(error) > 10
    assert np.abs(error[:, :2]).max() < 1.0
    assert np.abs(error[:, 2]).max() < 0.1
    assert sum(len(factor) for factor in online.graph.factors if factor.keys[-1].kind == "x") >= matches.kept.sum()


def test_the_estimate_is_at_the_optimum_of_its_graph(driven: tuple[OnlineClosing, Array, Array]) -> None:
    online, _, _ = driven
    best = online.graph.optimize(online.values)
    assert online.smoother.chi2 - best.chi2_final <= 1e-3 * max(best.chi2_final, 1.0)


def test_keyframes_one_by_one_have_the_factors_of_all() -> None:
    """Also where the vehicle stands, and where a step is longer than a stretch."""
    rng = np.random.default_rng(0)
    way = np.cumsum(rng.choice([0.0, 0.4, 3.0, 25.0], 40))
    X = np.column_stack([way, 0.1 * way, rng.normal(0, 0.3, 40)])
    graph, values = dead_reckoning(X)
    reckoning = Reckoning()
    parts = [factor for pose in X for factor in reckoning.add(pose[None])]
    moved = Values.of([s.moved(s.manifold.retract(s.X, rng.normal(size=s.X.shape))) for s in values.stacks.values()])
    whole = FactorGraph(joined([moved.gather(factor)[0] for factor in parts]))
    assert len(whole) == len(graph)
    assert {s.kind: len(s) for s in values.stacks.values()} == {"x": 40, "d": reckoning.stretches, "m": 1}
    np.testing.assert_allclose(whole.chi2(moved), graph.chi2(moved), rtol=1e-12)


def test_without_points_there_is_dead_reckoning() -> None:
    online = OnlineClosing()
    X = np.column_stack([np.arange(40.0), np.zeros(40), np.zeros(40)])
    for pose in X:
        online.update(pose, np.zeros((0, 2)))
    assert online.matches is None
    online.judge()
    np.testing.assert_allclose(online.poses, X, atol=1e-9)
    assert isinstance(online.scans, Scans)
    assert len(online.scans.points) == 0


def test_what_is_refused_changes_nothing() -> None:
    online = OnlineClosing()
    online.update([0.0, 0.0, 0.0], [[5.0, 0.0]])
    for pose, points in (([1.0, 0.0, np.nan], [[5.0, 0.0]]), ([1.0, 0.0], []), ([1.0, 0.0, 0.0], [[5.0, np.inf]])):
        with pytest.raises(GraphError):
            online.update(pose, points)
        assert len(online) == 1
    np.testing.assert_allclose(online.update([1.0, 0.0, 0.0], []), [1.0, 0.0, 0.0], atol=1e-9)
