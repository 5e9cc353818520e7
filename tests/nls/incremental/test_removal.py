"""`nls.Incremental`: what fails or is taken out leaves nothing behind; closures are judged anew while they come."""

from __future__ import annotations

import pickle
from collections.abc import Sequence

import numpy as np
import pytest

import nls
import sim
from factors import BearingRange, Between, Diagonal, DriftingStep, Factor, Huber, Isotropic, Prior, Range
from models import SE2, R
from models.algebra import Array, wrap
from models.errors import EvaluationError, GraphError, NoiseModelError, UnderconstrainedError
from nls import FactorGraph, Incremental, Values, kinds
from tests.nls.incremental.test_incremental import STEP, grown, is_optimal, l, same, x


def test_what_would_be_free_stays() -> None:
    smoother = Incremental()
    walk = [Between(x[k], x[k + 1], [1.0, 0, 0], STEP) for k in range(3)]
    smoother.update(walk, Values({x: (SE2, [[0.0, 0, 0]])}))
    before = smoother.values
    with pytest.raises(UnderconstrainedError, match="nothing else connects x2 to the rest"):
        smoother.remove(walk[1])
    assert (smoother[x[3]] == before[x[3]]).all()
    assert len(smoother.graph) == 3
    smoother.update(Between(x[0], x[3], [3.0, 0.1, 0], STEP))
    is_optimal(smoother)
    smoother.remove(walk[1])
    is_optimal(smoother)
    np.testing.assert_allclose(smoother[x[2]], [2, 0.1, 0], atol=1e-3)


def test_a_list_is_taken_out_whole_or_not_at_all() -> None:
    smoother = Incremental(tol=1e-9)
    walk = [Between(x[k], x[k + 1], [1, 0, 0], STEP) for k in range(3)]
    smoother.update([Prior(x[0], [0, 0, 0], STEP), *walk], Values({x: (SE2, [[0, 0, 0]])}))
    straight = smoother.values.stack("x").X.copy()
    wrong = [Between(x[0], x[2], [3, 1, 0], STEP), Between(x[1], x[3], [1, -1, 0], STEP)]
    smoother.update(wrong)
    bent, chi2, gap = smoother.values.stack("x").X.copy(), smoother.chi2, smoother.gap
    again = Between(x[0], x[2], [3, 1, 0], STEP)
    with pytest.raises(GraphError, match="`given` has another object of its type and variables"):
        smoother.remove([wrong[1], again])
    with pytest.raises(GraphError, match="expected factors"):
        smoother.remove([wrong[0], "x0"])  # type: ignore[list-item]
    with pytest.raises(UnderconstrainedError):
        smoother.remove([walk[1], *wrong])
    np.testing.assert_array_equal(smoother.values.stack("x").X, bent)
    assert (smoother.chi2, smoother.gap) == (chi2, gap)
    smoother.remove(wrong)
    np.testing.assert_allclose(smoother.values.stack("x").X, straight, atol=1e-6)
    assert len(smoother.graph.factors) == 2
    is_optimal(smoother)


def test_a_measurement_that_waits_can_be_taken_back() -> None:
    smoother, ranges = Incremental(), Range(x[0], l[1], 2.0, STEP)
    start = Values({x: (SE2, [[0.0, 0, 0]]), l: (R(2), np.zeros((0, 2)))})
    smoother.update([Prior(x[0], [0.0, 0, 0], STEP), ranges], start)
    assert smoother.pending == (ranges,)
    smoother.remove(ranges)
    assert smoother.waiting == smoother.pending == ()


def beacons(landmark: bool = True) -> tuple[Incremental, list[Factor]]:
    """Four poses in a row, and a landmark by three ranges."""
    smoother = Incremental(1e-9)
    smoother.update(Prior(x[0], [0, 0, 0], STEP), Values({x: (SE2, [[0, 0, 0]]), l: (R(2), np.zeros((0, 2)))}))
    smoother.update([Between(x[k], x[k + 1], [1, 0, 0.4], STEP) for k in range(3)])
    ranges: list[Factor] = [Range(x[k], l[0], z, STEP) for k, z in enumerate((2.0, 1.7, 1.4)) if landmark]
    smoother.update(ranges)
    return smoother, ranges


