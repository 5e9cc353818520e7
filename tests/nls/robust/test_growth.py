"""How loop closures are accepted one after the other: in which order, what is given back, what tells the noise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import nls
from factors import Between, Diagonal
from models import SE2
from nls import FactorGraph, Values, kinds
from nls.analysis.chi_squared import chi2_gate
from nls.posegraph import Edges
from nls.robust import growth
from nls.robust.growth import path_covariances
from nls.robust.loop_graph import loop_graph

(x,) = kinds("x")
N = 40
STEP = np.array([1.0, 0.0, 2 * np.pi / N])
SIGMAS = Diagonal(x=0.05, y=0.05, yaw=0.01)
STEPS = np.arange(N - 1)
STATED = (1.0, 1.0, 10.0)  # sigma0, rho, meters


@pytest.fixture(scope="module")
def circle() -> Values:
    """Forty poses on a circle."""
    T = [np.zeros(3)]
    for _ in STEPS:
        T.append(SE2.compose(T[-1], STEP))
    return Values({x: (SE2, np.array(T))})


def closures(values: Values, i: list[int], j: list[int], off: Any = 0.0, noise: Diagonal = SIGMAS) -> Between:
    return Between(x[i], x[j], SE2.between(values[x][i], values[x][j]) + off, noise)


def odometry(noise: Diagonal = SIGMAS, off: Any = 0.0) -> Between:
    return Between(x[STEPS], x[STEPS + 1], np.tile(STEP, (N - 1, 1)) + off, noise)


def contradicted(values: Values) -> FactorGraph:
    """Right closures on both sides of two wrong ones, which odometry alone allows: its headings waver."""
    coarse, i = Diagonal(x=0.3, y=0.3, yaw=0.1), [*range(5, 10), *range(12, 17)]
    right = closures(values, i, [k + 20 for k in i], noise=coarse)
    wrong = closures(values, [10, 11], [30, 31], [1.8, -1.8, 0.0], coarse)
    return FactorGraph([odometry(Diagonal(x=0.01, y=0.01, yaw=0.05)), right, wrong])


def first_test(graph: FactorGraph, values: Values, cluster: list[int]) -> tuple[Edges, Edges, tuple[Any, ...]]:
    """The first test of all closures, at odometry."""
    pose_graph = loop_graph(graph, values)
    known, loops = pose_graph.odometry, pose_graph.closures
    P = np.full_like(loops.C, np.nan)
    return known, loops, growth._tested(known, loops, values[x], STATED, np.array(cluster), P)


def test_the_most_certain_comes_first_and_a_group_before_a_single_one(circle: Values) -> None:
    graph = FactorGraph([odometry(), closures(circle, [0, 0, 20, 1], [39, 10, 30, 11])])
    known, loops, (fits, order, P) = first_test(graph, circle, [0, 1, 2, 2])
    assert fits.tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(P, path_covariances(known, circle[x], loops.i, loops.j, 10.0))
    volume = np.log(np.linalg.det(loops.C + P) / np.linalg.det(loops.C))
    np.testing.assert_allclose(order, volume - [1, 1, 2, 2])
    assert order[0] > order[1] > order[2]  # a long loop, a short one, a short one that is not alone
    assert order[2] == pytest.approx(order[3])


def test_what_cannot_pass_keeps_its_prediction_and_what_may_gets_another(circle: Values) -> None:
    graph = FactorGraph([odometry(), closures(circle, [0, 3], [39, 20], [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]])])
    known, loops, (fits, _, P) = first_test(graph, circle, [0, 1])
    assert fits.tolist() == [0]
    again = growth._tested(known, loops, circle[x], STATED, np.array([0, 1]), 0.5 * P)
    np.testing.assert_array_equal(again[2], [P[0], 0.5 * P[1]])
    wide = growth._tested(known, loops, circle[x], STATED, np.array([0, 1]), 1e6 * P)
    np.testing.assert_array_equal(wide[2], P)
    assert wide[0].tolist() == [0]


def test_predictions_are_kept_from_round_to_round(circle: Values, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    paths = growth.path_covariances

    def counted(known: Edges, T: Any, i: Any, j: Any, meters: float) -> Any:
        asked.append(len(i))
        return paths(known, T, i, j, meters)

    monkeypatch.setattr(growth, "path_covariances", counted)
    right = closures(circle, [0, 1, 2, 10, 11, 12], [10, 12, 14, 23, 25, 27])
    far = SE2.between(circle[x][[3, 4]], circle[x][[30, 31]] + np.array([40.0, 0.0, 0.0]))
    wrong = Between(x[[3, 4]], x[[30, 31]], far, SIGMAS)  # they agree with one another
    grown = growth.grow(FactorGraph([odometry(), right, wrong]), circle)
    assert grown.masks[1].all()
    assert not grown.masks[2].any()
    assert asked[:2] == [8, 4]  # two of six were accepted, and what cannot pass is not asked again


def test_paths_are_the_same_however_many_are_searched_together(circle: Values, monkeypatch: pytest.MonkeyPatch) -> None:
    edges = loop_graph(FactorGraph([odometry()]), circle).edges
    rng = np.random.default_rng(0)
    i, j = rng.integers(0, N, (2, 30))
    together = path_covariances(edges, circle[x], i, j, 10.0)
    assert (np.linalg.eigvalsh(together[i != j]) > 0).all()
    for size in (1, 3 * N):
        monkeypatch.setattr(growth, "PLACES", size)
        np.testing.assert_array_equal(path_covariances(edges, circle[x], i, j, 10.0), together)


def test_a_quarter_is_accepted_in_a_round(circle: Values, monkeypatch: pytest.MonkeyPatch) -> None:
    waiting: list[int] = []
    tested = growth._tested

    def counted(known: Edges, loops: Edges, *rest: Any) -> Any:
        waiting.append(len(loops))
        return tested(known, loops, *rest)

    monkeypatch.setattr(growth, "_tested", counted)
    i = [0, 1, 2, 10, 11, 12, 20, 21]
    graph = FactorGraph([odometry(), closures(circle, i, [k + 8 + n for n, k in enumerate(i)])])
    grown = growth.grow(graph, circle)
    assert grown.masks[1].all()
    assert waiting[:2] == [8, 6]
    assert waiting == sorted(waiting, reverse=True)
    waiting.clear()
    monkeypatch.setattr(growth, "SHARE", 1.0)
    growth.grow(graph, circle)
    assert waiting == [8, 0]


def test_what_the_others_contradict_later_is_given_back(circle: Values, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "misfits", lambda *_: np.zeros(12, dtype=bool))  # only given back here
    graph = contradicted(circle)
    monkeypatch.setattr(growth, "SHARE", 1.0)
    accepted: list[int] = []
    solved = growth._solved

    def noted(loops: Any, values: Values, which: Any) -> Any:
        accepted.append(int(which.sum()))
        return solved(loops, values, which)

    monkeypatch.setattr(growth, "_solved", noted)
    grown = growth.grow(graph, circle)
    assert accepted[0] == 12  # all pass, alone with odometry
    assert grown.masks[1].all()
    assert not grown.masks[2].any()


def test_closures_worse_than_their_neighborhood_widen_the_test_up_to_the_stated_sigmas(
    circle: Values, monkeypatch: pytest.MonkeyPatch
) -> None:
    scales: list[float] = []
    tested = growth._tested

    def noted(known: Edges, loops: Edges, T: Any, scale: tuple[float, float, float], *rest: Any) -> Any:
        scales.append(scale.sigma0)
        return tested(known, loops, T, scale, *rest)

    medians: list[float] = []
    solved = growth._solved

    def residuals(loops: Any, values: Values, which: Any) -> Any:
        values, s = solved(loops, values, which)
        medians.append(float(np.median(s[which])))
        return values, s

    monkeypatch.setattr(growth, "_tested", noted)
    monkeypatch.setattr(growth, "_solved", residuals)
    monkeypatch.setattr(growth, "SHARE", 1.0)
    i = list(range(5, 15))
    for size, widened in ((0.15, True), (0.6, False)):  # half a sigma and two sigmas, by turns
        scales.clear()
        medians.clear()
        off = np.where(np.arange(10)[:, None] % 2, -1.0, 1.0) * [size, -size, 0.0]
        coarse = closures(circle, i, [k + 20 for k in i], off, Diagonal(x=0.3, y=0.3, yaw=0.1))
        loops = loop_graph(FactorGraph([odometry(Diagonal(x=0.01, y=0.01, yaw=0.05)), coarse]), circle)
        loops.__dict__["neighbors"] = replace(loops.neighbors, support=np.ones(10, dtype=np.intp), sigma0=0.1, rho=1.0)
        growth.grown(loops)
        assert scales[0] == 0.1
        expected = [min(max(0.1, (s / chi2_gate(3, 0.5)) ** 0.5), 1.0) for s in medians]
        np.testing.assert_allclose(scales[1:], expected[: len(scales) - 1])
        assert len(scales) == 1 or 0.1 < scales[1] <= 1.0
        assert (len(scales) > 1) >= widened


def test_odometry_that_leads_nowhere_does_not_keep_the_closures_from_being_solved(circle: Values) -> None:
    off = np.zeros((N - 1, 3))
    off[[5, 15, 25], 2] = 2.5  # turned the wrong way round, three times
    weak = Diagonal(x=0.5, y=0.5, yaw=3.0)
    i = list(range(36))
    loops = closures(circle, [*i, 0, 1], [*(k + 3 for k in i), 39, 38])
    graph = FactorGraph([odometry(weak, off), loops])
    start = nls.starts.chain(graph, circle)
    assert graph.chi2(start) > 1e4
    values, s = growth._solved(loop_graph(graph, start), start, np.ones(len(loops), dtype=bool))
    assert graph.chi2(values) < 10
    assert (s < 1).all()
    np.testing.assert_allclose(
        SE2.between(values[x][0], values[x][39]), SE2.between(circle[x][0], circle[x][39]), atol=0.05
    )
