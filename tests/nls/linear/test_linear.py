"""Linear solvers: each on each graph against numpy.linalg.lstsq; what is singular, too large or missing is refused."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

import nls
from factors import Between, Factor, Isotropic, Prior
from models import SE2, SE3, R
from models.algebra import Array
from nls import FactorGraph, LinearSystem, Values
from nls.linear import SOLVERS, LinearSolver, Pinv, backends, best_decomposition, default_solver
from nls.linear.cholesky import Cholmod
from nls.linear.factorization import Decomposition, Factorization
from nls.linear.lu import SuperLU
from nls.linear.singular import SingularSystemError
from tests.combinations import for_all
from tests.nls.graphs import SAMPLES, mixed, p, pose_graph, x

DENSE = ("dense-qr", "dense-cholesky", "pinv")
DECOMPOSITIONS: tuple[type[Decomposition], ...] = (Cholmod, SuperLU)


def make(name: str) -> LinearSolver:
    solver = SOLVERS[name]()
    if (why := solver.missing()) is not None:
        pytest.skip(f"{name}: {why}")
    return solver


def solve(name: str, system: LinearSystem) -> Array:
    solver = make(name)
    return solver.analyze(system.pattern).solve(system).dx


def factorized(kind: type[Decomposition], system: LinearSystem) -> tuple[Factorization, Array]:
    """A factorization, and the flat blocks it was made of."""
    if kind is Cholmod:
        make("cholesky")
    hessian = system.pattern.hessian(kind.order)
    return Factorization(hessian, kind(hessian)).factorize(system.H_blocks), system.H_blocks


def in_other_units(system: LinearSystem, variable: int, component: int, factor: float) -> LinearSystem:
    """The system with one column of A multiplied."""
    blocks = []
    for batch, A in zip(system.pattern.batches, system.blocks, strict=True):
        scaled = [np.array(A_k) for A_k in A]
        for numbers, A_k in zip(batch.variables, scaled, strict=True):
            A_k[numbers == variable, :, component] *= factor
        blocks.append(tuple(scaled))
    return LinearSystem(system.pattern, blocks, system.b)


@pytest.mark.parametrize("name", SOLVERS)
@for_all(graph=SAMPLES)
def test_every_solver_on_every_graph(name: str, graph: str) -> None:
    sample = SAMPLES[graph]()
    system = sample.graph.linearize(sample.values)
    expected = np.linalg.lstsq(system.A.toarray(), system.b)[0]
    np.testing.assert_allclose(solve(name, system), expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", SOLVERS)
def test_the_state_serves_every_linearization_of_a_graph(name: str) -> None:
    sample = pose_graph(SE3, start=0.3)
    solver = make(name)
    first, second = sample.graph.linearize(sample.values), sample.graph.linearize(sample.truth)
    state = solver.analyze(first.pattern)
    for system in (first, second, first):
        solution = state.solve(system)
        expected = np.linalg.lstsq(system.A.toarray(), system.b)[0]
        np.testing.assert_allclose(solution.dx, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
        assert set(solution.seconds) <= {"assemble", "factorize", "solve"}
        assert all(seconds >= 0 for seconds in solution.seconds.values())


def relative() -> FactorGraph:
    return pose_graph(SE2, seed=7, anchored=False).graph


def untouched() -> FactorGraph:
    return FactorGraph([Prior(x[k], [0.1, 0.2, 0.3], Isotropic(0.1)) for k in range(7)])


def few_rows() -> FactorGraph:
    """The position of every pose is measured; the heading is not."""
    return FactorGraph([Factor.from_function(lambda X: X[:, :2] - 1.0, x[0:8], 2)])


def apart() -> FactorGraph:
    """Two components, one of them with a prior."""
    graph = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], Isotropic(1))])
    for k in (0, 1, 2, 4, 5, 6):
        graph.add(Between(x[k], x[k + 1], [1.0, 0.1, 0.2], Isotropic(0.1)))
    return graph


@pytest.mark.parametrize("case", [relative, untouched, few_rows, apart])
@pytest.mark.parametrize("name", SOLVERS)
def test_singular_systems_are_refused_or_solved_shortest(name: str, case: object) -> None:
    system = case().linearize(pose_graph(SE2, seed=7).values)  # type: ignore[operator]
    A = system.A.toarray()
    assert np.linalg.matrix_rank(A) < A.shape[1]
    if name == "pinv":
        shortest = np.linalg.lstsq(A, system.b, rcond=1e-12)[0]
        np.testing.assert_allclose(solve(name, system), shortest, rtol=0, atol=1e-9 * np.abs(shortest).max())
    else:
        with pytest.raises(SingularSystemError):
            solve(name, system)


@pytest.mark.parametrize("name", [name for name in SOLVERS if name != "pinv"])
@for_all(seed=range(8))
def test_rounding_does_not_hide_a_free_gauge(name: str, seed: int) -> None:
    for group in (R(2), SE2, SE3):
        sample = pose_graph(group, seed=20 + seed, anchored=False, n=8 + seed)
        with pytest.raises(SingularSystemError):
            solve(name, sample.graph.linearize(sample.values))


@pytest.mark.parametrize("units", [1e8, 1e-8])
@pytest.mark.parametrize("name", [name for name in SOLVERS if name != "pinv"])
def test_units_do_not_make_a_system_singular(name: str, units: float) -> None:
    sample = pose_graph(SE2, seed=8)
    system = sample.graph.linearize(sample.values)
    expected = np.linalg.lstsq(system.A.toarray(), system.b)[0]
    expected[3 * 3 + 1] /= units
    found = solve(name, in_other_units(system, 3, 1, units))
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("units", [1e8, 1e-8])
@pytest.mark.parametrize("name", [name for name in SOLVERS if name != "pinv"])
def test_units_do_not_hide_a_free_direction(name: str, units: float) -> None:
    sample = pose_graph(SE2, seed=8, anchored=False)
    system = sample.graph.linearize(sample.values)
    with pytest.raises(SingularSystemError):
        solve(name, in_other_units(system, 3, 1, units))


@pytest.mark.parametrize("name", SOLVERS)
def test_no_columns_no_step(name: str) -> None:
    sample = pose_graph(SE2)
    sample.graph.fix(x[0:8])
    assert solve(name, sample.graph.linearize(sample.values)).shape == (0,)


@pytest.mark.parametrize("name", DENSE)
def test_dense_solvers_refuse_before_taking_memory(name: str) -> None:
    sample = pose_graph(SE2)
    system = sample.graph.linearize(sample.values)
    solver = SOLVERS[name](memory_limit=1000.0)  # type: ignore[call-arg]
    with pytest.raises(nls.ResourceLimitError, match=rf"'{name}': a dense 42 x 24 system needs") as caught:
        solver.analyze(system.pattern)
    assert isinstance(caught.value, MemoryError)
    assert caught.value.limit == 1000.0
    assert caught.value.needed >= 8 * 42 * 24
    with pytest.raises(nls.ResourceLimitError):
        sample.graph.optimize(sample.values, linear_solver=solver)
    enough = SOLVERS[name](memory_limit=caught.value.needed)  # type: ignore[call-arg]
    enough.analyze(system.pattern)


@pytest.mark.parametrize(("name", "module", "function"), [("cholesky", "cholesky", "cholmod"), ("qr", "qr", "spqr")])
def test_a_missing_solver_says_how_it_is_installed(
    name: str, module: str, function: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.import_module(f"nls.linear.{module}"), function, lambda: None)
    sample = pose_graph(SE2)
    with pytest.raises(
        nls.MissingSolverError, match=rf"linear solver '{name}': .*apt-get install.*pip install"
    ) as caught:
        sample.graph.optimize(sample.values, linear_solver=SOLVERS[name]())
    assert isinstance(caught.value, ImportError)
    assert "pip install" in backends()[name]


def test_without_suitesparse_the_default_is_lu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.import_module("nls.linear.cholesky"), "cholmod", lambda: None)
    sample = pose_graph(SE3)
    assert default_solver().name == "lu"
    assert best_decomposition() is SuperLU
    assert backends()["default"] == "lu"
    result = sample.graph.optimize(sample.values)
    assert (result.linear_solver, result.converged) == ("lu", True)


def test_the_default_is_cholesky_where_it_is_installed() -> None:
    make("cholesky")
    sample = pose_graph(SE2)
    assert default_solver().name == backends()["default"] == "cholesky"
    assert sample.graph.optimize(sample.values).linear_solver == "cholesky"
    assert all(backends()[name] == "available" for name in ("cholesky", "lu", *DENSE))


@pytest.mark.parametrize("kind", DECOMPOSITIONS)
@for_all(graph=SAMPLES)
def test_upper_is_a_square_root_of_H(kind: type[Decomposition], graph: str) -> None:
    sample = SAMPLES[graph]()
    system = sample.graph.linearize(sample.values)
    state, S = factorized(kind, system)
    R_, order = state.upper()
    H = (system.A.T @ system.A).toarray()
    assert np.array_equal(np.sort(order), np.arange(len(H)))
    assert np.array_equal(np.triu(R_.toarray()), R_.toarray())
    np.testing.assert_allclose((R_.T @ R_).toarray(), H[np.ix_(order, order)], rtol=0, atol=1e-12 * np.abs(H).max())
    g = np.random.default_rng(0).normal(size=(len(H), 2))  # solving still works afterwards, and for many right sides
    np.testing.assert_allclose(H @ state.solve(g), g, rtol=0, atol=1e-8)
    state.factorize(S)
    np.testing.assert_allclose(H @ state.solve(g[:, 0]), g[:, 0], rtol=0, atol=1e-8)


@pytest.mark.parametrize("kind", DECOMPOSITIONS)
def test_factorizations_refuse_what_is_not_finite(kind: type[Decomposition]) -> None:
    sample = mixed(1)
    system = sample.graph.linearize(sample.values)
    state, S = factorized(kind, system)
    for entry in state.hessian.source[[0, -1]]:
        broken = S.copy()
        broken[entry] = np.nan
        with pytest.raises(SingularSystemError):
            state.factorize(broken)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_right_side_that_is_not_finite_gives_no_finite_step(name: str) -> None:
    """The model refuses such numbers before; a solver called directly must not invent an answer."""
    system = mixed(1).graph.linearize(mixed(1).values)
    b = system.b.copy()
    b[0] = np.nan
    try:
        dx = solve(name, LinearSystem(system.pattern, system.blocks, b))
    except (SingularSystemError, ValueError):
        return
    assert np.isnan(dx).any()


@pytest.mark.parametrize("kind", DECOMPOSITIONS)
def test_an_indefinite_matrix_is_no_normal_equation(kind: type[Decomposition]) -> None:
    """Simplicial LDL' factors one without complaint; its saddle point must not come out as a step."""
    sample = pose_graph(R(2), seed=3)
    system = sample.graph.linearize(sample.values)
    state, S = factorized(kind, system)
    where = state.hessian.source[state.hessian.indptr[5]]
    S[where] = -S[where]
    with pytest.raises(SingularSystemError):
        state.factorize(S)


def test_pinv_takes_a_tolerance() -> None:
    graph = FactorGraph([Prior(p[0], [1.0], Isotropic(1.0)), Prior(p[1], [1.0], Isotropic(1e4))])
    system = graph.linearize(Values({p: (R(1), [0.0, 0.0])}))
    assert solve("pinv", system).tolist() == pytest.approx([1.0, 1.0])
    coarse = Pinv(rtol=1e-3)
    assert coarse.analyze(system.pattern).solve(system).dx.tolist() == pytest.approx([1.0, 0.0])
