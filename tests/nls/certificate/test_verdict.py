"""Certified, refuted, undecided: the verdict on the values of a pose graph, and the way on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from factors import Between, Isotropic
from models import SE2, SE3, LieGroup
from nls import FactorGraph, Values
from nls.certificate.optimum import nearest, newton, spectrum
from nls.certificate.problem import certifiable
from tests.nls.certificate.worlds import GROUPS, SEED, dominated, noise_graph, problem_of, ring, square
from tests.nls.graphs import ODD, pose_graph, walk, x


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_moving_and_renumbering_everything_changes_nothing(group: LieGroup) -> None:
    _, _, graph, values = problem_of(group, start=0.05)
    values = graph.optimize(values).values
    expected = nls.certify(graph, values)
    assert expected.verdict == "certified"
    assert expected.better is None
    assert expected.direction is None
    rng = np.random.default_rng(SEED)
    X, numbers = values.stacks["x"].X, values.stacks["x"].numbers
    moved = group.compose(group.exp(5 * rng.normal(size=(1, group.dim))), X)
    order = rng.permutation(len(numbers))
    renumbered = Values({x: (group, moved[order], numbers[order])})
    mixed = FactorGraph([f[rng.permutation(len(f))] for f in reversed(graph.factors)])
    found = nls.certify(mixed, renumbered)
    assert found.verdict == "certified"
    assert found.cost == pytest.approx(expected.cost, rel=1e-9)
    assert np.allclose(found.moved + found.moved_rms, expected.moved + expected.moved_rms, rtol=1e-4)
    least = x[int(numbers.min())]
    assert np.allclose(group.local(found.values[least], renumbered[least]), 0, atol=1e-12)
    assert graph.chi2(found.values) == pytest.approx(graph.chi2(expected.values), rel=1e-6)


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_how_far_the_two_optima_are_apart(group: LieGroup) -> None:
    _, _, graph, values = problem_of(group, start=0.05)
    found = nls.certify(graph, values)
    delta = group.local(values.stacks["x"].X, found.values.stacks["x"].X)
    distance = np.linalg.norm(group.position(values.stacks["x"].X) - group.position(found.values.stacks["x"].X), axis=1)
    angle = np.linalg.norm(delta[:, group.point_dim :], axis=1)
    assert found.moved == pytest.approx((distance.max(), angle.max()), rel=1e-9)
    assert found.moved_rms == pytest.approx((np.sqrt(np.mean(distance**2)), np.sqrt(np.mean(angle**2))), rel=1e-9)
    assert found.lower_chi2 is not None
    assert found.lower_chi2 < graph.chi2(values)


@pytest.mark.parametrize("group", GROUPS, ids=repr)
def test_exact_measurements_are_certified(group: LieGroup) -> None:
    X = walk(group, 8, np.random.default_rng(SEED))
    i, j = np.array([0, 1, 2, 3, 4, 5, 6, 7, 2]), np.array([1, 2, 3, 4, 5, 6, 7, 0, 6])
    graph = FactorGraph([Between(x[i], x[j], group.between(X[i], X[j]), Isotropic(0.1))])
    found = nls.certify(graph, Values({x: (group, X)}))
    assert found.verdict == "certified"
    assert found.cost < 1e-20
    assert found.lowest == 0.0
    assert found.converged
    assert found.eigenvalue == pytest.approx(0, abs=1e-9)
    assert found.lower_chi2 is None
    assert "The proof is in that cost, not in chi2." in found.report()
    assert found.report().count("\n") == 4


@pytest.mark.parametrize(("turns", "sigma"), [(-1, 0.1), (2, 1e5), (3, 0.1)])
def test_a_ring_wound_wrongly_is_refuted(turns: int, sigma: float) -> None:
    graph, values = ring(turns, sigma=sigma)
    values = graph.optimize(values, nls.LevenbergMarquardt()).values
    found = nls.certify(graph, values)
    assert found.verdict == "refuted"
    assert found.proved  # of the minimum, not of these values
    assert found.cost < 1e-20 * found.cost_given
    assert found.better is not None
    assert graph.chi2(found.better) < 1e-20 * found.chi2_given
    assert (found.chi2_given, found.lower_chi2) == (graph.chi2(values), graph.chi2(found.better))
    assert np.allclose(found.better[x[0]], values[x[0]], atol=1e-12)
    # the minimum beside these values is none: along the direction, as a row below every [R t], the cost falls
    problem = certifiable(graph, values)
    beside = newton(problem, problem.matrices(values.stacks["x"].X))
    known = spectrum(problem, beside)
    assert beside.cost == pytest.approx(found.cost_given, rel=1e-6)
    assert known.eigenvalues[0] < -1e-3 * sigma**-2
    raised = nearest(np.dstack([beside.M, 1e-2 * known.v]))
    expected = known.eigenvalues[0] * 1e-4 * np.sum(known.v[:, :2] ** 2)
    assert problem.cost(raised) - beside.cost == pytest.approx(expected, rel=1e-2)


def test_the_verdict_is_about_the_values_given() -> None:
    """Newton's method leaves the valley of this solution: what it reaches is proved, the solution is wrong."""
    graph, start = square()
    stuck = graph.optimize(start)
    assert (stuck.converged, stuck.chi2_final) == (True, pytest.approx(1402.585, rel=1e-5))
    problem = certifiable(graph, stuck.values)
    left = newton(problem, problem.matrices(stuck.values.stacks["x"].X))
    assert spectrum(problem, left).certified
    found = nls.certify(graph, stuck.values)
    assert (found.verdict, found.proved) == ("refuted", True)
    assert found.lower_chi2 == pytest.approx(0.08774845, rel=1e-6)
    (advice,) = found.advice
    way_on = advice.words().partition(": ")[2]
    result = eval(way_on, {"graph": graph, "certificate": found})  # as it is printed
    assert result.chi2_final == pytest.approx(found.lower_chi2, rel=1e-9)
    again = nls.certify(graph, result.values)
    assert (again.verdict, again.better, again.advice) == ("certified", None, ())
    assert again.chi2_reached == pytest.approx(again.chi2_given, rel=1e-9)


