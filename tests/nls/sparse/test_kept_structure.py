"""The structure of a graph is kept between solves: for its own variables and order alone, and without any numbers."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2
from nls import LinearSystem, Marginals, factorize
from nls.linear import best_decomposition
from nls.linear.cholesky import cholmod
from nls.sparse.elimination import Elimination
from nls.sparse.hessian import Hessian
from tests.nls.graphs import pose_graph, x


def test_a_structure_serves_the_same_held_variables_and_the_same_order_alone() -> None:
    sample = pose_graph(SE2, n=12)
    pattern, order = sample.graph.pattern(sample.values), best_decomposition().order
    first, second = np.arange(12) == 0, np.arange(12) == 3
    held = pattern.holding(first)
    assert pattern.holding(first.copy()) is held
    assert held.hessian(order) is held.hessian(order)
    assert held.hessian() is not held.hessian(order)
    backward = held.hessian(lambda u, v, V: np.arange(V)[::-1])
    assert backward.elimination.variables.tolist() == [*range(11)][::-1]
    assert held.hessian(order).elimination.variables.tolist() != [*range(11)][::-1]
    other = pattern.holding(second)
    assert other is not held
    assert (other.starts[[0, 3]].tolist(), held.starts[[0, 3]].tolist()) == ([0, -1], [-1, 6])
    assert other.hessian(order) is not held.hessian(order)
    assert held.holding(second).hessian(order) is not held.hessian(order)
    first[:] = second  # the mask belongs to the caller
    assert pattern.holding(first).held.tolist() == second.tolist()
    assert held.held.tolist() == (np.arange(12) == 0).tolist()


def test_factorizations_of_one_structure_have_numbers_of_their_own() -> None:
    sample = pose_graph(SE2, n=30)
    moved = sample.graph.optimize(sample.values).values
    pattern = sample.graph.pattern(moved).holding(np.arange(30) == 0)
    systems = [LinearSystem.at(pattern, values) for values in (sample.values, moved)]
    kept = [factorize(system) for system in systems]
    g = systems[0].gradient
    solutions = [H.solve(g) for H in kept]
    for system, solution in zip(systems, solutions, strict=True):
        expected = np.linalg.solve(system.H.toarray(), g)
        np.testing.assert_allclose(solution, expected, atol=1e-9 * np.abs(expected).max())
    assert np.abs(solutions[0] - solutions[1]).max() > 1e-3 * np.abs(solutions[0]).max()
    before = Marginals(sample.graph, moved)
    sample.graph.optimize(sample.values)
    after = Marginals(sample.graph, moved)
    assert np.array_equal(before.all(x, frame="body"), after.all(x, frame="body"))


@pytest.mark.skipif(cholmod() is None, reason="CHOLMOD alone analyzes a structure")
def test_a_graph_is_analyzed_once_for_all_its_solves(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    for cls in (Elimination, Hessian):
        monkeypatch.setattr(cls, "__init__", _counted(cls, made))
    sample = pose_graph(SE2, n=20)
    result = sample.graph.optimize(sample.values)
    once = list(made)
    sample.graph.optimize(result.values)
    Marginals(sample.graph, result.values).all(x, frame="body")
    whole = sample.graph.only([np.ones(len(f), dtype=bool) for f in sample.graph.factors])
    whole.optimize(result.values)
    assert made == once == ["Elimination", "Hessian"]
    masks = [np.ones(len(f), dtype=bool) for f in sample.graph.factors]
    masks[0][-1] = False
    sample.graph.only(masks).optimize(result.values)
    assert made == [*once, "Elimination", "Hessian"]
    whole.add(sample.graph.factors[0])
    whole.optimize(result.values)
    assert len(made) == 6


def _counted(cls: type, made: list[str]) -> object:
    init = cls.__init__  # type: ignore[misc]

    def counted(self: object, *arguments: object) -> None:
        made.append(cls.__name__)
        init(self, *arguments)

    return counted
