"""Fixed-lag and online smoothing: exactly the batch solution wherever they should be."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

import sim
from factors import BearingRange, Between, Diagonal, Factor, Information, Isotropic, Prior, Range
from models import SE2, R
from models.errors import GraphError, GraphWarning, OptionError, UnderconstrainedError
from nls import FactorGraph, GaussNewton, Marginals, Stop, Values, kinds
from nls.filters.base import Filter
from nls.filters.fixed_lag import FixedLag
from nls.filters.marginal import MarginalPrior, marginalized
from nls.filters.online import Online
from tests.combinations import for_all
from tests.sim.scenes import thinned

Array = npt.NDArray[np.float64]
close = np.testing.assert_allclose
x, l = kinds("x", "l")
STEPS, SEEN = 9, [(0, 0), (0, 1), (1, 0), (2, 1), (3, 2), (4, 2), (5, 2), (5, 3), (6, 3), (8, 3)]


def linear(seed: int = 0) -> tuple[FactorGraph, Values]:
    """Points that walk and see points, everything a difference with full covariances: a linear problem."""
    rng = np.random.default_rng(seed)

    def informations(n: int) -> Array:
        L = np.tril(rng.uniform(-0.3, 0.3, (n, 2, 2))) + np.eye(2) * rng.uniform(0.2, 1.0, (n, 1, 1))
        return np.linalg.inv(L @ L.mT)

    i, k = np.array(SEEN).T
    at = np.arange(STEPS)
    graph = FactorGraph(
        [
            Prior(x[0], rng.normal(size=2), Information(informations(1))),
            Between(x[at[:-1]], x[at[1:]], rng.normal(size=(STEPS - 1, 2)), Information(informations(STEPS - 1))),
            Between(x[i], l[k], rng.normal(size=(len(i), 2)), Information(informations(len(i)))),
        ]
    )
    return graph, Values({x: (R(2), np.zeros((STEPS, 2))), l: (R(2), np.zeros((4, 2)))})


def until(graph: FactorGraph, values: Values, last: int) -> tuple[Array, Array]:
    """The pose `last` and its covariance from everything measured up to it, solved at once."""
    factors = []
    for factor in graph.factors:
        latest = np.max([k.numbers for k in factor.keys if k.kind == "x"], axis=0)
        if (latest <= last).any():
            factors.append(factor[latest <= last])
    known = [k.numbers for f in factors for k in f.keys if k.kind == "l"]
    numbers = np.unique(np.concatenate(known)) if known else np.zeros(0, dtype=int)
    part = Values({x: (values.stack("x").manifold, values[x][: last + 1])})
    part.add(l, values.stack("l").manifold, values[l[numbers]].reshape(len(numbers), -1), numbers)
    so_far = FactorGraph(factors)
    best = so_far.optimize(part, gauge="none").values
    return best[x[last]], Marginals(so_far, best, gauge="none").covariance(x[last], frame="body")


def straight(n: int, *more: Factor) -> FactorGraph:
    """n poses, 1 m from one to the next."""
    steps = Between(x[0 : n - 1], x[1:n], [[1.0, 0, 0]] * (n - 1), Isotropic(0.1))
    return FactorGraph([Prior(x[0], [0, 0, 0], Isotropic(0.1)), steps, *more])


EVERY: dict[str, Filter] = {
    "online": Online(),
    "lag 1, all stay": FixedLag(1, "stay", GaussNewton()),
    "lag 4, all stay": FixedLag(4, "stay", GaussNewton()),
    "lag 3": FixedLag(3, optimizer=GaussNewton()),
    "lag of all": FixedLag(STEPS),
}


def test_on_a_linear_problem_every_step_is_the_batch_solution() -> None:
    graph, values = linear()
    expected = [until(graph, values, last) for last in range(STEPS)]
    for name, estimator in EVERY.items():
        track = estimator.run(graph, values)
        for last, (X, P) in enumerate(expected):
            close(track.X[last], X, atol=1e-9, err_msg=name)
            close(track.P[last], P, rtol=1e-8, atol=1e-12, err_msg=name)


def test_a_landmark_that_returns_after_it_left_is_a_new_one() -> None:
    graph, values = linear()
    short, whole = FixedLag(1).run(graph, values), until(graph, values, STEPS - 1)
    assert (
        np.abs(short.X[-1] - whole[0]).max() > 1e-3
    )  # l3 is seen from x6 and from x8, and between them from no pose of the window
    assert np.linalg.eigvalsh(short.P[-1] - whole[1]).min() > 0  # it says that it knows less


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


@pytest.fixture(scope="module")
def loop() -> tuple[FactorGraph, Values]:
    world = thinned(sim.subsea(np.random.default_rng(4), laps=1, known_start=True))
    return world.graph, world.start


def test_all_of_a_path_is_the_batch_solution(loop: tuple[FactorGraph, Values]) -> None:
    """Online each pose is that of what was measured so far."""
    graph, start = loop
    best = graph.optimize(start, gauge="none").values
    marginals = Marginals(graph, best, gauge="none")
    each, whole, rarely = Online(), FixedLag(1000), Online(every=7)
    for estimator in (each, whole, rarely):
        track = estimator.run(graph, start)
        close(track.values[x], best[x], atol=1e-5)
        close(track.values[track.landmarks], best[track.landmarks], atol=1e-5)
        close(track.P_landmarks, marginals.covariance(track.landmarks), rtol=1e-4, atol=1e-9)
        assert np.mean(estimator.iterations) < 4
        for last in (1, 7, 20) if estimator is each else ():
            X, P = until(graph, start, last)
            close(track.X[last], X, atol=1e-5)
            close(track.P[last], P, rtol=1e-3, atol=1e-12)


def test_between_solves_a_pose_follows_the_motion() -> None:
    step = Between(x[[0, 1, 2]], x[[1, 2, 3]], [[1.0, 0.2, 0.3]] * 3, Diagonal([0.1, 0.2, 0.03]))
    graph = FactorGraph([Prior(x[0], [0, 0, 0.5], Diagonal([0.3, 0.2, 0.1])), step])
    values = Values({x: (SE2, SE2.identity(4))})
    each, rarely = Online().run(graph, values), Online(every=3).run(graph, values)
    close(rarely.X, each.X, atol=1e-9)
    close(rarely.P, each.P, rtol=1e-9)


def test_a_window_stays_small_and_closes_loops_only_with_landmarks_that_stay(loop: tuple[FactorGraph, Values]) -> None:
    graph, start = loop
    best = graph.optimize(start).values
    apart, sigma = {}, {}
    for how in ("stay", "leave"):
        lag = FixedLag(5, how, GaussNewton())  # type: ignore[arg-type]
        track = lag.run(graph, start)
        assert len(lag.values.stack("x")) == 5
        assert [f.name for f in lag.graph.factors].count("MarginalPrior") == 1
        assert len(lag.values.stack("l")) == 6 if how == "stay" else len(lag.values.stack("l")) < 5
        assert len(track.landmarks) == len(track.P_landmarks) == 6
        assert len(track.values.stack("x")) == 31
        apart[how] = float(np.linalg.norm(track.X[-1, :2] - best[x[30]][:2]))
        sigma[how] = float(np.sqrt(track.P[-1].trace()))
    assert apart["stay"] < 0.005 < 0.02 < apart["leave"], apart
    assert sigma["leave"] > 3 * sigma["stay"], sigma


def test_a_measurement_to_a_pose_that_left_names_both() -> None:
    graph = straight(6, Between(x[[1]], x[[5]], [[4.0, 0, 0]], Isotropic(0.1)))
    values = Values({x: (SE2, SE2.identity(6))})
    with pytest.raises(GraphError, match=r"Between\(x1, x5\) .* latest 3 poses before x5"):
        FixedLag(3).run(graph, values)
    close(FixedLag(5).run(graph, values).X[-1], Online().run(graph, values).X[-1], atol=1e-9)


def test_a_landmark_that_is_not_determined_cannot_leave() -> None:
    graph = straight(3, Range(x[0], l[7], [5.0], Isotropic(0.1)))
    values = Values({x: (SE2, SE2.identity(3)), l: (R(2), [[3.0, 4.0]], [7])})
    with pytest.raises(UnderconstrainedError, match="l7"):
        Online().run(graph, values)
    with pytest.raises(UnderconstrainedError, match=r"l7 cannot leave the window.*Prior"):
        marginalized(graph.factors, values, [l[7]])


def test_several_sightings_of_new_and_known_landmarks_in_a_step() -> None:
    rng = np.random.default_rng(0)
    graph, values = linear()
    i, k = np.array(SEEN).T
    more = [
        Between(x[i], l[k], rng.normal(size=(len(i), 2)), Isotropic(0.5)),
        Prior(l[[2, 3]], [[1.0, 2.0]], Isotropic(2.0)),
    ]
    twice = FactorGraph([*graph.factors, *more])
    best = twice.optimize(values).values
    for estimator in (Online(), FixedLag(2, "stay", GaussNewton())):
        track = estimator.run(twice, values)
        close(track.X[-1], best[x[STEPS - 1]], atol=1e-9)
        close(track.values[l[[0, 1, 2, 3]]], best[l[[0, 1, 2, 3]]], atol=1e-9)


def test_options_are_refused_by_name() -> None:
    for make, said in (
        (lambda: FixedLag(0), "lag"),
        (lambda: FixedLag(2.0), "lag"),  # type: ignore[arg-type]
        (lambda: FixedLag(2, "go"), "landmarks"),  # type: ignore[arg-type]
        (lambda: Online(every=0), "every"),
    ):
        with pytest.raises(OptionError, match=said):
            make()


def test_a_solve_that_does_not_converge_is_said() -> None:
    world = sim.subsea(np.random.default_rng(0), laps=1)
    poses = x[[0, 1]]
    part = FactorGraph(
        [world.first, world.odometry[[0]], world.sightings[np.isin(world.sightings.keys[0].numbers, [0, 1])]]
    )
    values = Values({x: (SE2, world.start[poses]), l: (R(2), world.start[l])})
    hasty = Online(optimizer=GaussNewton(Stop(max_iterations=1)))
    with pytest.warns(GraphWarning, match=r"online at x[01]: the iteration limit"):
        hasty.run(part, values)


def test_no_landmarks_at_all() -> None:
    for estimator in (Online(), FixedLag(1)):
        track = estimator.run(straight(2), Values({x: (SE2, SE2.identity(2))}))
        close(track.X[1], [1, 0, 0], atol=1e-9)
        assert len(track.landmarks) == 0


def test_a_landmark_keeps_its_place_when_only_other_factors_locate_it() -> None:
    """At (2, 1) and not at -50, 80."""
    seen = BearingRange(x[[0, 1]], l[4], [[np.arctan(0.5), 5**0.5], [np.pi / 4, 2**0.5]], Isotropic(0.1))
    values = Values({x: (SE2, SE2.identity(2)), l: (R(2), [[-50.0, 80.0]], [4])})
    close(Online().run(straight(2, seen), values).values[l[4]], [2.0, 1.0], atol=0.01)