def test_values_that_are_no_optimum_are_refuted() -> None:
    graph, start = square()
    found = nls.certify(graph, start)
    assert found.better is not None
    assert found.lower_chi2 == pytest.approx(0.08774845, rel=1e-5)
    optimum = found.better  # nearly there: as good as the stop of the optimizer, and no worse than that
    verdicts = {}
    for delta in (1e-5, 1e-2):
        moved = optimum.retract(np.r_[np.zeros(9), delta, delta, delta])
        verdicts[delta] = nls.certify(graph, moved).verdict
    assert verdicts == {1e-5: "certified", 1e-2: "refuted"}
    # in a world of micrometers all poses are within `update_tol`: chi2 tells them apart
    graph = FactorGraph([Between(x[[0, 1, 2]], x[[1, 2, 0]], [1e-6, 0.0, 2 * np.pi / 3], Isotropic(1e-8))])
    exact = Values({x: (SE2, sim.chain(SE2, [0, 0, 0], np.tile([1e-6, 0.0, 2 * np.pi / 3], (2, 1))))})
    assert nls.certify(graph, exact).verdict == "certified"
    assert nls.certify(graph, exact.retract(np.r_[np.zeros(6), 5e-7, 0.0, 0.0])).verdict == "refuted"


def test_a_looser_stop_counts_but_not_for_another_minimum() -> None:
    """Two measurements that contradict each other raise all chi2 alike, so that two minima differ by 5 %."""
    graph, start = square()
    graph.add(Between(x[[0, 0]], x[[9, 9]], [[0.0, 0.0, 0.0], [23.0, 0.0, 0.0]], Isotropic(0.1)))
    numbers, far = [0, 1, 2, 3, 9], [[11.5, 0.0, 0.0]]
    wrong = graph.optimize(Values({x: (SE2, np.vstack([start.stacks["x"].X, far]), numbers)}))
    found = nls.certify(graph, wrong.values)
    right = found.better
    assert right is not None
    assert 1.02 < wrong.chi2_final / graph.chi2(right) < 1.08
    loose = nls.Stop(chi2_rtol=1e-2)
    assert nls.certify(graph, wrong.values, loose).verdict == "refuted"
    near = right.retract(np.r_[np.zeros(12), 0.05, 0.0, 0.0])
    assert 0.3 < graph.chi2(near) - graph.chi2(right) < 0.7
    assert 1.5e-5 < graph.chi2(near) / graph.chi2(right) - 1
    assert nls.certify(graph, near).verdict == "refuted"
    assert nls.certify(graph, near, loose).verdict == "certified"
    assert nls.certify(graph, near, nls.Stop(chi2_rtol=1.5e-6)).verdict == "refuted"
    near = right.retract(np.r_[np.zeros(12), 0.5, 0.0, 0.0])  # 50 of chi2, a millionth part or not, are another map
    found = nls.certify(graph, near, loose)
    assert (found.verdict, found.proved) == ("undecided", True)
    assert found.lower_chi2 == pytest.approx(graph.chi2(right), rel=1e-6)


