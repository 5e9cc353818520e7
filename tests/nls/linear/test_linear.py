"""Linear solvers: each on each graph against numpy.linalg.lstsq; what is singular, too large or missing is refused."""

from __future__ import annotations

import importlib
from itertools import cycle, product

import numpy as np
import pytest
import scipy.sparse as sp

import nls
from factors import Between, Diagonal, Factor, Huber, Isotropic, Landmark, Prior, Range
from models import SE2, SE3, R
from models.algebra import Array
from nls import FactorGraph, LinearSystem, Values
from nls.linear import SOLVERS, Pinv, backends, best_decomposition, default_solver
from nls.linear.cholesky import cholmod
from nls.linear.dense import DENSE_COLUMNS, Lapack
from nls.linear.factorization import Decomposition, SingularSystemError
from nls.linear.lu import SuperLU
from nls.linear.updatable import Refactorized, Updated
from tests.nls.graphs import SAMPLES, diagonal, l, mixed, p, pose_graph, x
from tests.nls.solving import DECOMPOSITIONS, dense_step, factorized, make, near

DENSE = ("dense-qr", "dense-cholesky", "pinv")
ALL = pytest.mark.parametrize("name", SOLVERS)
REFUSING = pytest.mark.parametrize("name", [name for name in SOLVERS if name != "pinv"])


def solve(name: str, system: LinearSystem) -> Array:
    return make(name).analyze(system.pattern).solve(system).dx


def in_other_units(system: LinearSystem, variable: int, component: int, factor: float) -> LinearSystem:
    """The system with one column of A multiplied."""
    blocks = []
    for batch, A in zip(system.pattern.batches, system.blocks, strict=True):
        scaled = [np.array(A_k) for A_k in A]
        for numbers, A_k in zip(batch.variables, scaled, strict=True):
            A_k[numbers == variable, :, component] *= factor
        blocks.append(tuple(scaled))
    return LinearSystem(system.pattern, blocks, system.b)


@ALL
def test_every_solver_on_every_graph(name: str) -> None:
    """One analysis serves every linearization and damping of a graph, in any order; A stays as it is."""
    rng, tolerance = np.random.default_rng(0), 1e-7 if "pcg" in name else 1e-9
    for (label, create), relative in zip(SAMPLES.items(), cycle((1e-6, 1e-2, 1.0, 1e4)), strict=False):
        sample = create()
        graph = sample.graph.robust(Huber(0.5)) if relative == 1.0 else sample.graph
        first, second = graph.linearize(sample.values), graph.linearize(sample.truth)
        damping = relative * diagonal(first) * rng.uniform(0.5, 2, first.pattern.n)
        before = [np.array(A_k) for A in first.blocks for A_k in A]
        state = make(name).analyze(first.pattern)
        near(state.solve(first).dx, dense_step(first), 1e-9)
        for system, D in ((first, damping), (second, None), (first, 0 * damping), (second, damping), (first, None)):
            solution, expected = state.solve(system, D), dense_step(system, D)
            assert np.abs(solution.dx - expected).max() <= tolerance * np.abs(expected).max(), (label, relative)
            assert set(solution.seconds) <= {"assemble", "factorize", "solve"}
            assert min(solution.seconds.values()) >= 0
        assert all(np.array_equal(a, b) for a, b in zip(before, [A_k for A in first.blocks for A_k in A], strict=True))


def singular_graphs() -> list[FactorGraph]:
    """Relative measurements, and one heading; a pose without any; no heading measured; two components and one prior."""
    untouched = FactorGraph([Prior(x[k], [0.1, 0.2, 0.3], Isotropic(0.1)) for k in range(7)])
    few_rows = FactorGraph([Factor.from_function(lambda X: X[:, :2] - 1.0, x[0:8], 2)])
    apart = FactorGraph([Prior(x[0], [0.0, 0.0, 0.0], Isotropic(1))])
    for k in (0, 1, 2, 4, 5, 6):
        apart.add(Between(x[k], x[k + 1], [1.0, 0.1, 0.2], Isotropic(0.1)))
    relative, heading = (pose_graph(SE2, seed=7, anchored=False).graph for _ in range(2))
    heading.add(Prior(x[0], pose_graph(SE2, seed=7).values[x[0]], Isotropic(0.1), components=["yaw"]))
    return [relative, heading, untouched, few_rows, apart]


