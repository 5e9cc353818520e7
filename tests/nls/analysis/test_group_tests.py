"""Groups of closures as one measurement: against really leaving them out, and whom `nls.explain` names."""

from __future__ import annotations

import numpy as np
import pytest

import nls
import sim
from factors import Between, Diagonal, Prior
from models import SE2, R
from models.algebra import Array, Index
from nls import FactorGraph, Values
from nls.analysis.chi_squared import chi2_log_tail
from nls.analysis.leave_one_out import Checked, Linearization, checks
from nls.analysis.suspects import GroupTests
from tests.combinations import for_all

x, y = nls.kinds("x", "y")
SIGMAS = Diagonal(x=0.05, y=0.05, yaw=0.01)
STEP = 0.3


def lines() -> tuple[FactorGraph, Values, Checked]:
    """A linear problem at its optimum: 120 points on a line, closures in three groups, of which the third is off."""
    rng = np.random.default_rng(0)
    a = np.arange(119)
    i = np.array([0, 1, 2, 1, 3, 50, 51, 52])
    j = np.array([30, 31, 32, 100, 102, 90, 91, 92])
    off = np.where((i >= 50)[:, None], [3.0, -2.0], 0.0)
    noise = Diagonal([0.1, 0.2])
    steps = Between(x[a], x[a + 1], [STEP, 0.0] + 0.1 * rng.normal(size=(119, 2)), noise)
    closures = Between(x[i], x[j], (j - i)[:, None] * [STEP, 0.0] + off + 0.1 * rng.normal(size=(8, 2)), noise)
    graph = FactorGraph([steps, closures, Prior(x[0], [[0.0, 0.0]], noise)])
    values = graph.optimize(Values({x: (R(2), np.zeros((120, 2)))})).values
    return graph, values, Checked(Linearization(graph.pattern(values), values))


def without(graph: FactorGraph, values: Values, members: Index) -> float:
    """chi2 of the optimum without some closures, of a linear problem."""
    masks = [np.ones(len(factor), dtype=bool) for factor in graph.factors]
    masks[1][members] = False
    return graph.only(masks).optimize(values).chi2_final


def ones(graph: FactorGraph) -> list[Array]:
    return [np.ones(len(factor)) for factor in graph.factors]


def test_t_is_the_decrease_of_chi2_without_the_group() -> None:
    graph, values, checked = lines()
    tests = GroupTests(checked, ones(graph), 10)
    test = tests.worst()
    assert test is not None
    assert (test.index.tolist(), test.batch.tolist()) == ([5, 6, 7], [1, 1, 1])
    assert test.t == pytest.approx(graph.chi2(values) - without(graph, values, test.index), rel=1e-8)
    assert test.log_tail == chi2_log_tail(test.t, 6)
    assert max(t.t.max() for t in checks(checked, 3)) < test.t
    halved = GroupTests(checked, [4 * each for each in ones(graph)], 10).worst()
    assert halved is not None
    assert halved.t == pytest.approx(test.t / 4)


def test_groups_follow_when_others_are_taken_out() -> None:
    graph, values, checked = lines()
    tests = GroupTests(checked, ones(graph), 10)
    assert tests.worst() is not None  # joint covariances of all groups from here
    taken = np.array([0, 1, 2])
    checked.take_out(np.ones(3, dtype=np.intp), taken)
    accepted = ones(graph)
    accepted[1][taken] = 0.0
    again = Checked(Linearization(checked.linear.pattern, values, accepted))
    for k in range(3):
        np.testing.assert_allclose(checked.e[k], again.e[k], atol=1e-9)
        np.testing.assert_allclose(checked.C[k], again.C[k], atol=1e-9)
        np.testing.assert_array_equal(checked.w[k], again.w[k])
    late, fresh = tests.worst(), GroupTests(again, ones(graph), 10).worst()
    assert late is not None
    assert fresh is not None
    assert late.index.tolist() == fresh.index.tolist()
    fall = without(graph, values, taken) - without(graph, values, np.r_[taken, late.index])
    assert [late.t, fresh.t] == pytest.approx([fall, fall], rel=1e-7)


@for_all(seed=range(2))
def test_of_five_wrong_closures_that_agree_all_are_named_and_no_right_one(seed: int) -> None:
    """Three right closures against five wrong ones: one by one, the right ones are the farthest from all others."""
    world, k = sim.ring(np.random.default_rng(seed), laps=2, per_lap=60), np.arange(5)
    odometry, closures = world.graph.factors
    seen = SE2.between(world.truth[x[15 + k]], world.truth[x[105 + k]])
    wrong = Between(x[15 + k], x[105 + k], SE2.compose([[2.0, 1.0, 0.3]], seen), SIGMAS)  # one place for another
    graph = FactorGraph([odometry, closures[[0, 15, 29]], wrong])
    explanation = nls.explain(graph, graph.optimize(world.start).values)
    assert {suspect.factor for suspect in explanation.suspects} == {wrong.describe(k) for k in range(5)}


def test_a_group_without_which_something_is_free_is_not_taken_out() -> None:
    """Two trajectories that four closures join, one of which is wrong."""
    truth, k = np.arange(31.0)[:, None] * [1, 0, 0], np.arange(4)
    joined = Between(x[k], y[k], (k == 2)[:, None] * [3.0, 2.0, 0.5], SIGMAS)
    graph = FactorGraph([*(Between(p[:30], p[1:31], [1.0, 0, 0], SIGMAS) for p in (x, y)), joined])
    values = graph.optimize(Values({x: (SE2, truth), y: (SE2, truth)})).values
    assert [suspect.factor for suspect in nls.explain(graph, values).suspects] == [joined.describe(2)]


@for_all(dof=[1, 15, 300])
def test_the_logarithm_of_the_tail_goes_on_where_the_tail_is_zero(dof: int) -> None:
    """The slope, the hazard rate of chi-squared, has no step at the change to the expansion; log(0) is never taken."""
    t = np.append(np.linspace(1.0, 2500.0, 5000), [1e4, 2e4])
    log_tail = np.array([chi2_log_tail(float(bound), dof) for bound in t])
    assert np.isfinite(log_tail).all()
    slope = np.diff(log_tail) / np.diff(t)
    assert (slope <= 0).all()
    assert np.abs(np.diff(slope[:-2])).max() < 0.05
    assert slope[-1] == pytest.approx(-0.5, abs=0.02)
