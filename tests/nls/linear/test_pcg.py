"""`cholesky-pcg`: the step of the current system to its tolerance, few factorizations, no free direction overlooked."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import sim
from factors import Cauchy, Isotropic, Prior
from models import SE2, SE3
from models.algebra import Array
from nls import FactorGraph, GaussNewton, LevenbergMarquardt, LinearSystem, Marginals, OptionError, Stop, Values
from nls.linear import Cholesky, CholeskyPCG
from nls.linear.pcg import KeptFactorization
from nls.linear.singular import SingularSystemError
from tests.nls.graphs import diagonal, pose_graph, x

pytestmark = pytest.mark.skipif(CholeskyPCG.missing() is not None, reason=str(CholeskyPCG.missing()))
MANY = 60


def city(n: int = 400) -> tuple[FactorGraph, Values, Values]:
    """A world whose first pose is fixed, its optimum, and a point near it."""
    world = sim.manhattan(np.random.default_rng(3), n_poses=n)
    graph: FactorGraph = world.graph
    graph.fix(x[0])
    best = graph.optimize(world.truth, linear_solver=Cholesky()).values
    near = Values({x: (SE2, SE2.retract(best[x], 0.003 * np.random.default_rng(4).normal(size=(n, 3))))})
    return graph, best, near


def error(H: Array, M: Array, g: Array, dx: Array) -> float:
    """|H dx - g| / |g| in the norm of the kept matrix."""
    r = H @ dx - g
    return float(np.sqrt(r @ np.linalg.solve(M, r)) / np.sqrt(g @ np.linalg.solve(M, g)))


def dense(system: LinearSystem, damping: Array | None = None) -> Array:
    A = system.A.toarray()
    return np.asarray(A.T @ A + np.diag(np.zeros(A.shape[1]) if damping is None else damping))


@pytest.mark.parametrize("tol", [1e-2, 1e-4, 1e-6, 1e-9])
@pytest.mark.parametrize("damped", [False, True])
def test_the_step_solves_the_current_system_to_the_tolerance(tol: float, damped: bool) -> None:
    graph, best, near = city(150)
    old, new = graph.linearize(best), graph.linearize(near)
    solver = CholeskyPCG(tol, MANY)
    analyzed = solver.analyze(old.pattern)
    before, after = (0.1 * diagonal(old), 0.05 * diagonal(new)) if damped else (None, None)
    analyzed.solve(old, before)
    dx = analyzed.solve(new, after).dx
    assert analyzed.description.startswith("cholesky-pcg, 1 factorization, ")
    M, H = dense(old, before), dense(new, after)
    assert error(H, M, new.gradient, dx) <= tol * (1 + 1e-3)
    stale: Array = np.asarray(np.linalg.solve(M, new.gradient), dtype=np.float64)
    assert error(H, M, new.gradient, stale) > 1e-2  # the old system's step is another one
    assert new.column_norms == pytest.approx(np.linalg.norm(new.A.toarray(), axis=0), rel=1e-12)


def test_steps_grow_with_the_tolerance_and_are_counted() -> None:
    graph, best, near = city()
    counts = []
    for tol in (1e-2, 1e-5, 1e-8):
        solver = CholeskyPCG(tol, MANY)
        analyzed = solver.analyze(graph.linearize(best).pattern)
        for values in (best, near):
            analyzed.solve(graph.linearize(values))
        kept = analyzed.factorization
        assert isinstance(kept, KeptFactorization)
        assert kept.factorizations == 1
        counts.append(kept.steps)
    assert 0 < counts[0] < counts[1] < counts[2] < MANY


def test_where_it_will_not_do_it_factorizes_and_says_so() -> None:
    graph, best, near = city()
    solver, exact = CholeskyPCG(1e-9, 2), Cholesky()
    system = graph.linearize(near)
    analyzed = solver.analyze(system.pattern)
    analyzed.solve(graph.linearize(best))
    found = analyzed.solve(system)
    assert re.fullmatch(r"cholesky-pcg, 2 factorizations, [12] CG steps?", analyzed.description)
    assert np.array_equal(found.dx, exact.analyze(system.pattern).solve(system).dx)
    assert found.seconds["factorize"] > 0
    analyzed.solve(graph.linearize(near))  # the new factorization is the one that is kept
    assert analyzed.description.startswith("cholesky-pcg, 2 factorizations")


def robbed(system: LinearSystem, poses: range) -> LinearSystem:
    """The system in which nothing joins these poses to the others any more: they move together, free."""
    blocks = []
    for batch, A in zip(system.pattern.batches, system.blocks, strict=True):
        inside = [np.isin(variables, poses) for variables in batch.variables]
        across = np.logical_xor.reduce(inside) if len(inside) == 2 else inside[0]
        blocks.append(tuple(np.where(across[:, None, None], 0.0, A_k) for A_k in A))
    return LinearSystem(system.pattern, blocks, system.b)


@pytest.mark.parametrize("part", [range(100, 101), range(60, 90), range(200, 400)])
@pytest.mark.parametrize("max_steps", [6, 1000])
def test_a_direction_that_became_free_is_refused(part: range, max_steps: int) -> None:
    """A'b has no part along it, so conjugate gradients on g alone would return a step."""
    graph, best, _ = city()
    system = graph.linearize(best)
    solver = CholeskyPCG(1e-6, max_steps)
    analyzed = solver.analyze(system.pattern)
    analyzed.solve(system)
    loose = robbed(system, part)
    for _ in range(2):  # and the failed factorization is not used afterwards
        with pytest.raises(SingularSystemError):
            analyzed.solve(loose)
    again = analyzed.solve(system).dx
    assert dense(system) @ again == pytest.approx(system.gradient, abs=1e-6 * np.abs(system.gradient).max())


