"""Damped steps: every linear solver gives the one of the dense formula, and what steps are judged by is right."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Factor, Huber
from models import SE2, R
from models.algebra import Array
from nls import Dogleg, FactorGraph, LevenbergMarquardt, LinearSystem, Values
from nls.linear import SOLVERS, LinearSolver
from nls.linear.cholesky import Cholmod
from nls.linear.lu import SuperLU
from nls.linear.singular import SingularSystemError
from nls.optimizers.problem import Problem
from nls.optimizers.undamped import FAINT, Undamped
from tests.combinations import for_all
from tests.nls.graphs import SAMPLES, diagonal, mixed, p, pose_graph

ALL = pytest.mark.parametrize("name", SOLVERS)


def make(name: str) -> LinearSolver:
    solver = SOLVERS[name]()
    if (why := solver.missing()) is not None:
        pytest.skip(f"{name}: {why}")
    return solver


def linearized(sample: str, robust: bool = False) -> LinearSystem:
    made = SAMPLES[sample]()
    return (made.graph.robust(Huber(0.5)) if robust else made.graph).linearize(made.values)


def dense(system: LinearSystem, damping: Array) -> Array:
    """(A'A + diag(damping))^-1 A'b."""
    A, b = system.A.toarray(), system.b
    return np.asarray(np.linalg.solve(A.T @ A + np.diag(damping), A.T @ b))


@ALL
@for_all(sample=SAMPLES, relative=[1e-6, 1e-2, 1.0, 1e4])
def test_every_solver_gives_the_step_of_the_formula(name: str, sample: str, relative: float) -> None:
    solver, system = make(name), linearized(sample, robust=relative == 1.0)
    damping = relative * diagonal(system) * np.random.default_rng(0).uniform(0.5, 2, system.pattern.n)
    before = [np.array(A_k) for A in system.blocks for A_k in A]
    analyzed = solver.analyze(system.pattern)
    dx = analyzed.solve(system, damping).dx
    expected = dense(system, damping)
    assert dx == pytest.approx(expected, rel=1e-7, abs=1e-9 * np.abs(expected).max())
    undamped = analyzed.solve(system).dx  # a damped solve leaves nothing behind
    assert undamped == pytest.approx(np.linalg.lstsq(*_dense(system))[0], abs=1e-7 * np.abs(undamped).max())
    assert all(np.array_equal(a, b) for a, b in zip(before, (A_k for A in system.blocks for A_k in A), strict=True))
    assert system.column_norms == pytest.approx(np.linalg.norm(system.A.toarray(), axis=0), rel=1e-12)


def _dense(system: LinearSystem) -> tuple[Array, Array]:
    return system.A.toarray(), system.b


@ALL
def test_no_damping_is_zero_damping(name: str) -> None:
    solver, system = make(name), linearized("mixed")
    analyzed = solver.analyze(system.pattern)
    plain, zero = analyzed.solve(system), analyzed.solve(system, np.zeros(system.pattern.n))
    assert zero.dx == pytest.approx(plain.dx, rel=1e-9, abs=1e-12)


@ALL
def test_damping_holds_what_is_free(name: str) -> None:
    """A pose graph that lies nowhere: refused without damping, a step of the same residuals with it."""
    sample = pose_graph(SE2, anchored=False)
    system = sample.graph.linearize(sample.values)
    solver = make(name)
    analyzed = solver.analyze(system.pattern)
    if name != "pinv":
        with pytest.raises(SingularSystemError):
            analyzed.solve(system)
    dx = analyzed.solve(system, 1e-7 * diagonal(system)).dx
    shortest = np.linalg.pinv(system.A.toarray()) @ system.b
    assert system.times(dx) == pytest.approx(system.times(shortest), abs=1e-4 * np.abs(system.b).max())
    assert np.abs(dx).max() < 10 * np.abs(shortest).max()


@pytest.mark.parametrize("kind", [Cholmod, SuperLU])
def test_the_diagonal_of_the_hessian(kind: type) -> None:
    if kind is Cholmod:
        make("cholesky")
    system = mixed(3, held=True).graph.linearize(mixed(3, held=True).values)
    hessian, S = system.pattern.hessian(kind.order), system.H_blocks.copy()  # type: ignore[attr-defined]
    damping = np.random.default_rng(1).uniform(1, 2, system.pattern.n)
    H = hessian.symmetric(S).toarray()
    hessian.damp(S, damping)
    moved = hessian.symmetric(S).toarray() - H
    assert moved == pytest.approx(np.diag(damping[hessian.permutation]), abs=1e-9 * np.abs(H).max())


@for_all(sample=SAMPLES)
def test_times_and_promised(sample: str) -> None:
    system = linearized(sample)
    A, b = _dense(system)
    dx = np.random.default_rng(2).normal(size=A.shape[1])
    assert system.times(dx) == pytest.approx(A @ dx, rel=1e-12, abs=1e-9)
    assert system.promised(dx) == pytest.approx(b @ b - np.square(A @ dx - b).sum(), rel=1e-9)
    best = np.linalg.lstsq(A, b)[0]
    assert system.promised(best) == pytest.approx(best @ system.gradient, rel=1e-6)
    assert all(system.promised(best * f) < system.promised(best) for f in (0.9, 1.1))


def test_columns_by_name() -> None:
    system = linearized("mixed, some fixed")
    for k, said in enumerate(system.cols):
        key, component = system.column(k)
        assert said == f"{key!r}: {component}"


def test_the_undamped_step_is_solved_once() -> None:
    sample = pose_graph(SE2)
    system = sample.graph.linearize(sample.values)

    class Counting(type(make("dense-qr"))):  # type: ignore[misc]
        solves = 0

        def least_squares(self, *args: object) -> object:
            type(self).solves += 1
            return super().least_squares(*args)

    undamped, D = Undamped(Problem(system.pattern, Counting())), system.column_norms
    for strict in (False, True):  # the faintest damping changes nothing, and each is solved once
        dx = [undamped.step(system, D, strict) for _ in range(2)]
        assert dx[0] is dx[1]
        assert dx[0] == pytest.approx(np.linalg.lstsq(*_dense(system))[0])
    assert undamped.free is None
    assert Counting.solves == 2


def test_the_damping_of_a_singular_system_is_the_least_that_works() -> None:
    sample = pose_graph(SE2, anchored=False)
    system = sample.graph.linearize(sample.values)
    undamped, D = Undamped(Problem(system.pattern, make("lu"))), system.column_norms
    dx = undamped.step(system, D)
    assert FAINT < undamped.damping < 1e-8
    assert undamped.free is None  # nobody asked
    undamped.step(system, D, strict=True)
    assert undamped.free is system
    shortest = np.linalg.pinv(system.A.toarray()) @ system.b
    assert system.times(dx) == pytest.approx(system.times(shortest), abs=1e-4 * np.abs(system.b).max())


def test_the_first_damping_falls_tenfold_from_system_to_system() -> None:
    sample = pose_graph(SE2)
    undamped, used = Undamped(Problem(sample.graph.linearize(sample.values).pattern, make("lu")), 1e-3), []
    for _ in range(14):
        system = sample.graph.linearize(sample.values)
        undamped.step(system, system.column_norms)
        used.append(undamped.damping)
    assert used == pytest.approx([max(10.0**-k, FAINT) for k in range(3, 17)], rel=1e-9)


@pytest.mark.parametrize(("angle", "free", "keeps"), [(1e-8, False, True), (1e-9, True, True), (0.0, True, False)])
def test_the_exact_step_keeps_a_direction_that_only_A_sees(angle: float, free: bool, keeps: bool) -> None:
    """Two columns at an angle whose square is lost in A'A; chi2 falls by 1 along one column, by 1 between them."""
    A = np.array([[1.0, 1.0], [0.0, angle], [0.0, 0.0]])
    factor = Factor.from_function(lambda X: X @ A.T - 1.0, p[0], dim=3, jacobians=lambda X: [A[None]])
    graph, values = FactorGraph([factor]), Values({p: (R(2), [[0.0, 0.0]])})
    system = graph.linearize(values)
    undamped = Undamped(Problem(system.pattern, make("lu")))
    dx = undamped.step(system, system.column_norms, strict=True)
    assert (undamped.free is not None) == free
    assert system.promised(dx) == pytest.approx(2.0 if keeps else 1.0, rel=1e-5)
    for optimizer in (Dogleg(), LevenbergMarquardt()):
        result = graph.optimize(values, optimizer)
        assert not result.converged or result.chi2_final == pytest.approx(1.0 if keeps else 2.0, rel=1e-5)
        assert result.converged or keeps
