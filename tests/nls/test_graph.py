"""The graph: what is added, removed, held; what it counts and refuses; single measurements become batches."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import sim
from factors import Between, Factor, Huber, Isotropic, Prior
from models import SE2, R
from nls import FactorGraph, GraphError, OptionError, Values, kinds
from nls.graph import SMALLEST_BATCH
from tests.nls.graphs import pose_graph

x, l = kinds("x", "l")


def line() -> tuple[FactorGraph, Values]:
    graph = FactorGraph([Prior(x[0], [0.0], Isotropic(1)), Between(x[[0, 1]], x[[1, 2]], [[1.0], [1.0]], Isotropic(1))])
    return graph, Values({x: (R(1), [0.0, 0.0, 0.0])})


def test_length_counts_measurements() -> None:
    graph, _ = line()
    assert len(graph) == 3
    assert len(graph.factors) == 2
    assert repr(graph) == "FactorGraph(2 factors, 3 measurements)"
    assert len(FactorGraph()) == 0


def test_add_returns_the_handle_that_remove_takes() -> None:
    graph, values = line()
    before = graph.chi2(values)
    first, second = (graph.add(Prior(x[2], [5.0], Isotropic(1))) for _ in range(2))
    assert graph.chi2(values) == before + 50.0
    graph.remove(second)  # and not its twin
    assert graph.factors[-1] is first
    graph.remove(first)
    assert graph.chi2(values) == before
    with pytest.raises(GraphError, match=r"Prior\(x2\) is not in this graph"):
        graph.remove(first)


def test_chi2_is_the_sum_of_squares_without_one_half() -> None:
    graph, values = line()
    values[x] = [[0.5], [0.0], [4.0]]
    assert graph.chi2(values) == 0.5**2 + 1.5**2 + 3.0**2
    assert graph.linearize(values).chi2 == graph.chi2(values)


def test_fixed_variables_have_no_columns_and_do_not_move() -> None:
    graph, values = line()
    graph.fix(x[1])
    system = graph.linearize(values)
    assert system.cols == ["x0: x", "x2: x"]
    values[x[1]] = [7.0]
    solved = graph.optimize(values).values
    assert solved[x[1]].tolist() == [7.0]
    assert solved[x].ravel() == pytest.approx([3.0, 7.0, 8.0])  # x0 between its prior at 0 and 7 - 1


def test_release_undoes_fix_for_these_alone() -> None:
    graph, values = line()
    graph.fix(x[[0, 1]])
    graph.fix(x[2])
    graph.release(x[[1, 2]])
    assert graph.linearize(values).cols == ["x1: x", "x2: x"]
    graph.release(l[0])
    graph.release(x[0])
    assert len(graph.linearize(values).cols) == 3


def test_what_cannot_be_in_a_graph_is_refused() -> None:
    for wrong in (None, "Between", 3, Between):
        with pytest.raises(GraphError, match=r"FactorGraph\.add: expected a factor"):
            FactorGraph().add(wrong)  # type: ignore[arg-type]
    for hold in (3, x[0], "x0"):
        with pytest.raises(GraphError, match=r"a list of variables to fix such as \[x\[0\]\], got"):
            FactorGraph(fixed=hold)  # type: ignore[arg-type]
    with pytest.raises(GraphError, match="expected variables such as x"):
        FactorGraph(fixed=["x0"])  # type: ignore[list-item]
    with pytest.raises(GraphError, match=r"FactorGraph\.fix: expected variables such as x\[0\], got 0"):
        FactorGraph().fix(0)  # type: ignore[arg-type]
    with pytest.raises(GraphError, match=r"a list of factors such as \[factor\]"):
        FactorGraph(Between(x[[0, 1]], x[[1, 2]], [[1.0], [1.0]], Isotropic(1)))  # type: ignore[arg-type]


def test_what_cannot_be_optimized_is_refused() -> None:
    graph, values = line()
    with pytest.raises(OptionError, match="gauge: 'middle' is not possible; expected one of first, prior, free, none"):
        graph.optimize(values, gauge="middle")
    graph.fix(x[9])
    with pytest.raises(GraphError, match="x9 has no value"):
        graph.optimize(values)
    graph.release(x[9])
    factor = graph.add(Prior(x[17], [0.0], Isotropic(1)))
    with pytest.raises(GraphError, match="x17 has no value"):
        graph.optimize(values)
    graph.remove(factor)
    graph.add(Prior(l[0], [0.0], Isotropic(1)))
    with pytest.raises(GraphError, match="no variable of kind 'l'"):
        graph.chi2(values)
    graph = FactorGraph([Between(x[0], l[0], [1.0, 0.0, 0.0], Isotropic(1))])
    with pytest.raises(GraphError, match=r"Between\(x0, l0\) connects SE2 and R\(2\)"):
        graph.optimize(Values({x: (SE2, SE2.identity()), l: (R(2), [[0.0, 0.0]])}))
    for factors in ([], [Between(x[[]], x[[]], np.zeros((0, 1)), Isotropic(1))]):
        with pytest.raises(GraphError, match="no factors: nothing to optimize"):
            FactorGraph(factors).optimize(Values({x: (R(1), [0.0])}))


def test_summary_counts_each_type_and_its_variables() -> None:
    sample = pose_graph(SE2)
    sample.graph.fix(x[3])
    text = sample.graph.summary()
    rows = [line.split() for line in text.splitlines()]
    assert rows == [["Between", "13"], ["Prior", "1"], ["variables", "x", "8"], ["fixed", "1"]]


def test_a_part_of_a_graph_has_the_measurements_of_its_masks_and_holds_the_same() -> None:
    steps = Between(x[[0, 1, 2]], x[[1, 2, 3]], [[1.0], [2.0], [4.0]], Isotropic(1.0))
    prior = Prior(x[0], [0.0], Isotropic(1.0))
    graph = FactorGraph([steps, prior], fixed=[x[3]])
    part = graph.only([np.array([True, False, True]), np.array([False])])
    values = Values({x: (R(1), np.zeros((4, 1)))})
    assert [len(factor) for factor in part.factors] == [2]
    assert part.chi2(values) == 1 + 16
    assert part.fixed == [x[3]]
    assert graph.only([np.ones(3, dtype=bool), np.ones(1, dtype=bool)]).factors[0] is steps
    assert len(graph) == 4
    part.fix(x[0])
    assert graph.fixed == [x[3]]


def test_masks_may_be_lists_and_must_fit() -> None:
    assert len(line()[0].only([[False], [True, False]])) == 1
    graph = FactorGraph([Prior(x[0], [0.0], Isotropic(1.0))])
    one, two = np.ones(1, dtype=bool), np.ones(2, dtype=bool)
    wrong: Any
    for wrong in ([], [two], [one, one], [np.array([0])], [np.array([1.0])], 5):
        with pytest.raises(GraphError, match="a mask of True and False for each of 1 factors, as long as it has"):
            graph.only(wrong)


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


def test_a_copy_and_a_sum_leave_their_graphs_as_they_are(world: sim.World) -> None:
    singles, more = list(world.graph.factors[0]), FactorGraph([world.graph.factors[1]], [x[1]])
    graph = FactorGraph(singles, [x[0]])
    before = graph.chi2(world.truth)
    both = graph + more
    assert (both.fixed, more.fixed, graph.fixed) == ([x[0], x[1]], [x[1]], [x[0]])
    assert both.chi2(world.truth) == pytest.approx(before + more.chi2(world.truth))
    for other in (both, graph.copy()):
        other.remove(singles[3])
        other.add(more.factors[0])
        other.fix(x[2])
    assert (len(both), len(more.factors)) == (len(world.graph) - 1 + len(more), 1)
    assert graph.chi2(world.truth) == before
    graph.remove(singles[3])
    with pytest.raises(TypeError, match="unsupported operand"):
        graph + world.truth  # type: ignore[operator]


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
    n = 2 * SMALLEST_BATCH
    factors = [Factor.from_function(lambda X, k=k: X[:, :1] - k, x[k], 1) for k in range(n)]
    graph = FactorGraph(factors)
    assert graph.chi2(Values({x: (SE2, np.zeros((n, 3)))})) == sum(k * k for k in range(n))
    assert graph.factors == factors
