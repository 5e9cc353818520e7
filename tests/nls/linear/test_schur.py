"""`schur`, and `pcg` where it promises the same: the step of Cholesky on graphs of landmarks; other inverses."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Huber, Isotropic, Landmark, Prior
from models import SE2, SE3, R
from models.algebra import Array
from nls import PCG, FactorGraph, GaussNewton, LevenbergMarquardt, Schur, Values
from nls.linear import LU, LinearSolver
from nls.linear.factorization import SingularSystemError
from nls.linear.schur.solver import SchurDecomposition
from tests.nls.graphs import Sample, diagonal, mixed, pose_graph
from tests.nls.landmarks import l, landmarks, reference, said, same, seen_by_range, step, two_kinds, x
from tests.nls.solving import near

GRAPHS: tuple[Callable[[], Sample], ...] = (
    lambda: landmarks(SE2, seed=1),
    lambda: landmarks(SE3, seed=2),
    lambda: landmarks(SE3, n=6, k=150, seed=3),
    lambda: landmarks(SE2, n=40, k=5, seed=4),
    two_kinds,
    *[lambda seed=seed: mixed(seed) for seed in range(3)],
)
BOTH = pytest.mark.parametrize("solver", [Schur(), PCG()], ids=lambda solver: solver.name)


# ---- the step


@BOTH
def test_the_step_is_that_of_cholesky(solver: LinearSolver) -> None:
    """Plain, robust and damped; with poses or landmarks held, some of them or all."""
    rng = np.random.default_rng(0)
    for create in GRAPHS:
        sample = create()
        system = sample.graph.linearize(sample.values)
        same(system, solver=solver)
        for relative in (1e-6, 1.0, 1e4):
            same(system, relative * diagonal(system) * rng.uniform(0.5, 2, system.pattern.n), solver)
        same(sample.graph.robust(Huber(0.5)).linearize(sample.values), solver=solver)
    for group in (SE2, SE3):
        for held in (x[[3, 7]], l[[0, 5, 29]], l[0:30], x[0:12]):
            sample = landmarks(group, seed=5)
            sample.graph.fix(held)
            same(sample.graph.linearize(sample.values), solver=solver)


def test_the_complement_is_the_formula() -> None:
    """S = H_pp - H_pl H_ll^-1 H_lp, with points that a pose sees twice and points of two dimensions."""
    sample = two_kinds()
    system = sample.graph.linearize(sample.values)
    state = Schur().analyze(system.pattern).factorization
    assert isinstance(state.decomposition, SchurDecomposition)
    complement = state.decomposition._complement
    filled = complement.fill(system.H_blocks)
    p, n = state.hessian.permutation, complement.n
    H = system.H.toarray()[np.ix_(p, p)]
    S = H[n:, n:] - H[n:, :n] @ np.linalg.inv(H[:n, :n]) @ H[:n, n:]
    np.testing.assert_allclose(
        complement.hessian.symmetric(filled.flat).toarray(), S, rtol=0, atol=1e-12 * np.abs(H).max()
    )
    np.testing.assert_allclose(filled.pivots, np.linalg.cholesky(H[:n, :n]).diagonal() ** 2, rtol=1e-10)
    assert np.abs(H[n:, n:] - S).max() > 0.1 * np.abs(H).max()


@pytest.mark.parametrize("optimizer", [GaussNewton(), LevenbergMarquardt(), nls.Dogleg()], ids=lambda o: o.name)
def test_whole_optimizations(optimizer: nls.Optimizer) -> None:
    sample = landmarks(SE2, seed=7)
    one = sample.graph.optimize(sample.values, optimizer, reference())
    two, three = (sample.graph.optimize(sample.values, optimizer, solver) for solver in (Schur(), PCG()))
    assert two.converged
    assert two.linear_solver == "schur, l eliminated: 60 of 96 columns"
    assert three.linear_solver.startswith("pcg, ")
    assert three.linear_solver.endswith(" CG steps")
    assert two.iterations == one.iterations
    for other in (two, three):
        assert other.chi2_final == pytest.approx(one.chi2_final, rel=1e-9)
        assert other.status is one.status


def test_a_kept_step_is_that_of_the_kept_factorization() -> None:
    sample = landmarks(SE3, seed=8)
    old, new = sample.graph.linearize(sample.values), sample.graph.linearize(sample.truth)
    analyzed = Schur().analyze(old.pattern)
    assert analyzed.solve(old).seconds.keys() == {"assemble", "factorize", "solve"}
    kept = analyzed.again(new)
    assert kept is not None
    near(kept.dx, np.linalg.solve(old.H.toarray(), new.gradient), 1e-9)


@pytest.mark.parametrize("superlu", [False, True])
def test_step_and_covariances_come_from_its_factor(superlu: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if superlu:
        monkeypatch.setattr(importlib.import_module("nls.linear.cholesky"), "cholmod", lambda: None)
    sample = landmarks(SE2, n=40, k=5, seed=11)
    system = sample.graph.linearize(sample.values)
    near(step(Schur(), system), step(LU(), system), 1e-9)
    one, two = (nls.Marginals(sample.graph, sample.values, solver) for solver in (LU(), Schur()))
    for kind in (x, l):
        np.testing.assert_allclose(two.all(kind, "world"), one.all(kind, "world"), rtol=1e-9, atol=1e-12)
    pair = [x[3], l[3]]
    np.testing.assert_allclose(two.joint(pair, "body").matrix, one.joint(pair, "body").matrix, rtol=1e-9, atol=1e-12)


def test_bundle_adjustment(data: Path) -> None:
    graph, values, _ = nls.load(data / "bal" / "problem-49-7776-pre.txt.gz")
    system = graph.linearize(values)
    assert said(system) == "schur, l eliminated: 23,328 of 23,769 columns"
    damping = 1e-3 * diagonal(system)
    expected = step(reference(), system, damping)
    near(step(Schur(), system, damping), expected, 1e-9)
    near(step(PCG(), system, damping), expected, 1e-8)
    with pytest.raises(SingularSystemError):
        step(PCG(), system)  # its gauge and its scale


# ---- another inverse


def truncated(H: Array) -> Array:
    """The inverse on the directions that have a hundredth of the information of the best one."""
    w, Q = np.linalg.eigh(H)
    return np.asarray((Q * np.where(w > 0.01 * w[:, -1:], 1 / w, 0.0)[:, None]) @ Q.mT)


def test_the_exact_inverse_given_is_the_exact_inverse() -> None:
    sample = two_kinds()
    system = sample.graph.linearize(sample.values)
    shapes = []

    def inverse(H: Array) -> Array:
        shapes.append(H.shape)
        assert np.array_equal(H, H.mT)
        return np.linalg.inv(H)

    near(step(Schur(inverse), system), step(Schur(), system), 1e-9)
    assert shapes == [(9, 1, 1), (30, 2, 2)]


def test_a_truncated_inverse_is_the_formula_with_it() -> None:
    sample = seen_by_range(4)
    system = sample.graph.linearize(sample.values)
    n = 36
    H, g = system.H.toarray(), system.gradient
    V = np.zeros((62, 62))
    for k in range(31):
        block = slice(2 * k, 2 * k + 2)
        V[block, block] = truncated(H[n:, n:][block, block][None])[0]
    S = H[:n, :n] - H[:n, n:] @ V @ H[n:, :n]
    dx_p = np.linalg.solve(S, g[:n] - H[:n, n:] @ V @ g[n:])
    expected = np.concatenate([dx_p, V @ (g[n:] - H[n:, :n] @ dx_p)])
    near(step(Schur(truncated), system), expected, 1e-9)
    bearing = sample.values[l[99]] - sample.values[x[4]][:2]
    across = np.array([-bearing[1], bearing[0]]) / np.linalg.norm(bearing)
    assert across @ expected[-2:] == pytest.approx(0.0, abs=1e-9)  # what is not known does not move


def test_what_is_no_inverse_is_refused() -> None:
    sample = landmarks(SE2)
    system = sample.graph.linearize(sample.values)
    for wrong, match in (
        (lambda H: H[:1], r"\(1, 2, 2\) is not possible; expected finite inverses \(30, 2, 2\)"),
        (lambda H: np.full(H.shape, np.nan), "finite"),
        (lambda H: -np.linalg.inv(H), "positive semi-definite"),
        (lambda H: H + np.triu(H), "symmetric"),
    ):
        with pytest.raises(nls.OptionError, match=match):
            step(Schur(wrong), system)
    with pytest.raises(nls.OptionError, match="block_inverse: 3 is not possible"):
        Schur(3)  # type: ignore[arg-type]
    with pytest.raises(nls.OptionError, match="memory_limit"):
        Schur(memory_limit=-1.0)


def test_no_covariance_from_another_inverse() -> None:
    sample = landmarks(SE2)
    for ask in (lambda m: m.covariance(l[0]), lambda m: m.all(l), lambda m: m.joint([l[0], l[1]])):
        ask(nls.Marginals(sample.graph, sample.values, Schur()))
        for another in (truncated, np.linalg.inv):
            with pytest.raises(nls.OptionError, match=r"block_inverse=...\) is .* factorizes A'A itself"):
                ask(nls.Marginals(sample.graph, sample.values, Schur(another)))


@pytest.mark.parametrize("optimizer", [GaussNewton(), LevenbergMarquardt(), nls.Dogleg()], ids=lambda o: o.name)
def test_where_nothing_may_move_nothing_has_converged(optimizer: nls.Optimizer) -> None:
    """x, of more columns, is eliminated, and 0 is taken for its inverse: it stays 5 m from where it is known to be."""
    graph = FactorGraph([Prior(x[0], [0, 0, 0], Isotropic(0.1)), Landmark(x[0], l[0], [1.0, 2.0], Isotropic(0.1))])
    start = Values({x: (SE2, [5.0, 0.0, 0.0]), l: (R(2), [0.0, 0.0])})
    result = graph.optimize(start, optimizer, Schur(block_inverse=lambda H: 0 * H))
    assert result.status is nls.Status.STALLED
    assert "one unknown by 35.4 sigmas" in result.reason
    assert result.reason.endswith("(schur, x eliminated: 3 of 5 columns, 3 directions left alone)")
    assert result.values[x[0]].tolist() == [5.0, 0.0, 0.0]
    exact = graph.optimize(start, optimizer, Schur(block_inverse=np.linalg.inv))
    assert exact.converged
    assert exact.linear_solver == "schur, x eliminated: 3 of 5 columns, 0 directions left alone"
    assert exact.values[l[0]] == pytest.approx([1.0, 2.0])


# ---- memory


def test_what_joins_too_much_is_refused_before_it_is_made() -> None:
    """One point that every pose sees joins all of them."""
    sample = landmarks(SE2, n=60, k=240)
    pattern = sample.graph.linearize(sample.values).pattern
    with pytest.raises(nls.ResourceLimitError, match=r"'schur': eliminating 240 variables joins .* 'cholesky'"):
        Schur(memory_limit=1e5).analyze(pattern)
    long = pose_graph(SE2, n=300)
    with pytest.raises(nls.ResourceLimitError, match=r"'schur': R of 900 unknowns"):
        Schur(memory_limit=4e4).analyze(long.graph.linearize(long.values).pattern)
