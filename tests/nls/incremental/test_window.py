"""A lag: what leaves, what stays, what comes too late; and what is known of the rest stays known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import factors as f
import nls
import sim
from factors import ZPR, Between, Diagonal, Factor, Huber, Information, Isotropic, Landmark, Line, Prior, Range
from factors.keys import Kind
from models import LINE, SE2, SE3, LieGroup, Manifold, R, euler, wrap
from models.algebra import Array
from models.errors import GraphError, UnderconstrainedError
from models.sensors import line_from_frame
from nls import FactorGraph, GaussNewton, Incremental, Marginals, Values, kinds
from nls.incremental.marginal import MarginalPrior, marginalized
from nls.incremental.steps import steps
from tests.combinations import for_all
from tests.nls.incremental.test_incremental import STEP, grown

x, l, s, o = kinds("x", "l", "s", "o")
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
    short, long = (grown(graph.factors, world.truth, Incremental(1e-9, lag=lag)) for lag in (8, None))
    assert kept(short) == [*range(32, 40)]
    assert not short.behind
    sigma = np.sqrt(np.diagonal(long.covariance(x[39], frame="body")))
    off = SE2.local(long[x[39]][None], short[x[39]][None])[0]
    assert (np.abs(off) < 0.1 * sigma).all(), off / sigma
    if known:
        covariances = (smoother.covariance(x[39], frame="body") for smoother in (short, long))
        np.testing.assert_allclose(*covariances, rtol=0.1, atol=1e-4)
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
        seen_from = f.BetweenSensors(x[k], x[k + 1], z, Isotropic(0.001), s[0])
        smoother.update([Between(x[k], x[k + 1], u, Isotropic(0.001)), seen_from])
    assert (kept(smoother), kept(smoother, "s")) == ([27, 28, 29, 30], [0])
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


def around(x: Kind, l: Kind, seed: int, turn: float, n: int = 40) -> tuple[list[Factor], Values]:
    """A vehicle that stands or circles among landmarks, its first heading known to 0.1 rad; and where it was."""
    rng, k = np.random.default_rng(seed), np.arange(n)
    step, noise = np.array([5 * turn, 0.0, turn]), np.array([0.05, 0.05, 0.01])
    X, p = [np.array([-3.0, 0.0, 0.3])], rng.uniform(-12, 12, (8, 2))
    for _ in k:
        X.append(SE2.compose(X[-1], step))
    truth = np.array(X)
    i, j = np.repeat(np.arange(n + 1), 8), np.tile(np.arange(8), n + 1)
    d = p[j] - truth[i, :2]
    seen = np.column_stack([np.arctan2(d[:, 1], d[:, 0]) - truth[i, 2], np.hypot(*d.T)])
    seen += rng.normal(0, [0.01, 0.1], seen.shape)
    first = SE2.retract(truth[:1], rng.normal(0, [0.01, 0.01, 0.1], (1, 3)))
    factors = [
        Prior(x[0], first, Diagonal([0.01, 0.01, 0.1])),
        Between(x[k], x[k + 1], SE2.retract(step, rng.normal(0, noise, (n, 3))), Diagonal(noise)),
        f.BearingRange(x[i], l[j], np.column_stack([wrap(seen[:, 0]), seen[:, 1]]), Diagonal([0.01, 0.1])),
    ]
    return factors, Values({x: (SE2, truth), l: (R(2), p)})


@pytest.mark.parametrize("lag", [1, 5])
@pytest.mark.parametrize("turn", [0.0, 0.2], ids=["standing", "circling"])
def test_bearings_and_ranges_never_sharpen_the_heading(turn: float, lag: int) -> None:
    factors, truth = around(x, l, 0, turn)
    best = FactorGraph(factors).optimize(truth).values
    sigma = Marginals(FactorGraph(factors), best).covariance(x[40], frame="body")[2, 2] ** 0.5
    smoother = grown(factors, truth, Incremental(1e-6, lag=lag))
    assert abs(smoother[x[40]][2] - best[x[40]][2]) < 0.01
    assert smoother.covariance(x[40], frame="body")[2, 2] ** 0.5 == pytest.approx(sigma, rel=0.02)
    assert sigma > 0.099


def test_the_gap_of_a_window_bounds_how_far_chi2_is_above_its_minimum() -> None:
    for seed in range(2):
        factors, truth = around(x, l, seed, 0.0)
        smoother, first = Incremental(lag=5), Values({x: (SE2, truth[x[:1]])})
        for step in steps(factors):
            smoother.update(step.factors, first)
            best = smoother.graph.optimize(smoother.values).chi2_final
            assert smoother.chi2 - best <= smoother.gap + 1e-9, (seed, step.pose)
        assert smoother.batch_solutions == 0


def test_two_vehicles_that_nothing_joins_keep_their_headings() -> None:
    y, m = kinds("y", "m")
    one, other = around(x, l, 0, 0.2), around(y, m, 1, 0.2)
    smoother = Incremental(1e-6, lag=5)
    start = Values({x: (SE2, one[1][x[:1]]), y: (SE2, other[1][y[:1]])})
    for a, b in zip(steps(one[0]), steps(other[0], kind="y"), strict=True):
        smoother.update([*a.factors, *b.factors], start)
    assert sum(isinstance(factor, MarginalPrior) for factor in smoother.graph.factors) == 2
    for key in (x[40], y[40]):
        assert smoother.covariance(key, frame="body")[2, 2] ** 0.5 > 0.0995


@pytest.mark.parametrize("lag", [1, 5])
def test_depth_and_tilt_never_sharpen_the_heading(lag: int) -> None:
    """Steps, depth and tilt of a vehicle that rolls and pitches: the sigma of its heading is that of the batch."""
    rng, n = np.random.default_rng(3), 60
    a, noise = np.arange(n + 1) * 0.1, np.array([0.03, 0.03, 0.03, 0.003, 0.003, 0.003])
    sin, cos = np.sin, np.cos
    state = np.column_stack([0.1 * sin(3 * a), 0.1 * sin(2 * a), a, 8 * sin(a), -8 * cos(a), 0.5 * sin(a)])
    truth, k = euler.to_se3(state), np.arange(n)
    moved = SE3.retract(SE3.between(truth[:-1], truth[1:]), rng.normal(0, noise, (n, 6)))
    tilt = state[:, [5, 1, 0]] + rng.normal(0, [0.02, 0.005, 0.005], (n + 1, 3))
    factors = [
        Prior(x[0], truth[:1], Diagonal([0.01, 0.01, 0.01, 0.005, 0.005, 0.1])),
        Between(x[k], x[k + 1], moved, Diagonal(noise)),
        ZPR(x[np.arange(n + 1)], tilt, Diagonal(depth=0.02, pitch=0.005, roll=0.005)),
    ]
    graph, known = FactorGraph(factors), Values({x: (SE3, truth)})
    best, smoother = graph.optimize(known).values, grown(factors, known, Incremental(1e-6, lag=lag))
    one, all_ = (s.covariance(x[n], frame="world")[5, 5] ** 0.5 for s in (smoother, Marginals(graph, best)))
    assert one == pytest.approx(all_, rel=0.002)
    assert euler.from_se3(smoother[x[n]])[2] == pytest.approx(euler.from_se3(best[x[n]])[2], abs=0.002)


# ---- marginalizing


close = np.testing.assert_allclose
STEPS, SEEN = 9, [(0, 0), (0, 1), (1, 0), (2, 1), (3, 2), (4, 2), (5, 2), (5, 3), (6, 3), (8, 3)]


def linear(seed: int = 0) -> tuple[FactorGraph, Values]:
    """Points that walk and see points, everything a difference with full covariances: a linear problem."""
    rng = np.random.default_rng(seed)

    def informations(n: int) -> Array:
        L = np.tril(rng.uniform(-0.3, 0.3, (n, 2, 2))) + np.eye(2) * rng.uniform(0.2, 1.0, (n, 1, 1))
        return np.linalg.inv(L @ L.mT)

    i, k = np.array(SEEN).T
    at = np.arange(STEPS)
    first = Prior(x[0], rng.normal(size=2), Information(informations(1)))
    walk = Between(x[at[:-1]], x[at[1:]], rng.normal(size=(STEPS - 1, 2)), Information(informations(STEPS - 1)))
    seen = Between(x[i], l[k], rng.normal(size=(len(i), 2)), Information(informations(len(i))))
    return FactorGraph([first, walk, seen]), Values({x: (R(2), np.zeros((STEPS, 2))), l: (R(2), np.zeros((4, 2)))})


def test_marginalizing_keeps_estimate_and_covariance_of_the_rest() -> None:
    graph, values = linear(3)
    best = graph.optimize(values, gauge="none").values
    leaving = [x[[0, 2, 4]], l[[1]]]
    left, rest = marginalized(graph.factors, values, leaving)
    assert isinstance(left[-1], MarginalPrior)
    assert not any(key in keys for gone in leaving for key in gone for f in left for keys in map(set, f.keys))
    kept = x[[1, 3, 5, 6, 7, 8]]
    reduced = FactorGraph(left)
    again = reduced.optimize(rest, GaussNewton(), gauge="none").values
    close(again[kept], best[kept], atol=1e-9)
    whole, part = Marginals(graph, best, gauge="none"), Marginals(reduced, again, gauge="none")
    close(part.joint([kept, l[[0, 2, 3]]]).matrix, whole.joint([kept, l[[0, 2, 3]]]).matrix, atol=1e-10)


@for_all(scene=[sim.subsea, sim.lines])
def test_a_prior_left_by_poses_has_the_derivatives_it_says(scene: Callable[..., sim.LandmarkWorld]) -> None:
    generator = np.random.default_rng(5)
    world = scene(np.random.default_rng(2), laps=1)
    factors, _ = marginalized(world.graph.factors, world.start, [x[np.arange(20)]])
    prior = factors[-1]
    assert isinstance(prior, MarginalPrior)
    manifolds = [world.start.stack(k.kind).manifold for k in prior.keys]
    model = prior.bind(*manifolds)
    X = [m.retract(x0[None], generator.normal(0, 0.4, (1, m.dim))) for m, x0 in zip(manifolds, prior.X0, strict=True)]
    A, b = model.linearize(*X)
    assert np.abs(b).max() > 1
    for slot, m in enumerate(manifolds):
        for c in range(m.dim):
            delta = np.zeros((1, m.dim))
            delta[0, c] = 1e-6
            there, back = ([*X[:slot], m.retract(X[slot], s * delta), *X[slot + 1 :]] for s in (1, -1))
            close(-A[slot][0, :, c], (model.error(*there) - model.error(*back))[0] / 2e-6, rtol=1e-5, atol=1e-4)


def seen(space: LieGroup, target: Manifold, seed: int) -> tuple[list[Factor], Values]:
    """Four poses that see three targets through a sensor of unknown place; from their steps and sightings alone."""
    rng, n = np.random.default_rng(seed), np.arange(4)
    X, noise = space.exp(rng.normal(0, 1, (4, space.dim))), Isotropic(0.1)
    L = rng.normal(0, 5, (3, target.dim))
    i, j = np.repeat(n, 3), np.tile(n[:3], 4)
    sort = Line if target is LINE else Landmark
    mount = space.exp(rng.normal(0, 0.3, (1, space.dim)))
    z = sort(x[i], l[j], np.zeros((12, target.dim)), noise, mount).predict((space, target), X[i], L[j])[0]
    z = target.retract(z, rng.normal(0, 0.1, (12, target.dim)))
    moved = space.retract(space.between(X[:-1], X[1:]), rng.normal(0, 0.1, (3, space.dim)))
    factors = [Between(x[n[:-1]], x[n[1:]], moved, noise), sort(x[i], l[j], z, noise, o[0])]
    return factors, FactorGraph(factors).optimize(Values({o: (space, mount), x: (space, X), l: (target, L)})).values


@for_all(spaces=[(SE2, R(2)), (SE2, LINE), (SE3, R(3))])
def test_a_common_motion_costs_a_prior_of_relative_measurements_nothing(spaces: tuple[LieGroup, Manifold]) -> None:
    group, target = spaces
    factors, values = seen(group, target, 1)
    prior = marginalized(factors, values, [x[[0, 1]]])[0][-1]
    assert isinstance(prior, MarginalPrior)
    assert prior.relative
    assert prior.unmoved == (0,)
    rng = np.random.default_rng(0)
    model = prior.bind(*(values.stack(keys.kind).manifold for keys in prior.keys))
    at = [m.retract(x0[None], rng.normal(0, 0.3, (1, m.dim))) for m, x0 in zip(model.manifolds, prior.X0, strict=True)]
    for size in (0.1, 3.0):
        G = group.exp(rng.normal(0, size, (1, group.dim)))
        moved = [at[0], *(moved_by(group, G, m, X) for m, X in zip(model.manifolds[1:], at[1:], strict=True))]
        close(model.error(*moved), model.error(*at), atol=1e-9)
    assert np.abs(model.error(*at)).max() > 1


def moved_by(group: LieGroup, G: Array, space: Manifold, X: Array) -> Array:
    """Elements of a space after a motion of everything."""
    return group.compose(G, X) if space is group else line_from_frame(G, X) if space is LINE else group.act(G, X)


def test_a_landmark_that_is_not_determined_cannot_leave() -> None:
    steps = Between(x[0:2], x[1:3], [[1.0, 0, 0]] * 2, Isotropic(0.1))
    factors = [Prior(x[0], [0, 0, 0], Isotropic(0.1)), steps, Range(x[0], l[7], [5.0], Isotropic(0.1))]
    values = Values({x: (SE2, SE2.identity(3)), l: (R(2), [[3.0, 4.0]], [7])})
    with pytest.raises(UnderconstrainedError, match=r"l7 cannot leave the window.*Prior"):
        marginalized(factors, values, [l[7]])
