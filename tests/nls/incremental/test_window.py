"""A lag: what leaves, what stays, what comes too late."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import nls
import sim
from factors import Between, BetweenSensors, Factor, Huber, Isotropic, Landmark, Position, Prior, Range
from models import SE2, R
from models.errors import GraphError, OptionError
from nls import Incremental, Values, kinds
from nls.incremental.marginal import MarginalPrior
from nls.incremental.steps import steps

x, l, s = kinds("x", "l", "s")
STEP = Isotropic(0.1)
ORIGIN = Values({x: (SE2, [[0.0, 0.0, 0.0]])})


def walk(smoother: Incremental, begin: int, end: int) -> None:
    """Steps of 1 m."""
    for k in range(begin, end):
        smoother.update(Between(x[k], x[k + 1], [1.0, 0.0, 0.0], STEP), ORIGIN if k == 0 else None)


def kept(smoother: Incremental, kind: str = "x") -> list[int]:
    return sorted(smoother.values.stack(kind).numbers.tolist())


@pytest.mark.parametrize("kernel", [None, Huber(1.345)], ids=["squares", "huber"])
@pytest.mark.parametrize("known", [True, False], ids=["prior", "gauge"])
def test_within_the_window_closures_count_as_in_the_batch(known: bool, kernel: Huber | None) -> None:
    world = sim.ring(np.random.default_rng(1), laps=1, per_lap=40)
    odometry = world.graph.factors[0]
    rng, n = np.random.default_rng(2), np.arange(0, 34)
    near = SE2.compose(SE2.between(world.truth[x[n]], world.truth[x[n + 5]]), SE2.exp(rng.normal(0, 0.05, (34, 3))))
    closures = Between(x[n], x[n + 5], near, Isotropic(0.05))
    prior = [Prior(x[0], world.truth[x[0]], Isotropic(0.01))] if known else []
    graph = nls.FactorGraph([*prior, odometry, closures if kernel is None else closures.robust(kernel)])
    short, long = Incremental(1e-9, lag=8), Incremental(1e-9)
    for step in steps(graph.factors):
        for smoother in (short, long):
            smoother.update(step.factors, Values({x: (SE2, world.truth[x[:1]])}))
    assert kept(short) == [*range(32, 40)]
    assert not short.behind
    sigma = np.sqrt(np.diagonal(long.covariance(x[39], frame="body")))
    off = SE2.local(long[x[39]][None], short[x[39]][None])[0]
    assert (np.abs(off) < 0.1 * sigma).all(), off / sigma
    if known:
        np.testing.assert_allclose(
            short.covariance(x[39], frame="body"), long.covariance(x[39], frame="body"), rtol=0.1, atol=1e-4
        )
    left = short.left[x[:32]]
    assert np.abs(SE2.local(long[x[:32]], left)[:, :2]).max() < 1


def test_a_closure_behind_the_window_is_listed_and_changes_nothing() -> None:
    smoother = Incremental(lag=3)
    walk(smoother, 0, 8)
    before = smoother.values
    late, near = Between(x[2], x[8], [5.0, 1.0, 0.0], STEP), Between(x[7], x[8], [1.0, 0.0, 0.0], STEP)
    smoother.update([Between(x[[1, 6]], x[[8, 8]], [[7.0, 0, 0], [2.0, 0, 0]], STEP), late, near, near[[]]])
    assert [repr(factor) for factor in smoother.behind] == ["Between(x1, x8)", "Between(x2, x8)"]
    np.testing.assert_allclose(smoother.values[x[6:9]], before[x[6:9]], atol=1e-9)
    with pytest.raises(GraphError, match="is not in the estimate"):
        smoother.remove(late)
    smoother.remove(near)
    np.testing.assert_allclose(smoother[x[8]], [8, 0, 0], atol=1e-9)


def test_a_landmark_leaves_with_the_last_pose_that_measured_it_and_comes_back_as_a_new_one() -> None:
    seen = {0: 7, 1: 7, 2: 8, 6: 7}
    for how, there in (("leave", {4: [8], 5: [], 7: [7]}), ("stay", {4: [7, 8], 5: [7, 8], 7: [7, 8]})):
        smoother = Incremental(lag=3, landmarks=how)  # type: ignore[arg-type]
        for k in range(8):
            walk(smoother, k, k + 1)
            if k in seen:
                smoother.update(Landmark(x[k], l[seen[k]], [3.0 - k, 1.0], STEP))
            if k + 1 in there:
                assert kept(smoother, "l") == there[k + 1], (how, k)
        assert [factor.name for factor in smoother.graph.factors].count("MarginalPrior") <= 1
        if how == "leave":
            np.testing.assert_allclose(smoother.left[l[8]], [3.0, 1.0], atol=1e-9)
            np.testing.assert_allclose(smoother[l[7]], [3.0, 1.0], atol=1e-6)


def test_what_waits_for_a_pose_that_leaves_is_behind() -> None:
    smoother = Incremental(lag=3)
    walk(smoother, 0, 1)
    smoother.update(Range(x[0], l[5], 4.0, STEP), Values({l: (R(2), np.zeros((0, 2)))}))
    assert [repr(key) for key in smoother.waiting] == ["l5"]
    walk(smoother, 1, 6)
    assert not smoother.waiting
    assert [repr(factor) for factor in smoother.behind] == ["Range(x0, l5)"]


def test_the_place_of_a_sensor_stays() -> None:
    rng, smoother = np.random.default_rng(0), Incremental(1e-9, lag=4)
    mount, turn = np.array([0.5, 0.2, 0.3]), np.array([1.0, 0.0, 0.4])
    smoother.update(
        [Prior(x[0], [0.0, 0, 0], Isotropic(0.01)), Prior(s[0], [0.4, 0.3, 0.2], STEP)],
        Values({x: (SE2, [[0.0, 0, 0]]), s: (SE2, [[0.4, 0.3, 0.2]])}),
    )
    for k in range(30):
        u = SE2.compose(turn, [0, 0, 0.3 * np.sin(k)])
        seen = SE2.compose(SE2.compose(SE2.inverse(mount), u), mount)
        z = SE2.compose(seen, SE2.exp(rng.normal(0, 0.001, 3)))
        seen_from = BetweenSensors(x[k], x[k + 1], z, Isotropic(0.001), s[0])
        smoother.update([Between(x[k], x[k + 1], u, Isotropic(0.001)), seen_from])
    assert kept(smoother) == [27, 28, 29, 30]
    assert kept(smoother, "s") == [0]
    np.testing.assert_allclose(smoother[s[0]], mount, atol=0.005)


def test_what_a_function_measures_leaves_as_a_whole() -> None:
    def climb(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        assert len(a) == 2  # it knows both its measurements, and not one of them
        return (b - a)[:, 1:2] - [[0.3], [0.5]]

    smoother = Incremental(1e-9, lag=4)
    walk(smoother, 0, 3)
    smoother.update(Factor.from_function(climb, [x[[0, 2]], x[[1, 3]]], 1, Isotropic(0.1), relative=True))
    before, full = smoother[x[3]], smoother.chi2
    assert [factor.name for factor in smoother.graph.factors].count("climb") == 1
    walk(smoother, 3, 4)  # x0 leaves, and the rows of x2 and x3 with it
    assert [factor.name for factor in smoother.graph.factors if factor.opaque] == []
    np.testing.assert_allclose(smoother[x[3]], before, atol=1e-6)
    assert full > smoother.chi2


def test_it_pickles_within_its_window_and_takes_positions() -> None:
    smoother = Incremental(1e-9, lag=5)
    walk(smoother, 0, 10)
    again = pickle.loads(pickle.dumps(smoother))
    for one in (smoother, again):
        walk(one, 10, 15)
        one.update(Position(x[12], [12.0, 0.3], Isotropic(0.01)))
        one.update(Position(x[15], [15.0, 0.5], Isotropic(0.01)))
    np.testing.assert_allclose(again[x[11:16]], smoother[x[11:16]], atol=1e-6)
    assert smoother[x[15]][1] > 0.4
    assert sum(isinstance(factor, MarginalPrior) for factor in again.graph.factors) <= 1


@pytest.mark.parametrize(
    ("options", "said"),
    [({"lag": 0}, "lag"), ({"lag": 2.0}, "lag"), ({"landmarks": "go"}, "landmarks"), ({"tol": -1}, "tol")],
)
def test_options_are_refused_by_name(options: dict[str, object], said: str) -> None:
    with pytest.raises(OptionError, match=said):
        Incremental(**options)  # type: ignore[arg-type]