def test_a_landmark_leaves_with_its_last_measurement_and_comes_back() -> None:
    (smoother, ranges), never = beacons(), beacons(landmark=False)[0]
    assert l[0] in smoother
    smoother.remove(ranges)
    assert l[0] not in smoother
    assert "l" not in {kind for kind, stack in smoother.values.stacks.items() if len(stack)}
    np.testing.assert_allclose(smoother.values[x], never.values[x], atol=1e-6)
    assert (smoother.chi2, len(smoother.graph)) == (pytest.approx(never.chi2, abs=1e-9), 4)
    smoother.marginals()
    smoother.update(ranges)
    same(smoother, smoother.graph.optimize(smoother.values), 1e-4)
    assert l[0] in smoother


def test_a_removal_that_leaves_something_free_is_refused_and_its_cure_works() -> None:
    smoother, ranges = beacons()
    before, held = smoother.values, len(smoother.graph)
    with pytest.raises(UnderconstrainedError, match=r"l0.*\n(.*\n)*.*remove all measurements of l0 at once") as refused:
        smoother.remove(ranges[:2])
    assert len(smoother.graph) == held
    for kind, stack in before.stacks.items():
        assert (smoother.values.stacks[kind].X == stack.X).all()
    smoother.remove([f for f in ranges if any(key in refused.value.keys for key in f.keys)])
    assert l[0] not in smoother
    is_optimal(smoother)


def test_all_can_be_taken_out_and_given_again() -> None:
    smoother = Incremental()
    given = [Prior(x[0], [1, 2, 3], STEP), Between(x[0], x[1], [1, 0, 0], STEP)]
    smoother.update(given, Values({x: (SE2, [[0, 0, 0]])}))
    smoother.remove(given)
    assert (smoother.chi2, smoother.gap, x[0] in smoother) == (0, 0, False)
    smoother.update(given)
    np.testing.assert_allclose(smoother[x[0]], [1, 2, 3], atol=1e-9)


def circling(seed: int, share: float, poses: int) -> tuple[list[Factor], list[Factor], Values]:
    """Landmarks passed at some centimeters, one sighting an update; a share of them names a wrong one."""
    rng = np.random.default_rng(seed)
    L, angle = rng.uniform(-12, 12, (15, 2)), np.linspace(0, 4 * np.pi, 80)[:poses]
    T = np.stack([8 * np.cos(angle), 8 * np.sin(angle), angle + np.pi / 2], axis=1)
    given: list[Factor] = [Prior(x[0], T[0], Isotropic(0.01))]
    wrong: list[Factor] = []
    for k in range(1, poses):
        z = SE2.between(T[k - 1 : k], T[k : k + 1])[0] + rng.normal(0, [0.05, 0.05, 0.01])
        given.append(Between(x[k - 1], x[k], z, Diagonal(x=0.05, y=0.05, yaw=0.01)))
        away = L - T[k, :2]
        for j in np.flatnonzero(np.hypot(*away.T) < 6).tolist():
            bearing = np.arctan2(away[j, 1], away[j, 0]) - T[k, 2] + rng.normal(0, 0.02)
            distance, name = np.hypot(*away[j]) + rng.normal(0, 0.1), j
            if rng.random() < share:
                name = int(rng.integers(15))
            seen = BearingRange(x[k], l[name], [wrap(bearing), distance], Diagonal(bearing=0.02, range=0.1))
            given.append(seen)
            wrong += [seen] if name != j else []
    return given, wrong, Values({x: (SE2, T[:1]), l: (R(2), np.zeros((0, 2)))})


@pytest.mark.parametrize(("seed", "share", "poses"), [(1, 0.0, 80), (2, 0.05, 25), (5, 0.05, 30)])
def test_no_right_measurement_is_lost_near_a_landmark_or_beside_wrong_names(
    seed: int, share: float, poses: int
) -> None:
    given, wrong, start = circling(seed, share, poses)
    smoother = Incremental(1e-4)
    for factor in given:
        smoother.update(factor, start)
    assert len(smoother.graph) + len(smoother.pending) == len(given)
    assert bool(wrong) is bool(share)
    smoother.remove(wrong)
    graph = FactorGraph([f for f in given if not any(f is other for other in wrong)])
    best = graph.optimize(nls.initialize(graph, smoother.values)[0])
    assert best.fit is not nls.Fit.IMPLAUSIBLE
    assert smoother.chi2 - best.chi2_final <= smoother.tol * smoother.chi2
    assert smoother.gap <= smoother.tol * smoother.chi2


