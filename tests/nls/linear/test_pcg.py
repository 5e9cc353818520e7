"""`cholesky-pcg`: the step of the current system to its tolerance, few factorizations, no free direction overlooked."""

from __future__ import annotations

import re
from functools import cache

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
from tests.nls.solving import near

pytestmark = pytest.mark.skipif(CholeskyPCG.missing() is not None, reason=str(CholeskyPCG.missing()))
MANY = 60


@cache
def city(n: int) -> tuple[FactorGraph, Values, Values]:
    """A world whose first pose is fixed, its optimum, and a point near it."""
    world = sim.manhattan(np.random.default_rng(3), n_poses=n)
    graph: FactorGraph = world.graph
    graph.fix(x[0])
    best = graph.optimize(world.truth, linear_solver=Cholesky()).values
    beside = Values({x: (SE2, SE2.retract(best[x], 0.003 * np.random.default_rng(4).normal(size=(n, 3))))})
    return graph, best, beside


def error(H: Array, M: Array, g: Array, dx: Array) -> float:
    """|H dx - g| / |g| in the norm of the kept matrix."""
    r = H @ dx - g
    return float(np.sqrt(r @ np.linalg.solve(M, r)) / np.sqrt(g @ np.linalg.solve(M, g)))


def dense(system: LinearSystem, damping: Array | None = None) -> Array:
    A = system.A.toarray()
    return np.asarray(A.T @ A + np.diag(np.zeros(A.shape[1]) if damping is None else damping))


@pytest.mark.parametrize("damped", [False, True])
def test_the_step_solves_the_current_system_to_the_tolerance(damped: bool) -> None:
    graph, best, beside = city(100)
    old, new = graph.linearize(best), graph.linearize(beside)
    before, after = (0.1 * diagonal(old), 0.05 * diagonal(new)) if damped else (None, None)
    M, H = dense(old, before), dense(new, after)
    stale = np.asarray(np.linalg.solve(M, new.gradient))
    assert error(H, M, new.gradient, stale) > 1e-2  # the old system's step is another one
    counts = []
    for tol in (1e-2, 1e-5, 1e-8):
        analyzed = CholeskyPCG(tol, MANY).analyze(old.pattern)
        analyzed.solve(old, before)
        dx = analyzed.solve(new, after).dx
        assert analyzed.description.startswith("cholesky-pcg, 1 factorization, ")
        assert error(H, M, new.gradient, dx) <= tol * (1 + 1e-3)
        kept = analyzed.factorization
        assert isinstance(kept, KeptFactorization)
        counts.append(kept.steps)
    assert 0 < counts[0] < counts[1] < counts[2] < MANY


def test_where_it_will_not_do_it_factorizes_and_says_so() -> None:
    graph, best, beside = city(100)
    system = graph.linearize(beside)
    analyzed = CholeskyPCG(1e-9, 2).analyze(system.pattern)
    analyzed.solve(graph.linearize(best))
    solution = analyzed.solve(system)
    assert re.fullmatch(r"cholesky-pcg, 2 factorizations, [12] CG steps?", analyzed.description)
    assert np.array_equal(solution.dx, Cholesky().analyze(system.pattern).solve(system).dx)
    assert solution.seconds["factorize"] > 0
    analyzed.solve(graph.linearize(beside))  # the new factorization is the one that is kept
    assert analyzed.description.startswith("cholesky-pcg, 2 factorizations")


def robbed(system: LinearSystem, poses: range) -> LinearSystem:
    """The system in which nothing joins these poses to the others any more: they move together, free."""
    blocks = []
    for batch, A in zip(system.pattern.batches, system.blocks, strict=True):
        inside = [np.isin(variables, poses) for variables in batch.variables]
        across = np.logical_xor.reduce(inside) if len(inside) == 2 else inside[0]
        blocks.append(tuple(np.where(across[:, None, None], 0.0, A_k) for A_k in A))
    return LinearSystem(system.pattern, blocks, system.b)


@pytest.mark.parametrize("max_steps", [6, 1000])
def test_a_direction_that_became_free_is_refused(max_steps: int) -> None:
    """A'b has no part along it, so conjugate gradients on g alone would return a step."""
    graph, best, _ = city(400)
    system = graph.linearize(best)
    for free in (range(100, 101), range(60, 90), range(200, 400)):
        analyzed = CholeskyPCG(1e-6, max_steps).analyze(system.pattern)
        analyzed.solve(system)
        loose = robbed(system, free)
        for _ in range(2):  # and the failed factorization is not used afterwards
            with pytest.raises(SingularSystemError):
                analyzed.solve(loose)
        near(system.H @ analyzed.solve(system).dx, system.gradient, 1e-6)


@pytest.mark.parametrize("faint", [1e-3, 1e-5])
def test_damping_in_the_kept_factorization_hides_nothing(faint: float) -> None:
    """What Levenberg-Marquardt asks at its end: damped solves, then one without."""
    sample = pose_graph(SE3, anchored=False, n=40)
    system = sample.graph.linearize(sample.values)
    analyzed = CholeskyPCG(1e-6, 1000).analyze(system.pattern)
    analyzed.solve(system, faint * diagonal(system))
    with pytest.raises(SingularSystemError):
        analyzed.solve(system)


def test_asked_for_itself_the_factorization_is_the_current_one() -> None:
    """Marginals and the free gauge solve with the state: never with an old factorization."""
    graph, best, beside = city(100)
    systems = [graph.linearize(values) for values in (best, beside)]
    analyzed = CholeskyPCG(1e-6, MANY).analyze(systems[0].pattern)
    H = dense(systems[1])
    g = np.random.default_rng(1).normal(size=(len(H), 3))
    for ask in ("solve", "lower", "upper"):
        for system in systems:
            analyzed.solve(system)
        state = analyzed.factorization
        if ask == "solve":
            np.testing.assert_allclose(H @ state.solve(g), g, rtol=0, atol=1e-6)
        else:
            L, order = getattr(state, ask)()
            near((L @ L.T if ask == "lower" else L.T @ L).toarray(), H[np.ix_(order, order)], 1e-9)
        analyzed.solve(systems[0])


@pytest.mark.parametrize("gauge", ["first", "prior", "free"])
def test_the_same_optimum_and_covariance(gauge: str) -> None:
    world = sim.manhattan(np.random.default_rng(5), n_poses=150)
    graph = world.graph
    tight = GaussNewton(Stop(max_iterations=50))
    one, two = (graph.optimize(world.truth, tight, solver, gauge) for solver in (Cholesky(), CholeskyPCG()))
    assert one.converged
    assert two.converged
    assert two.chi2_final == pytest.approx(one.chi2_final, rel=1e-9)
    assert two.iterations <= one.iterations + 1
    mine, theirs = (Marginals(graph, one.values, s, gauge).all(x, frame="body") for s in (CholeskyPCG(), Cholesky()))
    assert np.array_equal(mine, theirs)


def test_damped_and_robust_iterations_need_few_factorizations() -> None:
    graph, _, beside = city(100)
    tight = Stop(max_iterations=300, chi2_rtol=1e-12, update_tol=1e-8)
    robust = graph.robust(Cauchy(0.5))
    for optimizer in (GaussNewton(tight), LevenbergMarquardt(tight)):
        result = robust.optimize(beside, optimizer, CholeskyPCG())
        expected = robust.optimize(beside, optimizer, Cholesky())
        assert result.status is expected.status
        assert result.chi2_final == pytest.approx(expected.chi2_final, rel=1e-8)
        factorizations = int(result.linear_solver.split(", ")[1].split()[0])
        assert 0 < factorizations < expected.iterations


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