@ALL
def test_singular_systems_are_refused_or_solved_shortest_and_damping_holds_them(name: str) -> None:
    for graph, key in zip(singular_graphs(), ("x0", "x0", "x7", "x0", "x4"), strict=True):
        system = graph.linearize(pose_graph(SE2, seed=7).values)
        A = system.A.toarray()
        assert np.linalg.matrix_rank(A) < A.shape[1]
        shortest = np.linalg.lstsq(A, system.b, rcond=1e-12)[0]
        state = make(name).analyze(system.pattern)
        if name == "pinv":
            near(state.solve(system).dx, shortest, 1e-9)
        else:
            with pytest.raises(SingularSystemError):
                state.solve(system)
            with pytest.raises(nls.UnderconstrainedError, match=key):
                nls.gauss_newton_step(system, make(name))
        dx = state.solve(system, 1e-7 * diagonal(system)).dx
        np.testing.assert_allclose(A @ dx, A @ shortest, rtol=0, atol=1e-4 * np.abs(system.b).max())
        assert np.abs(dx).max() < 10 * np.abs(shortest).max()


@REFUSING
def test_rounding_does_not_hide_a_free_gauge(name: str) -> None:
    for seed, group in product(range(8), (R(2), SE2, SE3)):
        sample = pose_graph(group, seed=20 + seed, anchored=False, n=8 + seed)
        with pytest.raises(SingularSystemError):
            solve(name, sample.graph.linearize(sample.values))


@REFUSING
def test_units_make_no_system_singular_and_hide_no_free_direction(name: str) -> None:
    sample, free = pose_graph(SE2, seed=8), pose_graph(SE2, seed=8, anchored=False)
    system, loose = (s.graph.linearize(s.values) for s in (sample, free))
    for units in (1e8, 1e-8):
        expected = dense_step(system)
        expected[3 * 3 + 1] /= units
        np.testing.assert_allclose(solve(name, in_other_units(system, 3, 1, units)), expected, rtol=1e-8, atol=1e-10)
        with pytest.raises(SingularSystemError):
            solve(name, in_other_units(loose, 3, 1, units))


@ALL
def test_no_columns_give_no_step_and_no_number_gives_no_finite_step(name: str) -> None:
    """The model refuses b that is not finite; a solver called directly must not invent an answer."""
    sample = pose_graph(SE2)
    sample.graph.fix(x[0:8])
    assert solve(name, sample.graph.linearize(sample.values)).shape == (0,)
    system = mixed(1).graph.linearize(mixed(1).values)
    b = system.b.copy()
    b[0] = np.nan
    try:
        dx = solve(name, LinearSystem(system.pattern, system.blocks, b))
    except (SingularSystemError, ValueError):
        return
    assert np.isnan(dx).any()


def test_dense_solvers_refuse_before_taking_memory() -> None:
    sample = pose_graph(SE2)
    system = sample.graph.linearize(sample.values)
    for name in DENSE:
        solver = SOLVERS[name](memory_limit=1000.0)  # type: ignore[call-arg]
        with pytest.raises(nls.ResourceLimitError, match=rf"'{name}': a dense 42 x 24 system needs") as caught:
            solver.analyze(system.pattern)
        assert isinstance(caught.value, MemoryError)
        assert caught.value.limit == 1000.0
        assert caught.value.needed >= 8 * 42 * 24
        with pytest.raises(nls.ResourceLimitError):
            sample.graph.optimize(sample.values, linear_solver=solver)
        SOLVERS[name](memory_limit=caught.value.needed).analyze(system.pattern)  # type: ignore[call-arg]


@pytest.mark.parametrize(("name", "function"), [("cholesky", "cholmod"), ("qr", "spqr")])
def test_a_missing_solver_says_how_it_is_installed(name: str, function: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.import_module(f"nls.linear.{name}"), function, lambda: None)
    sample = pose_graph(SE2)
    with pytest.raises(nls.MissingSolverError, match=rf"'{name}': missing; pip install \"leadline") as caught:
        sample.graph.optimize(sample.values, linear_solver=SOLVERS[name]())
    assert isinstance(caught.value, ImportError)
    for how in ('pip install "leadline[', "apt-get", "dnf", "brew", "conda install -c conda-forge"):
        assert how in backends()[name]