@pytest.mark.parametrize("far", [1e3, 1e4, 1e5])
@pytest.mark.parametrize("group", GROUPS, ids=repr)
@pytest.mark.parametrize("turns", [0, 1, 2])
def test_no_minimum_hides_behind_a_contradiction(group: LieGroup, far: float, turns: int) -> None:
    """Two wrong measurements make chi2 so large that another winding, hundreds of chi2 higher, is a millionth of it."""
    graph, start = dominated(group, far, turns)
    lowest = (far - 1) ** 2 / 2 / 0.1**2  # the ring itself is exact
    if turns == 1:  # the default is stricter than a millionth of such a chi2
        assert nls.certify(graph, graph.optimize(start).values).verdict == "certified"
    result = graph.optimize(start, nls.GaussNewton(nls.Stop(chi2_rtol=1e-6)))
    found = nls.certify(graph, result.values)
    assert (result.converged, found.proved) == (True, True)
    assert 10 < result.chi2_final - lowest < 0.02 * lowest
    assert found.verdict == ("undecided" if turns == 1 else "refuted")
    assert found.cost - found.lowest < 1
    if turns == 1:
        loose = f"chi2 falls to its minimum by {result.chi2_final - lowest:.3g}, more than 1"
        assert found.sentence == f"undecided: this solution stopped too early: {loose}"
    (advice,) = found.advice
    result = eval(advice.words().partition(": ")[2], {"graph": graph, "certificate": found})  # as it is printed
    assert result.chi2_final == pytest.approx(lowest, abs=0.1)
    again = nls.certify(graph, result.values)
    assert (again.verdict, again.better) == ("certified", None)


def test_a_proof_that_rounding_widens_is_none() -> None:
    """Weight times lever is 1e14: the proof leaves 31 of chi2. Without the wrong measurement it holds."""
    graph, start = dominated(SE2, 1e6, 1)
    found = nls.certify(graph, graph.optimize(graph.optimize(start).values).values)
    while found.better is not None:
        found = nls.certify(graph, graph.optimize(found.better).values)
    assert (found.verdict, found.proved) == ("undecided", False)
    gap = found.cost - found.lowest
    assert 1 < gap < 1e-6 * found.cost
    assert found.sentence.endswith(f"optimum: that may be {gap:.3g} lower, more than 1")
    (advice,) = found.advice
    assert advice.words().startswith("look at the measurements with the largest errors")
    ring, pair = graph.factors
    rest = FactorGraph([ring, pair[[0]]])
    assert nls.certify(rest, rest.optimize(start).values).verdict == "certified"


def test_undecided_where_chi2_ends_higher_or_does_not_converge(monkeypatch: pytest.MonkeyPatch) -> None:
    _, _, graph, values = problem_of(SE3, start=0.05)
    solution = graph.optimize(values).values
    higher, endless = {"chi2_final": 1.1 * graph.chi2(solution)}, {"status": nls.Status.MAX_ITERATIONS}
    for ending, changed in {"ends higher": higher, "does not converge": endless}.items():
        result = replace(graph.optimize(solution), **changed)
        monkeypatch.setattr("nls.certificate.verdict._optimized", lambda *_, result=result: result)
        found = nls.certify(graph, solution)
        assert (found.verdict, found.better, found.proved) == ("undecided", None, True)
        assert f"optimized from the global optimum of the SE-Sync cost, {ending}\n" in found.report()


def test_what_rounding_hides_is_not_certified() -> None:
    """One edge 1e14 times the information of the others: its rounding is larger than the whole cost of a wrong ring."""
    graph, values = ring(2, n=20, sigma=1.0)
    stiff = Between(x[0], x[20], [1.0, 0.0, 0.0], Isotropic(1e-7))
    X = np.concatenate([values[x[:20]], SE2.compose(values[x[:1]], stiff.z)])
    found = nls.certify(FactorGraph([*graph.factors, stiff]), Values({x: (SE2, X)}))
    assert found.verdict == "refuted"
    assert found.cost < 1e-20 * found.cost_given


