"""`pcg`: the step of Cholesky to its tolerance, what is free refused, and no step where it does not arrive."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import nls
from factors import Isotropic, Landmark, Prior
from factors.bundle import CAMERA, LENS, BundleProjection
from models import SE2, SE3, R
from nls import PCG, Dogleg, FactorGraph, GaussNewton, LevenbergMarquardt, LinearSystem, Schur, Stop, Values
from nls.linear.factorization import SingularSystemError, UnsolvedSystemError
from nls.linear.schur.pcg import PCGDecomposition, conjugate
from nls.linear.underconstrained import underconstrained
from tests.nls.graphs import Sample, diagonal, pose_graph
from tests.nls.landmarks import l, landmarks, reference, same, seen_by_range, step, x
from tests.nls.solving import near

c, k = nls.kinds("c", "k")


@cache
def bundle(cameras: int = 8, points: int = 60, seed: int = 0) -> Sample:
    """Cameras with their own lenses around a cloud of points, each seen by four to all of them; the gauge is fixed."""
    rng = np.random.default_rng(seed)
    turn = np.array([0.0, 2 * np.pi, 0.0]) * np.arange(cameras)[:, None] / cameras / 3
    C = np.hstack([turn, 0.2 * rng.normal(size=(cameras, 3)) - [0, 0, 8]])
    K = np.tile([500.0, -0.1, 0.02], (cameras, 1))
    P = rng.normal(size=(points, 3))
    views = [np.sort(rng.permutation(cameras)[: 4 + j % (cameras - 3)]) for j in range(points)]
    i, j = np.concatenate(views), np.repeat(np.arange(points), [*map(len, views)])
    true = Values({c: (CAMERA, C), k: (LENS, K), l: (R(3), P)})
    ideal = BundleProjection(c[i], k[i], l[j], np.zeros((len(i), 2)), Isotropic(1.0))
    model, X = true.gather(ideal)
    z = -model.error(*X) + 0.3 * rng.normal(size=(len(i), 2))
    graph = FactorGraph([BundleProjection(c[i], k[i], l[j], z, Isotropic(1.0))])
    graph.add(Prior(l[[0, 1, 2]], P[:3], Isotropic(1e-3)))
    start = Values({c: (CAMERA, C + 0.01 * rng.normal(size=C.shape)), k: (LENS, K), l: (R(3), P)})
    return Sample(graph, start, true)


# ---- the step


def test_the_tolerance_is_in_the_norm_of_the_preconditioner() -> None:
    sample = bundle()
    system = sample.graph.linearize(sample.values)
    p, n = PCG().analyze(system.pattern).factorization.hessian.permutation, 3 * 60
    H, g = system.H.toarray()[np.ix_(p, p)], system.gradient[p]
    S = H[n:, n:] - H[n:, :n] @ np.linalg.solve(H[:n, :n], H[:n, n:])
    g_S = g[n:] - H[n:, :n] @ np.linalg.solve(H[:n, :n], g[:n])
    M = np.where(np.kron(np.eye(8), np.ones((9, 9))) > 0, S, 0.0)  # one block for a camera and its lens
    for tol in (1e-1, 1e-3, 1e-6, 1e-9):
        dx = step(PCG(tol), system)[p]
        r = g_S - S @ dx[n:]
        assert np.sqrt(r @ np.linalg.solve(M, r)) <= 1.001 * tol * np.sqrt(g_S @ np.linalg.solve(M, g_S))
        near(dx[:n], np.linalg.solve(H[:n, :n], g[:n] - H[:n, n:] @ dx[n:]), 1e-9)


def test_the_lens_in_the_block_of_its_camera_saves_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    sample = bundle(cameras=12, points=200, seed=3)
    system = sample.graph.linearize(sample.values)

    def steps() -> int:
        analyzed = PCG(1e-6).analyze(system.pattern)
        analyzed.solve(system, 1e-4 * diagonal(system))
        assert isinstance(analyzed.factorization.decomposition, PCGDecomposition)
        return analyzed.factorization.decomposition.steps

    together = steps()
    monkeypatch.setattr("nls.linear.schur.pcg.twins", lambda pattern, blocks, gone: np.arange(len(gone)))
    assert 0 < together < 0.8 * steps()
    near(step(Schur(), system), step(reference(), system), 1e-8)


# ---- whole optimizations


def test_a_bundle_and_a_pose_graph() -> None:
    for sample, optimizer in ((bundle(), LevenbergMarquardt()), (pose_graph(SE3, n=30), Dogleg())):
        one, two = (sample.graph.optimize(sample.values, optimizer, solver) for solver in (reference(), PCG()))
        assert two.converged
        assert two.chi2_final == pytest.approx(one.chi2_final, rel=1e-9)
        assert two.status is one.status


def test_coarse_steps_are_enough_for_levenberg_marquardt() -> None:
    sample = bundle()
    assert (PCG(0.1).exact, PCG().exact) == (False, True)
    best, coarse = (sample.graph.optimize(sample.values, LevenbergMarquardt(), s) for s in (reference(), PCG(0.1)))
    assert coarse.converged
    assert coarse.chi2_final == pytest.approx(best.chi2_final, rel=1e-4)


# ---- what is free, and what does not arrive


def test_levenberg_marquardt_says_what_is_free() -> None:
    sample = bundle(seed=4)
    graph = FactorGraph([sample.graph.factors[0]])
    one, two = (graph.optimize(sample.values, linear_solver=s) for s in (Schur(), PCG()))
    assert two.converged
    assert two.chi2_final == pytest.approx(one.chi2_final, rel=1e-7)
    assert len(two.underconstrained) == len(one.underconstrained) == 1


def test_a_gauge_and_a_scale_are_seen() -> None:
    """A'b has no part along them: conjugate gradients on it alone would return a step."""
    for anchors in ([], [0], [0, 1]):
        sample = bundle(cameras=5, points=40, seed=4)
        P = sample.truth[l][anchors]
        graph = FactorGraph([sample.graph.factors[0]])
        if anchors:
            graph.add(Prior(l[anchors], P, Isotropic(1e-3)))
        system = graph.linearize(sample.values)
        for solver in (PCG(), PCG(1e-2)):
            with pytest.raises(SingularSystemError, match="no measurement determines"):
                step(solver, system)
        with pytest.raises(nls.UnderconstrainedError, match=rf"leave {7 - min(3 * len(anchors), 6)} direction"):
            nls.gauss_newton_step(system, PCG())


