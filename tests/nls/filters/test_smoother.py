"""Fixed-lag and online smoothing: exactly the batch solution wherever they should be."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from factors import BearingRange, Between, Isotropic, Prior
from models import SE2, R
from models.algebra import Array
from nls import FactorGraph, Marginals, Values, kinds
from nls.filters import Smoother
from nls.filters.base import Filter
from tests.nls.incremental.test_window import SEEN, STEPS, linear
from tests.sim.scenes import thinned

close = np.testing.assert_allclose
x, l = kinds("x", "l")


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


EVERY: dict[str, Filter] = {
    "online": Smoother(tol=1e-15),
    "lag 1, all stay": Smoother(1, "stay", 1e-15),
    "lag 4, all stay": Smoother(4, "stay", 1e-15),
    "lag 3": Smoother(3, tol=1e-15),
    "lag of all": Smoother(STEPS, tol=1e-15),
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
    short, whole = Smoother(1).run(graph, values), until(graph, values, STEPS - 1)
    # l3 is seen from x6 and from x8, and between them from no pose of the window
    assert np.abs(short.X[-1] - whole[0]).max() > 1e-3
    assert np.linalg.eigvalsh(short.P[-1] - whole[1]).min() > 0  # it says that it knows less


@pytest.fixture(scope="module")
def loop() -> tuple[FactorGraph, Values]:
    world = thinned(sim.subsea(np.random.default_rng(4), laps=1, known_start=True))
    return world.graph, world.start


def test_all_of_a_path_is_the_batch_solution(loop: tuple[FactorGraph, Values]) -> None:
    """Online each pose is that of what was measured so far."""
    graph, start = loop
    best = graph.optimize(start, gauge="none").values
    marginals = Marginals(graph, best, gauge="none")
    each, whole = Smoother(tol=1e-12), Smoother(1000, tol=1e-12)
    for estimator in (each, whole):
        track = estimator.run(graph, start)
        close(track.values[x], best[x], atol=1e-5)
        close(track.values[track.landmarks], best[track.landmarks], atol=1e-5)
        close(track.P_landmarks, marginals.covariance(track.landmarks), rtol=1e-4, atol=1e-9)
        for last in (1, 7, 20) if estimator is each else ():
            X, P = until(graph, start, last)
            close(track.X[last], X, atol=1e-5)
            close(track.P[last], P, rtol=1e-3, atol=1e-12)


def test_a_window_stays_small_and_closes_loops_only_with_landmarks_that_stay(loop: tuple[FactorGraph, Values]) -> None:
    graph, start = loop
    best = graph.optimize(start).values
    apart, sigma = {}, {}
    for how in ("stay", "leave"):
        lag = Smoother(5, how)  # type: ignore[arg-type]
        track = lag.run(graph, start)
        assert len(lag.smoother.values.stack("x")) == 5
        assert [f.name for f in lag.smoother.graph.factors].count("MarginalPrior") == 1
        assert len(lag.smoother.values.stack("l")) == 6 if how == "stay" else len(lag.smoother.values.stack("l")) < 5
        assert len(track.landmarks) == len(track.P_landmarks) == 6
        assert np.isfinite(track.P_landmarks).all() == (how == "stay")
        assert len(track.values.stack("x")) == 31
        apart[how] = float(np.linalg.norm(track.X[-1, :2] - best[x[30]][:2]))
        sigma[how] = float(np.sqrt(track.P[-1].trace()))
    assert apart["stay"] < 0.005 < 0.02 < apart["leave"], apart
    assert sigma["leave"] > 3 * sigma["stay"], sigma


def test_several_sightings_of_new_and_known_landmarks_in_a_step() -> None:
    rng = np.random.default_rng(0)
    graph, values = linear()
    i, k = np.array(SEEN).T
    again = Between(x[i], l[k], rng.normal(size=(len(i), 2)), Isotropic(0.5))
    twice = FactorGraph([*graph.factors, again, Prior(l[[2, 3]], [[1.0, 2.0]], Isotropic(2.0))])
    best = twice.optimize(values).values
    for estimator in (Smoother(tol=1e-15), Smoother(2, "stay", 1e-15)):
        track = estimator.run(twice, values)
        close(track.X[-1], best[x[STEPS - 1]], atol=1e-9)
        close(track.values[l[[0, 1, 2, 3]]], best[l[[0, 1, 2, 3]]], atol=1e-9)


def test_a_landmark_keeps_its_place_when_only_other_factors_locate_it() -> None:
    """At (2, 1) and not at -50, 80."""
    seen = BearingRange(x[[0, 1]], l[4], [[np.arctan(0.5), 5**0.5], [np.pi / 4, 2**0.5]], Isotropic(0.1))
    values = Values({x: (SE2, SE2.identity(2)), l: (R(2), [[-50.0, 80.0]], [4])})
    first, step = Prior(x[0], [0, 0, 0], Isotropic(0.1)), Between(x[0], x[1], [1.0, 0, 0], Isotropic(0.1))
    close(Smoother().run(FactorGraph([first, step, seen]), values).values[l[4]], [2.0, 1.0], atol=0.01)
