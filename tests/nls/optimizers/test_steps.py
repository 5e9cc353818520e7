"""Gauss-Newton steps: with a kept factorization, which prove no more than others; undamped ones of damped methods."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from itertools import product

import numpy as np
import pytest

from factors import Factor
from models import SE2, SE3, LieGroup, R
from models.algebra import Array
from nls import Dogleg, FactorGraph, GaussNewton, LevenbergMarquardt, LinearSystem, Pinv, Status, Stop, Values
from nls.linear import default_solver
from nls.linear.factorization import SingularSystemError
from nls.optimizers.automatic import Reusing
from nls.optimizers.problem import FAINT, Problem, Undamped
from nls.sparse.pattern import Pattern
from tests.nls.graphs import distance, p, pose_graph, scalar, x
from tests.nls.solving import make

KEEPING = Reusing()


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_they_end_where_full_steps_end_with_fewer_factorizations(group: LieGroup) -> None:
    factorizations = steps = reused = 0
    for seed in range(3):
        sample = pose_graph(group, n=40, seed=seed, start=0.1)
        kept = sample.graph.optimize(sample.values, KEEPING)
        full = sample.graph.optimize(sample.values, GaussNewton())
        none = sample.graph.optimize(sample.values, KEEPING, linear_solver=Pinv())  # which keeps nothing
        default = sample.graph.optimize(sample.values)
        assert kept.converged
        assert full.converged
        assert kept.chi2_final == pytest.approx(full.chi2_final, rel=1e-6)
        assert distance(group, kept.values[x], full.values[x]) < 0.01
        factorizations += sum("factorize" in h.seconds for h in kept.history)
        steps += kept.iterations
        assert sum("factorize" in h.seconds for h in full.history) == full.iterations
        assert (kept.reused, full.reused, none.reused) == (sum(h.reused for h in kept.history), 0, 0)
        assert kept.iterations - kept.reused <= sum("factorize" in h.seconds for h in kept.history)
        assert (default.reused, default.iterations) == (kept.reused, kept.iterations)
        assert (f"{kept.reused} of {kept.iterations} steps reused" in str(kept)) == (kept.reused > 0)
        reused += kept.reused
    assert factorizations < steps
    assert reused > 0


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_a_point_near_the_optimum_takes_one_factorization(group: LieGroup) -> None:
    sample = pose_graph(group, n=40, start=0.1)
    optimum = sample.graph.optimize(sample.values).values
    near = optimum.retract(1e-5 * np.random.default_rng(1).normal(size=40 * group.dim))
    kept, full = (sample.graph.optimize(near, method) for method in (None, GaussNewton()))
    for result, count in ((kept, 1), (full, 2)):
        assert sum("factorize" in h.seconds for h in result.history) == count
        assert (result.converged, result.iterations) == (True, 2)
    assert kept.chi2_final == pytest.approx(full.chi2_final, rel=1e-12)
    assert distance(group, kept.values[x], full.values[x]) < 1e-8


def test_the_last_of_them_is_not_linearized(monkeypatch: pytest.MonkeyPatch) -> None:
    linearize, points = Problem.linearize, []

    def counted(problem: Problem, values: Values) -> LinearSystem:
        points.append(values)
        return linearize(problem, values)

    monkeypatch.setattr(Problem, "linearize", counted)
    sample = pose_graph(SE2, n=40, start=0.1)
    result = sample.graph.optimize(sample.values, KEEPING)
    assert (result.history[-1].reused, result.converged) == (True, True)
    assert len(points) == result.iterations


def test_a_step_above_the_best_point_is_not_converged() -> None:
    """A trap at x = 12 behind the minimum that was met on the way."""

    def residual(X: Array) -> Array:
        X = X[:, 0]
        left = X < 5
        trap = (X - 12) + 0.1 * (X - 12) ** 2
        return np.stack([np.where(left, 1 - 0.1 * X, 2.0), np.where(left, 0.0, trap)], axis=1)

    graph, start = scalar(residual, 0.0, dim=2)
    result = graph.optimize(start, KEEPING)
    assert result.status is Status.STALLED
    assert result.chi2_final == graph.chi2(result.values) == 1.0


def test_slow_convergence_is_followed_to_its_end() -> None:
    """Gauss-Newton shortens x by the factor -c from step to step: many small falls."""
    for c, optimizer in product((-0.8, -0.95), (GaussNewton, LevenbergMarquardt, Dogleg, Reusing)):
        residual = partial(lambda c, X: np.concatenate([X, 1 + c * X**2 / 2, 0 * X], axis=1), c)
        graph, start = scalar(residual, 0.5, dim=3)
        result = graph.optimize(start, optimizer(Stop(max_iterations=500)))
        assert (result.converged, result.rule) == (True, "update_sigmas")
        assert result.chi2_final - 1 < 2e-6
        assert np.abs(result.values[p[0]][0]) * abs(1 + c) ** 0.5 < 2e-3


@pytest.mark.parametrize("mid", [1.0, 1.2])
def test_an_unknown_that_is_let_go_on_the_way_is_not_overlooked(mid: float) -> None:
    """v is held at 0 until u has come below `mid`; then it can go to -100, which the old A'A would not allow."""

    def residual(X: Array) -> Array:
        u, v = X[:, 0], X[:, 1]
        hold = 1e4 / (1 + np.exp(-np.clip((u - mid) / 0.02, -500, 500)))
        return np.stack([3 * u, 1000 - 0.8 * 9 * u * u / 2000, 100 + v, hold * v], axis=1)

    graph, start = scalar(residual, [40.0, 0.0], dim=4)
    result = graph.optimize(start, KEEPING)
    assert result.converged
    assert result.values[p[0]][1] == pytest.approx(-100, abs=1e-3)
    assert result.chi2_final == pytest.approx(1e6, rel=2e-6)


def test_a_system_that_was_refused_is_refused_again() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(40, 12))
    A[:, 0] *= 1e-5
    A[:, 0] += A[:, 1]  # nearly the same twice, which gives a small pivot
    A[:, 5] = A[:, 6] + A[:, 7] - A[:, 8]  # and one direction that is free
    values = Values({p: (R(12), np.zeros(12))})
    factor = Factor.from_function(lambda X: X @ A.T, p[0], dim=40, jacobians=lambda X: [A[None]])
    pattern = Pattern([factor], values)
    state = default_solver().analyze(pattern)
    for _ in range(3):
        with pytest.raises(SingularSystemError):
            state.solve(LinearSystem.at(pattern, values))


INSIDE = """
from contextlib import contextmanager
import numpy as np, nls
from factors import Isotropic, Prior
from models import R
from nls.linear import cholesky
from nls.sparse import threads
seen, original = [], cholesky.single_thread
@contextmanager
def recorded():
    with original():
        seen.append(all(setting.get() == setting.inside for setting in threads._settings(threads._loaded())))
        yield
cholesky.single_thread = recorded
(p,) = nls.kinds("p")
graph = nls.FactorGraph([Prior(p[0], [1.0], Isotropic(1))])
for _ in range(2):
    graph.optimize(nls.Values({p: (R(1), [0.0])}), linear_solver=nls.Cholesky())
print(len(seen) > 2, all(seen))
"""


@pytest.mark.skipif(default_solver().name != "cholesky", reason="CHOLMOD is not installed")
def test_the_first_solve_of_a_process_takes_one_thread_too() -> None:
    """What is imported on first use brings its threads with it, inside a block that began before."""
    done = subprocess.run([sys.executable, "-c", INSIDE], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True True"


# ---- the undamped step of the damped methods


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
