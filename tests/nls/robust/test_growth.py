"""How loop closures are accepted one after the other: in which order, what is given back, what tells the noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nls
from factors import Between, Diagonal
from models import SE2
from nls import FactorGraph, Values, kinds
from nls.robust import growth
from nls.robust.growth import path_covariances
from nls.robust.loop_graph import loop_graph

(x,) = kinds("x")
N = 40
STEP = np.array([1.0, 0.0, 2 * np.pi / N])
SIGMAS = Diagonal(x=0.05, y=0.05, yaw=0.01)
STEPS = np.arange(N - 1)


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


def test_paths_are_the_same_however_many_are_searched_together(circle: Values, monkeypatch: pytest.MonkeyPatch) -> None:
    edges = loop_graph(FactorGraph([odometry()]), circle).edges
    rng = np.random.default_rng(0)
    i, j = rng.integers(0, N, (2, 30))
    together = path_covariances(edges, circle[x], i, j, 10.0)
    assert (np.linalg.eigvalsh(together[i != j]) > 0).all()
    for size in (1, 3 * N):
        monkeypatch.setattr(growth, "PLACES", size)
        np.testing.assert_array_equal(path_covariances(edges, circle[x], i, j, 10.0), together)


def test_what_the_others_contradict_later_is_given_back(circle: Values, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "misfits", lambda *_: np.zeros(12, dtype=bool))  # only given back here
    graph = contradicted(circle)
    monkeypatch.setattr(growth, "ACCEPTED_SHARE", 1.0)
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
