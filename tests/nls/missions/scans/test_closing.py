"""From scans to a map: a room gone around twice, a corridor without a loop, what is chosen and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Cauchy, Robust
from models import SE2, SE3
from models.errors import GraphError, OptionError
from nls import Values, kinds
from nls.metrics import ate
from nls.missions.scans import Closing, Matches, Round, Scans, Verdict, close, dead_reckoning
from nls.missions.scans.closing import SELECTIONS
from sim import Scene
from tests.combinations import for_all
from tests.factors.evaluated import Array, refused, same
from tests.nls.missions.scans.rooms import drive, laps

(x,) = kinds("x")
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