def far(X: Array) -> Array:
    """A number, from a sensor that ends at 2 m."""
    if X[:, 0].max() > 2:
        raise RuntimeError("beyond the end")
    return np.asarray(X[:, :1])


def line() -> Incremental:
    """A point by an own factor, and ten others; the last one by a robust kernel."""
    smoother = Incremental(1e-9)
    own = Factor.from_function(far, l[0], dim=1, noise=STEP)
    known = Values({l: (R(2), [[0.1, 0.1]])})
    smoother.update([Prior(l[0], [0.0, 0.0], STEP), own], known)
    smoother.update([Between(l[k], l[k + 1], [1.0, 0.1], STEP) for k in range(9)])
    smoother.update(Between(l[0], l[9], [9.5, 0.1], STEP).robust(Huber(1.0)))
    return smoother


@pytest.mark.parametrize(
    ("came", "error", "advice"),
    [
        (Between(l[0], l[9], [1e308, 0.0], STEP), EvaluationError, r"leave out Between\(l0, l9\), which came"),
        (Prior(l[0], [9.0, 0.0], Isotropic(1e-4)), EvaluationError, r"smoother.remove\(factor\) of far"),
        (Between(l[3], l[4], [1.0, 0, 0], STEP), GraphError, r"leave out Between\(l3, l4\)"),
        (Between(l[3], l[4], [1.0, 0], Isotropic(1e-320)), NoiseModelError, r"leave out Between\(l3, l4\)"),
    ],
    ids=["no number", "an own function fails", "size", "noise"],
)
def test_what_fails_is_named_and_all_goes_on_as_if_it_had_not_come(
    came: Factor, error: type[Exception], advice: str
) -> None:
    smoother, twin = line(), line()
    right = [Between(l[2], l[5], [3.1, 0.2], STEP), Between(l[9], l[10], [1.0, 0.0], STEP)]
    with pytest.raises(error, match=advice):
        smoother.update([right[0], came])
    for one in (smoother, twin):
        one.update(right[0])
        one.update(right[1])
    exactly = "far" not in advice  # only then have rows come into the preconditioner
    np.testing.assert_allclose(smoother.values[l], twin.values[l], rtol=0, atol=0 if exactly else 1e-5)
    assert (len(smoother.graph), smoother.pending, smoother.waiting) == (len(twin.graph), (), ())
    is_optimal(smoother)


def test_a_window_is_as_before_after_a_refused_update() -> None:
    smoothers = [Incremental(lag=3), Incremental(lag=3)]
    for one in smoothers:
        one.update(Prior(x[0], [0, 0, 0], STEP), Values({x: (SE2, [[0, 0, 0]])}))
        one.update([Between(x[k], x[k + 1], [1, 0, 0.1], STEP) for k in range(2)])
    with pytest.raises(EvaluationError):
        smoothers[0].update([Between(x[2], x[3], [1, 0, 0.1], STEP), Between(x[0], x[2], [1e308, 0, 0], STEP)])
    for one in smoothers:
        for k in range(2, 8):
            one.update(Between(x[k], x[k + 1], [1, 0.1, 0.1], STEP))
        one.update(Between(x[0], x[8], [1, 0.1, 0.1], STEP))
    np.testing.assert_array_equal(*(one.values[x] for one in smoothers))
    assert [len(one.behind) for one in smoothers] == [1, 1]
    assert [one.left.stack("x").numbers.tolist() for one in smoothers] == [[0, 1, 2, 3, 4, 5]] * 2


def test_a_function_that_fails_for_good_leaves_nothing_behind() -> None:
    is_lost = False

    def level(X: Array) -> Array:
        if is_lost:
            raise OSError("the sensor is gone")
        return X[:, :1] - 1

    smoother = Incremental()
    steps = [Between(x[k], x[k + 1], [1, 0, 0.1], STEP) for k in range(3)]
    given = [Prior(x[0], [0, 0, 0], STEP), Factor.from_function(level, x[0], dim=1), *steps[:2]]
    last = [steps[2], Between(x[8], x[9], [1, 0, 0], STEP), Prior(x[0], [1, 2, 0.4], STEP)]
    smoother.update(given, Values({x: (SE2, [[0, 0, 0]])}))
    before, is_lost = (smoother.gap, smoother.pending, smoother.given), True
    with pytest.raises(EvaluationError, match="the sensor is gone"):
        smoother.update(last)
    assert (smoother.gap, smoother.pending, smoother.given) == before


