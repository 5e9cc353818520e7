"""From scans to a map, of all at once and while the vehicle drives: loops that close, what is chosen or refused."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Cauchy, Robust
from factors.joined import joined
from models import SE2, SE3
from models.algebra import Array
from models.errors import GraphError, OptionError
from nls import FactorGraph, Values, kinds
from nls.metrics import ate
from nls.missions.scans import Closing, Drift, Matches, OnlineClosing, Round, Scans, Verdict, close, dead_reckoning
from nls.missions.scans.closing import SELECTIONS
from nls.missions.scans.dead_reckoning import Reckoning
from sim import Scene
from tests.combinations import for_all
from tests.factors.evaluated import refused, same
from tests.nls.missions.scans.room_files import drive, laps

x, d, m = kinds("x", "d", "m")
TRUTH = laps()
ROOM = drive(TRUTH)


@pytest.fixture(scope="module")
def closing() -> Closing:
    return close(*dead_reckoning(ROOM.reckoned), ROOM.scans)


@pytest.fixture(scope="module")
def once() -> dict[str, Closing]:
    """One round with every selection."""
    return {select: close(*dead_reckoning(ROOM.reckoned), ROOM.scans, 1, select) for select in SELECTIONS}


def errors(matches: Matches) -> Array:
    """(n, 3) of the matched poses, m and rad."""
    return np.abs(SE2.local(SE2.between(TRUTH[matches.i], TRUTH[matches.j]), matches.pose))


def rmse(poses: Array) -> float:
    return ate(poses, TRUTH, align="rigid").rmse


def test_two_laps_in_a_room(closing: Closing) -> None:
    assert closing.settled
    assert rmse(ROOM.reckoned) > 1.5
    assert rmse(closing.values[x]) < rmse(ROOM.reckoned) / 5
    last = closing.matches
    assert last.kept.sum() > 40
    sigma = np.sqrt(np.diagonal(last.covariance, axis1=1, axis2=2))
    assert (errors(last) / sigma)[last.kept].max() < 4
    wrong = (errors(last) > [2.0, 2.0, 0.2]).any(axis=1)
    assert wrong.any(), "some candidates do not match"
    assert not (wrong & last.kept).any()
    assert set(np.flatnonzero(last.kept)) <= set(np.flatnonzero(last.accepted))


def test_any_step_that_changes_shows_in_the_rounds(closing: Closing) -> None:
    """Submaps, pairs and windows; matches and what became of them; the optimum."""
    counts = [(len(r.matches), int(r.matches.accepted.sum()), int(r.matches.kept.sum())) for r in closing.rounds]
    assert counts == [(115, 77, 71), (126, 96, 96)]
    same([r.matches.window.sum() for r in closing.rounds], [1188.5952742, 387.9212269], rtol=1e-6)
    same([r.chi2_dof for r in closing.rounds], [0.0508367198, 0.0404731114], rtol=1e-6)
    same([r.moved for r in closing.rounds], [1.740078026, 0.226363539], rtol=1e-6)


def test_a_round_is_what_its_graph_says(closing: Closing) -> None:
    same(closing.rounds[-1].poses, closing.values[x])
    same(closing.rounds[-1].chi2_dof, closing.result.chi2_final / closing.result.dof)
    *others, kept = closing.graph.factors
    assert len(others) == len(dead_reckoning(ROOM.reckoned)[0].factors) + 1, "sequential, no closures of earlier rounds"
    assert len(kept) == closing.matches.kept.sum()
    same(kept.z, closing.matches.pose[closing.matches.kept])
    lines = str(closing).splitlines()
    assert lines[0].startswith("round 1: ")
    assert f"{len(closing.matches)} candidates" in lines[len(closing.rounds) - 1]
    assert "rounds, " in repr(closing)


def test_the_input_stays_and_the_world_may_lie_anywhere(once: dict[str, Closing]) -> None:
    T = np.tile([[50.0, -35.0, 0.0]], (len(TRUTH), 1))  # by whole cells of the footprints
    graph, values = dead_reckoning(SE2.compose(T, ROOM.reckoned))
    before, factors, heard = values[x].copy(), list(graph.factors), list[Round]()
    moved = close(graph, values, ROOM.scans, rounds=1, report=heard.append)
    assert list(graph.factors) == factors
    assert np.array_equal(values[x], before)
    assert heard == list(moved.rounds)
    assert not moved.settled, "one round says not whether another would change anything"
    same(SE2.compose(SE2.inverse(T), moved.values[x]), once["gnc"].values[x], atol=0.05)


@for_all(select=["cauchy", "none"])
def test_other_selections_keep_all_that_are_accepted(once: dict[str, Closing], select: str) -> None:
    closing = once[select]
    assert np.array_equal(closing.matches.kept, closing.matches.accepted)
    noise = closing.graph.factors[-1].noise
    assert isinstance(noise, Robust) == (select == "cauchy")
    if isinstance(noise, Robust):
        assert isinstance(noise.kernel, Cauchy)


def test_gnc_leaves_out_wrong_ones_that_the_others_swallow(once: dict[str, Closing]) -> None:
    """In the first round, from dead reckoning."""
    chosen, everything = once["gnc"], once["none"]
    out = everything.matches.kept & ~chosen.matches.kept
    assert out.any()
    assert errors(chosen.matches)[out].mean() > 2 * errors(chosen.matches)[chosen.matches.kept].mean()
    assert rmse(chosen.values[x]) < rmse(everything.values[x])


def test_where_no_loop_closes_dead_reckoning_is_the_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a straight corridor, without points, and where no match is accepted."""
    k = np.arange(80.0)
    corridor = Scene(walls=[[[-50.0, 5.0], [300.0, 5.0]], [[-50.0, -5.0], [300.0, -5.0]]])
    way = drive(np.column_stack([2 * k, 0 * k, 0 * k]), corridor)
    empty = Scans(np.empty((0, 2)), np.empty(0, dtype=int), 80)
    monkeypatch.setattr("nls.missions.scans.closing.verdicts", lambda score, *_: np.full(len(score), Verdict.NO_FIT))
    for reckoned, scans in ((way.reckoned, way.scans), (way.reckoned, empty), (ROOM.reckoned, ROOM.scans)):
        graph, values = dead_reckoning(reckoned)
        closing = close(graph, values, scans, sequential=False)
        assert (len(closing.matches) > 0) == (scans is ROOM.scans)
        assert closing.settled
        assert closing.graph is graph
        assert not closing.matches.kept.any()
        same(closing.values[x], reckoned, atol=1e-9)


def test_what_does_not_fit() -> None:
    graph, values = dead_reckoning(ROOM.reckoned)
    refused(lambda: close(graph, values, ROOM.scans, rounds=0), OptionError, "rounds")
    refused(lambda: close(graph, values, ROOM.scans, select="best"), OptionError, "select.*gnc, cauchy, none")
    more = Scans(ROOM.scans.points, ROOM.scans.keyframe, len(TRUTH) + 3)
    named = rf"poses x of SE2, {len(TRUTH)} of them; expected SE2, x0 to x{len(TRUTH) + 2}"
    refused(lambda: close(graph, values, more), GraphError, named)
    space = Values({x: (SE3, SE3.identity(len(TRUTH)))})
    refused(lambda: close(graph, space, ROOM.scans), GraphError, "poses x of SE3")


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
