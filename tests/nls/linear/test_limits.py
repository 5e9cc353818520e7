"""Memory is estimated before it is taken (P9): the refusal with its numbers, the estimate, the limit."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from factors import Between, Isotropic, Prior
from models import SE3, R
from nls import LU, QR, Cholesky, FactorGraph, ResourceLimitError, Values
from nls.analysis.inspection import inspect
from nls.gauge import choose_gauge
from nls.linear import limits
from nls.linear.limits import FRACTION, UNKNOWN, default_limit
from nls.sparse.pattern import Pattern
from tests.nls.graphs import cube, pose_graph, x

SPARSE = (Cholesky, LU, QR)
PROC = Path("/proc/self/status")


def lattice(side: int, dim: int = 1) -> tuple[FactorGraph, Values]:
    """Points of R(dim) on a cube of side^3, each joined to its neighbors."""
    i, j = cube(side)
    graph = FactorGraph([Prior(x[0], np.zeros(dim), Isotropic(1)), Between(x[i], x[j], np.ones(dim), Isotropic(1))])
    return graph, Values({x: (R(dim), np.zeros((side**3, dim)))})


@pytest.mark.parametrize("kind", SPARSE)
def test_a_factorization_above_the_limit_is_refused_with_the_numbers(kind: type[Cholesky | LU | QR]) -> None:
    if (why := kind.missing()) is not None:
        pytest.skip(why)
    graph, values = lattice(9)
    with pytest.raises(ResourceLimitError) as caught:
        graph.optimize(values, linear_solver=kind(memory_limit=1e5))
    error = caught.value
    assert (error.limit, error.subject) == (1e5, "sparse factorization")
    assert error.needed > 1e5
    if kind is not LU:
        numbers = inspect(graph, values)["numbers_in_R"]
        assert error.needed == pytest.approx(kind.per_number * numbers)
        assert f"R of 729 unknowns has {numbers:,} numbers" in str(error)
    assert str(error).startswith(f"linear solver {kind.name!r}: ")
    assert "the limit is 0.000100 GB" in str(error)
    assert "memory_limit" in str(error)
    assert graph.optimize(values, linear_solver=kind(memory_limit=error.needed)).converged  # the same, allowed
    with pytest.raises(ResourceLimitError):
        graph.optimize(values, linear_solver=kind(memory_limit=error.needed - 1))


SOLVE = """
import nls
from nls.linear import best_decomposition
from nls.sparse.fill import fill_in
from tests.nls.linear.test_limits import lattice
def read(name):
    return next(1024 * int(line.split()[1]) for line in open("/proc/self/status") if line.startswith(name))
graph, values = lattice(12, 3)
system = graph.linearize(values)
system.gradient
numbers = fill_in(system.pattern, system.pattern.held, best_decomposition().order).nnz
solver = nls.Cholesky()
before = read("VmRSS")
solver.analyze(system.pattern).solve(system)
print(read("VmHWM") - before, solver.per_number * numbers, 8 * numbers)
"""


def test_the_estimate_covers_what_a_solve_takes() -> None:
    """Resident memory at the peak of analysis and solve, above that of the linearized graph, in its own process."""
    if Cholesky.missing() is not None or not PROC.exists():
        pytest.skip("needs CHOLMOD and /proc")
    root = Path(__file__).parents[3]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    run = subprocess.run([sys.executable, "-c", SOLVE], cwd=root, env=environment, capture_output=True, check=True)
    taken, needed, numbers = map(float, run.stdout.split())
    assert numbers > 5e6
    assert numbers < taken < needed + 1e7


def test_nothing_is_counted_where_everything_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    def counting(*_: object) -> None:
        raise AssertionError("counted")

    monkeypatch.setattr(limits, "counted", counting)
    sample = pose_graph(SE3)
    for kind in SPARSE:
        if kind.missing() is None:
            assert sample.graph.optimize(sample.values, linear_solver=kind()).converged
    n = 6 * len(sample.values.stacks["x"].X)
    full = LU.per_number * n * (n + 1) / 2
    assert sample.graph.optimize(sample.values, linear_solver=LU(memory_limit=full)).converged
    with pytest.raises(AssertionError, match="counted"):
        sample.graph.optimize(sample.values, linear_solver=LU(memory_limit=full / 4))


def test_the_limit_is_half_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    pages = {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 1_000_000}
    monkeypatch.setattr(os, "sysconf", pages.__getitem__)
    default_limit.cache_clear()
    assert default_limit() == FRACTION * 4.096e9
    default_limit.cache_clear()
    monkeypatch.delattr(os, "sysconf")  # as on Windows
    assert default_limit() == UNKNOWN
    default_limit.cache_clear()
    monkeypatch.undo()
    assert default_limit() > 1e8


def test_a_gauge_that_is_held_is_not_counted() -> None:
    graph, values = lattice(4)
    held = choose_gauge("first", Pattern(graph.factors[1:], values), values, np.zeros(64, dtype=bool)).held
    assert held.sum() == 1
    free = FactorGraph(graph.factors[1:])
    assert inspect(free, values)["columns_of_A"] == 63
    assert inspect(free, values)["numbers_in_R"] < inspect(graph, values)["numbers_in_R"]