def test_an_update_whose_decision_fails_takes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def undecided(*_: object, **__: object) -> None:
        raise GraphError("cannot decide")

    smoother = Incremental(decide_every=2)
    smoother.update([Between(x[k], x[k + 1], [1.0, 0, 0], STEP) for k in range(3)], Values({x: (SE2, [[0, 0, 0]])}))
    loops = Between(x[[0, 1]], x[[2, 3]], [[2.0, 0, 0]] * 2, STEP)
    with monkeypatch.context() as patch:
        patch.setattr("nls.incremental.membership.gnc", undecided)
        for _ in range(2):
            with pytest.raises(GraphError, match="cannot decide"):
                smoother.update(loops)
    assert len(smoother.graph) == 3
    smoother.update(loops)
    assert len(smoother.graph) == 5


# ---- loop closures judged anew


(d,) = kinds("d")


@pytest.fixture(scope="module")
def spoiled() -> tuple[FactorGraph, sim.World]:
    """Three laps of 50 poses, and twenty wrong closures among the right ones."""
    world = sim.ring(np.random.default_rng(3), laps=3, per_lap=50)
    rng = np.random.default_rng(1)
    i, j = rng.integers(0, 60, 20), rng.integers(70, 150, 20)
    wrong = Between(x[i], x[j], rng.normal(size=(20, 3)) * [5.0, 5.0, 1.0], Diagonal(x=0.05, y=0.05, yaw=0.01))
    return FactorGraph([*world.graph.factors, wrong]), world


def test_wrong_closures_are_out_in_the_end_and_the_map_is_that_of_the_right_ones(
    spoiled: tuple[FactorGraph, sim.World],
) -> None:
    graph, world = spoiled
    smoother = grown(graph.factors, world.truth, Incremental(1e-6, decide_every=15))
    assert len(graph) == len(smoother.graph) + sum(map(len, smoother.rejected))
    decided = smoother.decide()
    wrong = {graph.factors[-1].describe(k) for k in range(20)}
    out = {f.describe(k) for f in smoother.rejected for k in range(len(f))}
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
    smoother = grown(world.graph.factors, world.truth, Incremental(1e-6))
    before, n, judge = smoother.values, len(smoother.graph), nls.incremental.membership.gnc

    def wary(graph: FactorGraph, values: Values, doubted: Sequence[Factor] | None) -> nls.Robustified:
        found = judge(graph, values, doubted=doubted)
        loops = [np.abs(f.keys[0].numbers - f.keys[1].numbers) == 1 for f in graph.factors]
        object.__setattr__(found, "weights", [mask.astype(float) for mask in loops])
        return found

    with monkeypatch.context() as patch:
        patch.setattr("nls.incremental.membership.gnc", wary)
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
    first = [Prior(x[0], truth[0], noise), Prior(d[0], [0.0, 0.0], Isotropic(0.5))]
    smoother.update([*first, *reckoned], Values({x: (SE2, truth[:1]), d: (R(2), np.zeros((1, 2)))}))
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
    best = FactorGraph([*first, reckoned, right]).optimize(smoother.values).values
    np.testing.assert_allclose(smoother[x[np.arange(41)]], best[x], atol=1e-3)


def test_a_closure_that_is_not_believed_can_be_removed(spoiled: tuple[FactorGraph, sim.World]) -> None:
    graph, world = spoiled
    smoother = grown(world.graph.factors, world.truth)
    wrong = graph.factors[-1][:5]
    smoother.update(wrong)
    smoother.decide()
    assert sum(map(len, smoother.rejected)) >= 5
    smoother.remove(wrong)
    assert not any(set(f.keys[0].numbers) & set(wrong.keys[0].numbers) for f in smoother.rejected)
    with pytest.raises(GraphError, match="is not in the estimate"):
        smoother.remove(wrong)


def test_what_cannot_be_decided_is_refused() -> None:
    smoother = Incremental()
    smoother.update(Between(x[0], x[1], [1.0, 0, 0], Diagonal(x=1, y=1, yaw=1)), Values({x: (SE2, np.zeros((1, 3)))}))
    with pytest.raises(GraphError, match="no loop closures"):
        smoother.decide()
