"""Measurements that are added one by one: batches when the graph is evaluated, and handles to take them out again."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from factors import Factor, Huber, Isotropic, Prior
from models import SE2
from models.errors import GraphError
from nls import FactorGraph, Values, kinds
from nls.graph import SMALLEST_BATCH

(x,) = kinds("x")


def by_ones(factor: Factor) -> list[Factor]:
    return [factor[[k]] for k in range(len(factor))]


@pytest.fixture
def world() -> sim.World:
    return sim.ring(np.random.default_rng(2), laps=4, per_lap=40)


def test_one_by_one_is_the_same_as_in_batches(world: sim.World) -> None:
    odometry, closures = world.graph.factors
    closures = closures.robust(Huber(2.0))
    single = FactorGraph([Prior(x[0], [0, 0, 0], Isotropic(0.1)), *by_ones(odometry), *by_ones(closures)])
    batches = FactorGraph([Prior(x[0], [0, 0, 0], Isotropic(0.1)), odometry, closures])
    mine, theirs = single.optimize(world.start), batches.optimize(world.start)
    assert mine.chi2_final == pytest.approx(theirs.chi2_final, rel=1e-12)
    np.testing.assert_allclose(mine.values[x], theirs.values[x], atol=1e-9)
    names = [(type(f).__name__, len(f), f.kernel) for f in single.factors]
    assert names == [(type(f).__name__, len(f), f.kernel) for f in batches.factors]
    A, B = single.linearize(world.start), batches.linearize(world.start)
    np.testing.assert_allclose(A.b, B.b, rtol=1e-14)


def test_few_stay_alone(world: sim.World) -> None:
    odometry = by_ones(world.graph.factors[0])[: SMALLEST_BATCH - 1]
    graph = FactorGraph(odometry)
    graph.chi2(world.start)
    assert graph.factors == odometry


def test_what_is_added_later_joins_and_every_handle_takes_out_its_own(world: sim.World) -> None:
    odometry, closures = world.graph.factors
    steps = by_ones(odometry)
    graph = FactorGraph([closures])
    for k, step in enumerate(steps):
        assert graph.add(step) is step
        if k % 10 == 9:
            graph.chi2(world.start)
    assert graph.chi2(world.start) == pytest.approx(world.graph.chi2(world.start), rel=1e-12)
    assert len(graph.factors) < 2 + SMALLEST_BATCH
    rest = list(range(len(steps)))
    for k in (0, 3, len(steps) - 1, 41):
        graph.remove(steps[k])
        rest.remove(k)
        expected = FactorGraph([odometry[rest], closures]).chi2(world.start)
        assert graph.chi2(world.start) == pytest.approx(expected, rel=1e-12)
        with pytest.raises(GraphError, match="is not in this graph"):
            graph.remove(steps[k])
    for k in rest:
        graph.remove(steps[k])
    assert graph.factors == [closures]


def test_a_factor_that_is_given_twice_counts_twice() -> None:
    priors = [Prior(x[k], [k, 0, 0], Isotropic(1.0)) for k in range(SMALLEST_BATCH)]
    values = Values({x: (SE2, np.zeros((SMALLEST_BATCH, 3)))})
    expected = sum(k * k for k in range(SMALLEST_BATCH))
    for factors, chi2 in (([priors[3]] * SMALLEST_BATCH, 9 * SMALLEST_BATCH), ([priors[5], *priors], expected + 25)):
        graph = FactorGraph(factors)
        assert graph.chi2(values) == chi2
        assert len(graph) == len(factors)
        graph.remove(factors[0])
        assert graph.chi2(values) == chi2 - factors[0].chi2(values)[0]


def test_functions_stay_alone() -> None:
    """Only the function knows its data."""
    factors = [
        Factor.from_function(lambda X, k=k: X[:, :1] - k, x[k], 1)  # type: ignore[misc]
        for k in range(2 * SMALLEST_BATCH)
    ]
    graph = FactorGraph(factors)
    assert graph.chi2(Values({x: (SE2, np.zeros((2 * SMALLEST_BATCH, 3)))})) == sum(
        k * k for k in range(2 * SMALLEST_BATCH)
    )
    assert graph.factors == factors
