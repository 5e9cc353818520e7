"""Loop closures judged anew while they come: wrong ones are taken out, right ones come back."""

from __future__ import annotations

import pickle
from collections.abc import Sequence

import numpy as np
import pytest

import nls
import sim
from factors import Between, Diagonal, DriftingStep, Factor, Isotropic, Prior
from models import SE2, R
from models.errors import GraphError, OptionError
from nls import FactorGraph, Incremental, Values, kinds
from nls.incremental.steps import steps

x, d = kinds("x", "d")


@pytest.fixture(scope="module")
def spoiled() -> tuple[FactorGraph, sim.World]:
    """Three laps of 50 poses, and twenty wrong closures among the right ones."""
    world = sim.ring(np.random.default_rng(3), laps=3, per_lap=50)
    rng = np.random.default_rng(1)
    i, j = rng.integers(0, 60, 20), rng.integers(70, 150, 20)
    wrong = Between(x[i], x[j], rng.normal(size=(20, 3)) * [5.0, 5.0, 1.0], Diagonal(x=0.05, y=0.05, yaw=0.01))
    return FactorGraph([*world.graph.factors, wrong]), world


def drive(smoother: Incremental, graph: FactorGraph, world: sim.World) -> None:
    for step in steps(graph.factors):
        smoother.update(step.factors, Values({x: (SE2, world.truth[x[:1]])}))


def measurements(smoother: Incremental) -> int:
    return len(smoother.graph) + sum(map(len, smoother.rejected))


def test_wrong_closures_are_out_in_the_end_and_the_map_is_that_of_the_right_ones(
    spoiled: tuple[FactorGraph, sim.World],
) -> None:
    graph, world = spoiled
    smoother = Incremental(1e-6, decide_every=15)
    drive(smoother, graph, world)
    assert len(graph) == measurements(smoother)
    decided = smoother.decide()
    wrong = {(int(a), int(b)) for a, b in zip(*(k.numbers for k in graph.factors[-1].keys), strict=True)}
    out = {(int(a), int(b)) for f in smoother.rejected for a, b in zip(*(k.numbers for k in f.keys), strict=True)}
    assert wrong <= out
    assert len(out) <= len(wrong) + 2
    assert len(decided.rejected) == sum(map(len, smoother.rejected))
    best = smoother.graph.optimize(smoother.values)
    assert abs(smoother.chi2 - best.chi2_final) <= smoother.gap + 1e-9 <= 1e-6 * smoother.chi2
    right, trusting = (g.optimize(smoother.values).values for g in (world.graph, graph))
    off = [np.linalg.norm((values[x] - right[x])[:, :2], axis=1).max() for values in (trusting, smoother.values)]
    assert off[1] < 0.1 < 1 < off[0]


def test_what_was_taken_out_comes_back_when_more_speaks_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    world = sim.ring(np.random.default_rng(3), laps=2, per_lap=40)
    smoother = Incremental(1e-6)
    drive(smoother, world.graph, world)
    before, n, judge = smoother.values, len(smoother.graph), nls.incremental.leaving.gnc

    def wary(graph: FactorGraph, values: Values, doubted: Sequence[Factor] | None) -> nls.Robustified:
        found = judge(graph, values, doubted=doubted)
        loops = [np.abs(f.keys[0].numbers - f.keys[1].numbers) == 1 for f in graph.factors]
        object.__setattr__(found, "weights", [mask.astype(float) for mask in loops])
        return found

    with monkeypatch.context() as patch:
        patch.setattr("nls.incremental.leaving.gnc", wary)
        smoother.decide()
    assert sum(map(len, smoother.rejected)) == len(world.graph.factors[1])
    again = pickle.loads(pickle.dumps(smoother))
    for one in (smoother, again):
        one.decide()
        assert not one.rejected
        assert len(one.graph) == n
        np.testing.assert_allclose(one.values[x], before[x], atol=1e-3)


def test_steps_with_a_drift_are_trusted_and_the_doubted_closures_judged() -> None:
    """With drifts it is no pose graph: what may be wrong is named, also what comes later and what was out."""
    around = 2 * np.pi * np.arange(41) / 20
    truth = np.column_stack([6 * np.cos(around), 6 * np.sin(around), around])
    steps = SE2.between(truth[:-1], truth[1:])
    k, noise = np.arange(40), Diagonal(x=0.02, y=0.02, yaw=0.01)
    reckoned = DriftingStep(x[k], x[k + 1], d[0], steps + np.array([0.05, 0.0, 0.0]), noise)
    smoother = Incremental()
    smoother.update(
        [Prior(x[0], truth[0], noise), Prior(d[0], [0.0, 0.0], Isotropic(0.5)), *reckoned],
        Values({x: (SE2, truth[:1]), d: (R(2), np.zeros((1, 2)))}),
    )
    i, j = np.arange(0, 20, 2), np.arange(20, 40, 2)
    right = Between(x[i], x[j], SE2.between(truth[i], truth[j]), noise)
    wrong = Between(x[[3, 5]], x[[30, 37]], [[2.0, 1.0, 0.5], [-3.0, 0.0, 1.0]], noise)
    with pytest.raises(GraphError):
        smoother.decide()
    smoother.update(wrong)
    smoother.update(right)
    for _ in range(2):
        decided = smoother.decide([right, wrong])
        assert {out.factor for out in decided.rejected} == {"Between(x5, x37)", "Between(x3, x30)"}
        assert sum(map(len, smoother.rejected)) == 2
    first = [Prior(x[0], truth[0], noise), Prior(d[0], [0.0, 0.0], Isotropic(0.5))]
    best = FactorGraph([*first, reckoned, right]).optimize(smoother.values).values
    np.testing.assert_allclose(smoother[x[np.arange(41)]], best[x], atol=1e-3)


def test_a_closure_that_is_not_believed_can_be_removed(spoiled: tuple[FactorGraph, sim.World]) -> None:
    graph, world = spoiled
    smoother = Incremental()
    drive(smoother, world.graph, world)
    wrong = graph.factors[-1][:5]
    smoother.update(wrong)
    smoother.decide()
    assert sum(map(len, smoother.rejected)) >= 5
    smoother.remove(wrong)
    assert not any(set(f.keys[0].numbers) & set(wrong.keys[0].numbers) for f in smoother.rejected)
    with pytest.raises(GraphError, match="is not in the estimate"):
        smoother.remove(wrong)


def test_what_cannot_be_decided_is_refused() -> None:
    with pytest.raises(OptionError, match=r"decide_every.*at least 1"):
        Incremental(decide_every=0)
    with pytest.raises(OptionError, match="None with a lag"):
        Incremental(decide_every=10, lag=5)
    smoother = Incremental()
    smoother.update(Between(x[0], x[1], [1.0, 0, 0], Diagonal(x=1, y=1, yaw=1)), Values({x: (SE2, np.zeros((1, 3)))}))
    with pytest.raises(GraphError, match="no loop closures"):
        smoother.decide()
