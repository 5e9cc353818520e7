"""The graph: what is added, removed, held; what it counts and refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from factors import Between, Isotropic, Prior
from models import SE2, R
from nls import FactorGraph, GraphError, OptionError, Values, kinds
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
        with pytest.raises(GraphError, match=r"a list of variables to hold such as \[x\[0\]\], got"):
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
    with pytest.raises(GraphError, match=r"Between\(x0, l0\) joins SE2 and R\(2\)"):
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
    steps, prior = (
        Between(x[[0, 1, 2]], x[[1, 2, 3]], [[1.0], [2.0], [4.0]], Isotropic(1.0)),
        Prior(x[0], [0.0], Isotropic(1.0)),
    )
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