@pytest.mark.parametrize("faint", [1e-3, 1e-5])
def test_damping_in_the_kept_factorization_hides_nothing(faint: float) -> None:
    """What Levenberg-Marquardt asks at its end: damped solves, then one without."""
    sample = pose_graph(SE3, anchored=False, n=40)
    system = sample.graph.linearize(sample.values)
    solver = CholeskyPCG(1e-6, 1000)
    analyzed = solver.analyze(system.pattern)
    analyzed.solve(system, faint * diagonal(system))
    with pytest.raises(SingularSystemError):
        analyzed.solve(system)


def test_asked_for_itself_the_factorization_is_the_current_one() -> None:
    """Marginals and the free gauge solve with the state: never with an old factorization."""
    graph, best, near = city(100)
    solver = CholeskyPCG(1e-6, MANY)
    systems = [graph.linearize(values) for values in (best, near)]
    analyzed = solver.analyze(systems[0].pattern)
    H = dense(systems[1])
    g = np.random.default_rng(1).normal(size=(len(H), 3))
    for ask in ("solve", "lower", "upper"):
        for system in systems:
            analyzed.solve(system)
        state = analyzed.factorization
        if ask == "solve":
            assert H @ state.solve(g) == pytest.approx(g, abs=1e-6)
        else:
            L, p = getattr(state, ask)()
            square = (L @ L.T if ask == "lower" else L.T @ L).toarray()
            assert square == pytest.approx(H[np.ix_(p, p)], rel=0, abs=1e-9 * np.abs(H).max())
        analyzed.solve(systems[0])


@pytest.mark.parametrize("gauge", ["first", "prior", "free"])
def test_the_same_optimum_and_covariance(gauge: str) -> None:
    world = sim.manhattan(np.random.default_rng(5), n_poses=300)
    graph = world.graph
    start = world.truth
    tight = GaussNewton(Stop(max_iterations=50))
    one, two = (graph.optimize(start, tight, solver, gauge) for solver in (Cholesky(), CholeskyPCG()))
    assert one.converged
    assert two.converged
    assert two.chi2_final == pytest.approx(one.chi2_final, rel=1e-9)
    assert two.iterations <= one.iterations + 1
    mine, theirs = (Marginals(graph, one.values, s, gauge).all(x, frame="body") for s in (CholeskyPCG(), Cholesky()))
    assert np.array_equal(mine, theirs)


def test_damped_and_robust_iterations_need_few_factorizations() -> None:
    graph, _, near = city()
    tight = Stop(max_iterations=300, chi2_rtol=1e-13, update_tol=1e-9)
    for optimizer in (GaussNewton(tight), LevenbergMarquardt(tight)):
        made: list[Any] = []

        class Watched(CholeskyPCG):
            def analyze(self, pattern, made=made):  # type: ignore[no-untyped-def]
                made.append(super().analyze(pattern))
                return made[-1]

        robust = graph.robust(Cauchy(0.5))
        result = robust.optimize(near, optimizer, Watched())
        expected = robust.optimize(near, optimizer, Cholesky())
        assert result.status is expected.status
        assert result.chi2_final == pytest.approx(expected.chi2_final, rel=1e-8)
        assert made[0].factorization.factorizations < expected.iterations


@pytest.mark.parametrize(("option", "wrong"), [("tol", [0, 1, -1e-3, True, "x", None]), ("max_steps", [0, 2.5, True])])
def test_options_that_are_not_possible(option: str, wrong: list[object]) -> None:
    for value in wrong:
        with pytest.raises(OptionError, match=f"{option}: .* is not possible"):
            CholeskyPCG(**{option: value})  # type: ignore[arg-type]


def test_one_prior_is_one_step() -> None:
    graph = FactorGraph([Prior(x[0], [1.0, 2.0, 0.3], Isotropic(0.1))])
    result = graph.optimize(Values({x: (SE2, [0.0, 0.0, 0.0])}), linear_solver=CholeskyPCG())
    assert result.converged
    assert result.values[x[0]] == pytest.approx([1.0, 2.0, 0.3])
