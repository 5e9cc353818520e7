"""Values: one stack per kind, looked up by number; moved together, never by accident."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Between, Isotropic
from models import SE2, SE3, SO3, LieGroup, R
from nls import GraphError, OptionError, Values, kinds
from tests.nls.graphs import ODD, walk

x, l = kinds("x", "l")


def odd() -> tuple[Values, np.ndarray]:
    X = walk(SE2, len(ODD), np.random.default_rng(0))
    return Values({x: (SE2, X, ODD), l: (R(2), [[5.0, 6.0]], [9])}), X


def test_numbers_need_neither_order_nor_neighbors() -> None:
    values, X = odd()
    for k, number in enumerate(ODD):
        assert np.array_equal(values[x[number]], X[k])
    assert np.array_equal(values[x[[2**40, -3]]], X[[5, 3]])
    assert np.array_equal(values[x], X)
    assert values[l[9]].tolist() == [5.0, 6.0]


def test_a_missing_number_is_named() -> None:
    entries = ((R(1), [1.0, 2.0, 3.0]), *((R(1), [1.0, 2.0, 3.0], n) for n in ([5, 6, 7], [7, 5, 6], [0, 2, 4])))
    for values in (*(Values({x: entry}) for entry in entries), Values({x: (R(1), np.zeros((0, 1)))})):
        for absent in (-1, 3, 8, 2**62):
            with pytest.raises(GraphError, match=rf"^x{absent} has no value") as caught:
                values[x[absent]]
            assert repr(caught.value.keys[0]) == f"x{absent}"
            assert x[absent] not in values
    assert (len(values), values.dim) == (0, 0)


def test_unknown_kind_lists_the_known() -> None:
    values, _ = odd()
    (q,) = kinds("q")
    with pytest.raises(GraphError, match=r"no variable of kind 'q' has a value; Values hold kinds \['x', 'l'\]"):
        values[q]
    assert q[0] not in values
    with pytest.raises(GraphError, match="no variable of kind 'q' has a value"):
        values.stack(q)
    assert values.stack(x) is values.stack("x") is values.stacks["x"]


def test_what_cannot_be_values_is_refused() -> None:
    for entry, message in (
        ((SE2, [[0.0, 0.0]]), r"SE2: elements have shape \(1, 2\)"),
        ((SE2, [[0.0, 0.0, np.nan]]), "not finite"),
        ((SE3, [[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]]), "length 2"),
        ((R(1), [1.0, 2.0], [0]), "2 elements and 1 numbers"),
        ((R(1),), "expected"),
        ([R(1), [1.0]], "expected"),
        ((R(1), [1.0], [0.5]), "whole numbers"),
        ((R(1), [1.0, 2.0, 3.0], [7, 3, 7]), "x7 is given twice"),
    ):
        with pytest.raises(GraphError, match=message):
            Values({x: entry})


def test_length_dimension_and_iteration_follow_the_kinds() -> None:
    values, _ = odd()
    assert len(values) == 9
    assert values.dim == 8 * 3 + 2
    assert [repr(key) for key in values] == [f"x{n}" for n in ODD] + ["l9"]
    assert repr(values) == "Values(x: 8 x SE2, l: 1 x R(2))"


def test_assignment_touches_what_it_names() -> None:
    values, X = odd()
    values[x[[7, 1000]]] = [[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]
    X[1], X[4] = 1.0, 2.0
    assert np.array_equal(values[x], X)
    values[x[12]] = [3.0, 3.0, 3.0]
    X[6] = 3.0
    assert np.array_equal(values[x], X)
    values[l] = [[7.0, 8.0]]
    assert values[l].tolist() == [[7.0, 8.0]]
    with pytest.raises(GraphError, match="3 elements for"):
        values[x[[7, 1000]]] = np.zeros((3, 3))


def test_arrays_are_not_shared() -> None:
    """What is read is the reader's own, as is a copy; the array that was given is the caller's."""
    values, X = odd()
    given = X.copy()
    values[x[7]][:] = 99.0
    values[x][:] = 99.0
    copy = values.copy()
    copy[x[40]] = [9.0, 9.0, 1.0]
    X[0, 0] += 5.0
    assert np.array_equal(values[x], given)
    assert copy[x[40]].tolist() == [9.0, 9.0, 1.0]


@pytest.mark.parametrize("group", [SE2, SO3, SE3], ids=str)
def test_retract_moves_each_variable_by_its_own_part(group: LieGroup) -> None:
    rng = np.random.default_rng(3)
    X, P = walk(group, 5, rng), rng.normal(size=(4, 2))
    values = Values({l: (R(2), P, [4, 1, 9, 2]), x: (group, X)})
    delta = 0.3 * rng.normal(size=values.dim)
    moved = values.retract(delta)
    assert np.array_equal(moved[l], P + delta[:8].reshape(4, 2))
    for k in range(5):
        d = group.dim
        one = group.retract(X[k], delta[8 + k * d : 8 + (k + 1) * d])
        np.testing.assert_allclose(moved[x[k]], one, rtol=0, atol=1e-15)
    assert np.array_equal(values[x], X)


def test_a_kind_is_added_to_values_that_are_there() -> None:
    values, X = odd()
    o, q = kinds("o", "q")
    values.add(o, SE3, SE3.identity())
    values.add(q, R(1), [[4.0], [5.0]], [7, 3])
    assert repr(values) == "Values(x: 8 x SE2, l: 1 x R(2), o: 1 x SE3, q: 2 x R(1))"
    assert values[o[0]].tolist() == [0, 0, 0, 0, 0, 0, 1]
    assert values[q[[3, 7]]].tolist() == [[5.0], [4.0]]
    assert np.array_equal(values[x], X)
    for arguments, message in (
        ((x, SE2, [0.0, 0.0, 0.0]), r"of kind x already; values\[x\[i\]\] = X moves them"),
        (("p", SE2, [0.0, 0.0, 0.0]), r"'p' is no kind of variable; expected o of \(o,\) = kinds\('o'\)"),
        ((kinds("p")[0], SE2, [0.0, 0.0]), r"SE2: elements have shape \(2,\)"),
        ((kinds("p")[0], R(1), [0.0, 1.0], [0]), "p: 2 elements and 1 numbers"),
    ):
        with pytest.raises(GraphError, match=message):
            values.add(*arguments)  # type: ignore[arg-type]
    assert list(values.stacks) == ["x", "l", "o", "q"]
    with pytest.raises(GraphError, match=r"Add initial values with `Values\.add`"):
        values[kinds("p")[0][0]] = [1.0]


def test_a_graph_and_its_values_that_are_swapped_are_named() -> None:
    from nls import FactorGraph, Marginals, certify, explain, gnc, initialize, save
    from nls.filters.ekf import EKF
    from nls.plot import report
    from nls.starts import chordal, incremental, odometry, spanning_tree

    graph = FactorGraph([Between(x[0], x[1], [1, 0, 0], Isotropic(1.0))])
    values = Values({x: (SE2, np.zeros((2, 3)))})
    functions = [Marginals, certify, explain, gnc, initialize, EKF().run, chordal, incremental, odometry, spanning_tree]
    for call in (*functions, lambda g, v: save("a.g2o", g, v), lambda g, v: report(g, v, None)):  # type: ignore[arg-type]
        with pytest.raises(GraphError, match=r"expected a graph and its values, got .*; swap them"):
            call(values, graph)  # type: ignore[arg-type, operator]
        with pytest.raises(GraphError, match="expected a graph and its values, got"):
            call(graph, None)  # type: ignore[arg-type, operator]
    with pytest.raises(OptionError, match="the name of a file first, then the graph and its values"):
        save(graph, values, "a.g2o")  # type: ignore[arg-type]


def test_values_merge_and_clashes_are_named() -> None:
    (o,) = kinds("o")
    first = Values({x: (SE2, [[0, 0, 0], [1, 0, 0]], [7, 3]), l: (R(2), [1, 1])})
    both = first | Values({o: (SE2, [9, 9, 0]), x: (SE2, [2, 0, 0], 5)})
    assert list(both) == [x[7], x[3], x[5], l[0], o[0]]
    assert both[x][:, 0].tolist() == [0.0, 1.0, 2.0]
    assert first[x].shape == (2, 3)
    for other, named in (
        (Values({x: (SE2, np.zeros((3, 3)), [4, 3, 7])}), r"both hold x3, x7; .*another number"),
        (Values({l: (R(3), [0, 0, 0], 4)}), r"l is in R\(2\) and in R\(3\)"),
    ):
        with pytest.raises(GraphError, match=named):
            first | other
    with pytest.raises(TypeError, match="unsupported operand"):
        first | {}  # type: ignore[operator]
