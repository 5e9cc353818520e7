"""The undamped step of the damped methods, the promise of a linear system, and the damping of a singular one."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Factor
from models import SE2, R
from nls import Dogleg, FactorGraph, LevenbergMarquardt, Values
from nls.optimizers.problem import FAINT, Problem, Undamped
from tests.nls.graphs import SAMPLES, p, pose_graph
from tests.nls.solving import dense_step, make


def test_times_and_promised() -> None:
    for name in ("R(1)", "SE3 odd ids", "mixed, some fixed"):
        sample = SAMPLES[name]()
        system = sample.graph.linearize(sample.values)
        A, b, best = system.A.toarray(), system.b, dense_step(system)
        dx = np.random.default_rng(2).normal(size=A.shape[1])
        assert system.times(dx) == pytest.approx(A @ dx, rel=1e-12, abs=1e-9)
        assert system.promised(dx) == pytest.approx(b @ b - np.square(A @ dx - b).sum(), rel=1e-9)
        assert system.promised(best) == pytest.approx(best @ system.gradient, rel=1e-6)
        assert all(system.promised(best * f) < system.promised(best) for f in (0.9, 1.1))


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
        assert dx[0] == pytest.approx(dense_step(system))
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