def test_the_default_is_cholesky_and_without_suitesparse_lu(monkeypatch: pytest.MonkeyPatch) -> None:
    sample = pose_graph(SE3, n=30)
    if SOLVERS["cholesky"].missing() is None:
        assert default_solver().name == backends()["default"] == "cholesky"
        assert sample.graph.optimize(sample.values).linear_solver == "cholesky"
        assert all(backends()[name] == "available" for name in ("cholesky", "lu", *DENSE))
    monkeypatch.setattr(importlib.import_module("nls.linear.cholesky"), "cholmod", lambda: None)
    assert default_solver().name == backends()["default"] == "lu"
    assert best_decomposition() is best_decomposition(DENSE_COLUMNS + 1) is SuperLU
    result = sample.graph.optimize(sample.values)
    assert (result.linear_solver, result.converged) == ("lu", True)
    few = pose_graph(SE3)
    assert best_decomposition(DENSE_COLUMNS) is Lapack
    assert few.graph.optimize(few.values).linear_solver == "dense-cholesky"


@pytest.mark.parametrize("kind", DECOMPOSITIONS)
def test_upper_is_a_square_root_of_H(kind: type[Decomposition]) -> None:
    for name in ("R(1)", "SE3 odd ids", "mixed, some fixed"):
        sample = SAMPLES[name]()
        system = sample.graph.linearize(sample.values)
        state, S = factorized(kind, system), system.H_blocks
        R_, order = state.upper()
        H = (system.A.T @ system.A).toarray()
        assert np.array_equal(np.sort(order), np.arange(len(H)))
        assert np.array_equal(np.triu(R_.toarray()), R_.toarray())
        near((R_.T @ R_).toarray(), H[np.ix_(order, order)], 1e-12)
        g = np.random.default_rng(0).normal(size=(len(H), 2))  # solving still works afterwards
        np.testing.assert_allclose(H @ state.solve(g), g, rtol=0, atol=1e-8)
        state.factorize(S)
        np.testing.assert_allclose(H @ state.solve(g[:, 0]), g[:, 0], rtol=0, atol=1e-8)


@pytest.mark.parametrize("kind", DECOMPOSITIONS)
def test_factorizations_refuse_what_is_not_finite_or_indefinite(kind: type[Decomposition]) -> None:
    """Simplicial LDL' factors an indefinite matrix without complaint; its saddle must not come out as a step."""
    sample = pose_graph(R(2), seed=3)
    system = sample.graph.linearize(sample.values)
    state, S = factorized(kind, system), system.H_blocks
    first, pivot, last = state.hessian.source[[0, state.hessian.indptr[5], -1]]
    for entry, value in ((first, np.nan), (last, np.nan), (pivot, -S[pivot])):
        broken = S.copy()
        broken[entry] = value
        with pytest.raises(SingularSystemError):
            state.factorize(broken)


def test_pinv_takes_a_tolerance_and_names_what_it_leaves() -> None:
    """Nearly parallel columns: the difference of the two unknowns is measured by 1e-4 of their sum."""
    rows = np.array([[1.0, 1.0], [1e-4, -1e-4]])
    factor = Factor.from_function(lambda X: X @ rows.T - np.array([2.0, 2e-4]), p[0], 2)
    graph, values = FactorGraph([factor]), Values({p: (R(2), [0.0, 0.0])})
    system = graph.linearize(values)
    assert solve("pinv", system).tolist() == pytest.approx([2.0, 0.0])
    coarse = Pinv(rtol=1e-3)
    assert coarse.analyze(system.pattern).solve(system).dx.tolist() == pytest.approx([1.0, 1.0], abs=1e-7)
    result = graph.optimize(values, None, coarse)
    assert (result.underconstrained, result.dof) == (("p0: x, y",), 1)


# ---- units decide neither what is free nor where a solver arrives


SCALES = pytest.mark.parametrize("scale", [1e-6, 1e-3, 1.0, 1e3, 1e6])


def plane(scale: float, anchored: bool) -> tuple[FactorGraph, Values]:
    """Poses on a circle that see four points, lengths in units of so many meters."""
    rng, angle = np.random.default_rng(3), np.linspace(0, 5, 12)
    X = np.c_[4 * np.cos(angle), 4 * np.sin(angle), angle + np.pi / 2]
    L = np.array([[0.0, 1.0], [6.0, 1.0], [-6.0, 3.0], [1.0, -7.0]])
    meters = np.array([1 / scale, 1 / scale, 1.0])
    sigmas = np.array([0.05, 0.05, 0.01])
    i, j = np.repeat(np.arange(12), 4), np.tile(np.arange(4), 12)
    seen = SE2.act(SE2.inverse(X[i]), L[j]) + 0.05 * rng.normal(size=(48, 2))
    steps = SE2.between(X[:-1], X[1:]) + sigmas * rng.normal(size=(11, 3))
    graph = FactorGraph([Between(x[0:11], x[1:12], steps * meters, Diagonal(sigmas * meters))])
    graph.add(Landmark(x[i], l[j], seen / scale, Isotropic(0.05 / scale)))
    if anchored:
        graph.add(Prior(x[0], X[0] * meters, Diagonal(sigmas * meters)))
    start = SE2.retract(X, sigmas * rng.normal(size=X.shape))
    return graph, Values({x: (SE2, start * meters), l: (R(2), L / scale)})