def test_a_gauge_met_head_on_is_seen() -> None:
    """With so few unknowns a direction of the iteration itself is free, and ends it before a step goes along it."""
    for group, n, k, seed in ((SE2, 2, 2, 1), (SE2, 4, 4, 2), (SE3, 2, 4, 0), (SE3, 3, 1, 3)):
        sample = landmarks(group, n=n, k=k, seed=seed, anchored=False)
        with pytest.raises(SingularSystemError, match="no measurement determines"):
            step(PCG(), sample.graph.linearize(sample.values))


def test_too_few_views_are_refused() -> None:
    """Of a landmark; and of a pose: landmarks seen once, by nothing else, leave rounding of its block of S."""
    for views in ((0,), (0, 0)):
        sample = seen_by_range(*views)
        with pytest.raises(SingularSystemError):
            step(PCG(), sample.graph.linearize(sample.values))
    same(seen_by_range(0, 5, 9).graph.linearize(sample.values), solver=PCG())
    rng = np.random.default_rng(0)
    graph = FactorGraph([Landmark(x[[0] * 4], l[[0, 1, 2, 3]], rng.normal(size=(4, 3)), Isotropic(0.1))])
    values = Values({x: (SE3, SE3.exp(rng.normal(size=(1, 6)))), l: (R(3), rng.normal(size=(4, 3)))})
    with pytest.raises(SingularSystemError):
        step(PCG(), graph.linearize(values))


def test_too_few_steps_are_no_step() -> None:
    sample = bundle()
    system = sample.graph.linearize(sample.values)
    with pytest.raises(UnsolvedSystemError, match="did not reach tol = 1e-10 in 3 steps; allow more with max_steps"):
        step(PCG(max_steps=3), system, 1e-6 * diagonal(system))
    with pytest.raises(UnsolvedSystemError, match="in 3 steps, while looking for free directions"):
        step(PCG(max_steps=3), system)
    with pytest.raises(nls.UnderconstrainedError):
        sample.graph.optimize(sample.values, GaussNewton(), PCG(max_steps=3))
    said = underconstrained(system, sample.values, UnsolvedSystemError("did not reach tol"))
    assert (str(said), said.values) == ("did not reach tol", sample.values)


def test_numbers_that_are_not_finite_are_no_step() -> None:
    sample = bundle()
    system = sample.graph.linearize(sample.values)
    b = system.b.copy()
    b[5] = np.nan
    with pytest.raises(SingularSystemError):
        step(PCG(), LinearSystem(system.pattern, system.blocks, b), 0.1 * diagonal(system))
    solution = conjugate(lambda P: P, lambda R: R, np.array([1.0, np.nan]), lambda first: np.inf, 9)
    assert not solution.converged
    flat = conjugate(lambda P: P * [1.0, 0.0], lambda R: R, np.array([0.0, 1.0]), lambda first: 1e-9 * first, 9)
    assert (flat.converged, flat.steps) == (False, 1)  # along a direction in which H is exactly 0


@pytest.mark.parametrize(("option", "wrong"), [("tol", [0, 1, -1e-3, True, "x", None]), ("max_steps", [0, 2.5, True])])
def test_options_that_are_not_possible(option: str, wrong: list[object]) -> None:
    for value in wrong:
        with pytest.raises(nls.OptionError, match=f"{option}: .* is not possible"):
            PCG(**{option: value})  # type: ignore[arg-type]


def test_levenberg_marquardt_damps_more_where_steps_do_not_arrive() -> None:
    """With strong damping S is nearly M, and a few steps do."""
    sample = bundle()
    damped = LevenbergMarquardt(Stop(max_iterations=1), damping=1e-6)
    result = sample.graph.optimize(sample.values, damped, PCG(1e-6, max_steps=12))
    assert result.history[1].damping > 1e-4