def test_the_staircase_is_taken_where_chordal_rotations_cancel(monkeypatch: pytest.MonkeyPatch) -> None:
    graph, values = ring(2)
    graph.add(Between(x[[0, 0]], x[[50, 50]], [[1.0, 0.0, 0.0], [1.0, 0.0, np.pi]], Isotropic(0.1)))
    X = np.concatenate([values[x], [[1.0, 0.0, 0.4]]])
    values = Values({x: (SE2, X, np.append(np.arange(12), 50))})
    with pytest.raises(nls.UnderconstrainedError, match="cancel"):
        nls.initialize(graph, values, "chordal")
    found = nls.certify(graph, values)
    assert (found.verdict, found.proved) == ("refuted", True)
    assert found.cost == pytest.approx(400.0 + 400.0)
    monkeypatch.setattr("nls.certificate.verdict.staircase", lambda *_: (None, 0.0))
    found = nls.certify(graph, graph.optimize(values).values)
    assert (found.verdict, found.proved) == ("undecided", False)


@pytest.mark.parametrize("seed", range(4))
def test_measurements_that_contradict_each_other_are_undecided(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the way on, followed until nothing is refuted: chi2 falls each time."""
    graph, values = noise_graph(SE3, seed)
    chi2 = [graph.optimize(values).chi2_final]
    found = nls.certify(graph, graph.optimize(values).values)
    while found.better is not None:
        result = graph.optimize(found.better)
        chi2.append(result.chi2_final)
        found = nls.certify(graph, result.values)
    assert len(chi2) > 1
    assert (np.diff(chi2) < -1e-5 * chi2[-1]).all()
    assert (found.verdict, found.proved, found.lower_chi2) == ("undecided", False, None)
    assert found.eigenvalue < -0.01
    assert found.direction is not None
    assert 0.9 * found.cost < found.lowest < (1 - 1e-4) * found.cost  # the bound of the poses with more rows
    assert "undecided" in found.report()
    assert f"{found.cost - found.lowest:.1g} above the lowest possible one at most" in found.report()
    # a bound from poses with more rows proves it, where it is near
    for gap, verdict in ((1e-4, "undecided"), (1e-8, "certified")):
        monkeypatch.setattr("nls.certificate.verdict.staircase", lambda *_, gap=gap: (None, (1 - gap) * found.cost))
        bound = nls.certify(graph, result.values)
        assert (bound.verdict, bound.proved) == (verdict, verdict == "certified")
        assert bound.lowest == pytest.approx((1 - gap) * found.cost, rel=1e-12)


def test_a_pose_that_is_fixed_or_has_a_prior_keeps_its_place() -> None:
    sample = pose_graph(SE2, anchored=True, numbers=ODD)
    certificate = nls.certify(sample.graph, sample.values)
    assert np.allclose(certificate.values[x[8]], sample.values[x[8]], atol=1e-12)
    assert not np.allclose(certificate.values[x[-3]], sample.values[x[-3]], atol=1e-6)
    graph = FactorGraph(sample.graph.factors[:-1])
    graph.fix(x[40])
    fixed = nls.certify(graph, sample.values)
    assert np.allclose(fixed.values[x[40]], sample.values[x[40]], atol=1e-12)
    assert fixed.cost == pytest.approx(certificate.cost, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "cost"), [("pose-graphs-2d/intel.g2o", 52.348227), ("pose-graphs-3d/parking-garage.g2o.gz", 1.262524)]
)
def test_published_optima_are_certified(data: Path, name: str, cost: float) -> None:
    """D. Rosen et al., "SE-Sync", IJRR 38(2-3), 2019, tables 1 and 2, print 52.35 and 1.263."""
    graph, values, _ = nls.load(data / name)
    start, *_ = nls.initialize(graph, values)
    found = nls.certify(graph, graph.optimize(start).values)
    assert found.verdict == "certified"
    assert found.converged
    assert found.steps <= 6
    assert found.cost == pytest.approx(cost, rel=1e-6)
    assert found.cost - found.lowest < 1e-6 * cost
    assert found.eigenvalues[-1] > 1e-4
    assert found.lower_chi2 is None
