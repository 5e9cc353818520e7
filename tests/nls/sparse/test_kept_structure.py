"""The structure of a graph is kept between solves, and the memory of its arrays is used again."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from weakref import ref

import numpy as np
import pytest

from models import SE2
from models.algebra import Array
from nls import GaussNewton, LinearSystem, Marginals, Values, factorize
from nls.linear import best_decomposition
from nls.linear.cholesky import cholmod
from nls.sparse.elimination import Elimination
from nls.sparse.hessian import Hessian
from nls.sparse.pattern import Pattern
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


PAGES = """
import resource
import numpy as np
{first}

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

def iteration():
    arrays = [np.ones(1 << 18) for _ in range(8)]

for _ in range(3):
    iteration()
begin = faults()
for _ in range(5):
    iteration()
print(faults() - begin)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries keep memory in their own way")
def test_arrays_of_the_next_iteration_need_no_new_pages() -> None:
    def new_pages(first: str) -> int:
        command = [sys.executable, "-c", PAGES.format(first=first)]
        env = {k: v for k, v in os.environ.items() if not k.startswith(("MALLOC_", "GLIBC_"))}
        return int(subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout)

    assert new_pages("import nls.graph") < new_pages("") / 5  # 0 and 20,000 of 4 KB


def test_gauss_newton_has_one_linearization_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    at, arrays = LinearSystem.at, list[ref[Array]]()

    def watched(pattern: Pattern, values: Values) -> LinearSystem:
        assert not any(array() is not None for array in arrays)
        system = at(pattern, values)
        arrays.extend(map(ref, (system.b, *system.blocks[0])))
        return system

    monkeypatch.setattr(LinearSystem, "at", watched)
    sample = pose_graph(SE2)
    assert sample.graph.optimize(sample.values, GaussNewton()).converged
    assert len(arrays) >= 3 * 3