@ALL
@SCALES
def test_units_of_length_change_nothing(name: str, scale: float) -> None:
    for anchored, gauge in ((True, "first"), (False, "first"), (False, "free")):
        graph, values = plane(scale, anchored)
        result = graph.optimize(values, linear_solver=make(name), gauge=gauge)
        reference = (lambda g, v: g.optimize(v))(*plane(1.0, anchored))
        assert result.converged
        assert (result.chi2_final, result.dof) == (pytest.approx(reference.chi2_final, rel=1e-6), reference.dof)
        assert result.underconstrained == ()
        if gauge == "first":
            found, expected = result.values[x][:, :2] * scale, reference.values[x][:, :2]
            np.testing.assert_allclose(found, expected, atol=1e-4)


def test_a_shortest_step_of_a_free_gauge_names_what_else_it_leaves() -> None:
    graph, values = plane(1.0, anchored=False)
    graph.add(Range(x[0], p[0], [3.0], Isotropic(0.1)))
    stacks = {kind: (stack.manifold, stack.X) for kind, stack in values.stacks.items()}
    result = graph.optimize(Values({**stacks, p: (R(2), [[9.0, 9.0]])}), None, Pinv(), gauge="free")
    assert (result.converged, result.underconstrained) == (True, ("p0: x, y",))
    assert result.dof == 11 * 3 + 96 + 1 - (36 - 3 + 8 + 1)


@SCALES
def test_a_heading_that_calls_itself_relative_is_refused(scale: float) -> None:
    graph, values = plane(scale, anchored=False)
    prior = Prior(x[3], values[x[3]], Isotropic(1.0), components=("yaw",))
    prior.relative = True  # type: ignore[misc]
    graph.add(prior)
    with pytest.raises(nls.UnderconstrainedError):
        graph.optimize(values, gauge="free")


# ---- factorizations that take new rows


both = pytest.mark.parametrize("kind", [Updated, Refactorized] if cholmod() else [Refactorized])


@both
def test_rows_are_added(kind: type[Updated | Refactorized]) -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(12, 8)) * (rng.random((12, 8)) < 0.4) + np.eye(12, 8)
    H = A.T @ A
    factor, g = kind(sp.csc_matrix(np.tril(H))), rng.normal(size=8)
    np.testing.assert_allclose(factor.solve(g), np.linalg.solve(H, g), rtol=1e-9)
    for _ in range(3):
        C = np.zeros((8, 2))
        C[rng.choice(8, 3, replace=False)] = rng.normal(size=(3, 2))
        factor.add(sp.csc_matrix(C))
        H = H + C @ C.T
        np.testing.assert_allclose(factor.solve(g), np.linalg.solve(H, g), rtol=1e-8)


@both
def test_a_dense_matrix_takes_rows_and_is_refused_where_a_pivot_vanishes(kind: type[Updated | Refactorized]) -> None:
    """CHOLMOD factorizes it by supernodes first."""
    rng = np.random.default_rng(1)
    A, C, g = rng.normal(size=(300, 200)), rng.normal(size=(200, 3)), rng.normal(size=200)
    H = A.T @ A
    factor = kind(sp.csc_matrix(np.tril(H)))
    np.testing.assert_allclose(factor.solve(g), np.linalg.solve(H, g), rtol=1e-8)
    factor.add(sp.csc_matrix(C))
    np.testing.assert_allclose(factor.solve(g), np.linalg.solve(H + C @ C.T, g), rtol=1e-8)
    A[:, 150] = A[:, 3]
    with pytest.raises(SingularSystemError):
        kind(sp.csc_matrix(np.tril(A.T @ A)))


@both
def test_what_is_not_positive_definite_is_refused(kind: type[Updated | Refactorized]) -> None:
    for H in (np.zeros((2, 2)), np.array([[1.0, 1.0], [1.0, 1.0]]), np.diag([1.0, -1.0])):
        with pytest.raises(SingularSystemError):
            kind(sp.csc_matrix(np.tril(H)))
