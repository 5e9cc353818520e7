"""`schur`, and `pcg` where it promises the same: the step of Cholesky on graphs of landmarks; other inverses."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Huber, Isotropic, Landmark, Prior, Range
from models import SE2, SE3, R
from models.algebra import Array
from nls import PCG, FactorGraph, GaussNewton, Schur, Values
from nls.linear import LU, LinearSolver
from nls.linear.factorization import SingularSystemError
from nls.linear.schur.solver import _heaviest, independent
from nls.optimizers import OPTIMIZERS
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
EACH = pytest.mark.parametrize("optimizer", [kind() for kind in OPTIMIZERS.values()], ids=lambda o: o.name)
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


@EACH
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
    joints = [marginals.joint(pair, frame="body").matrix for marginals in (two, one)]
    np.testing.assert_allclose(*joints, rtol=1e-9, atol=1e-12)


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
    known = w > 0.01 * w[:, -1:]
    return np.asarray((Q * np.where(known, 1 / np.where(known, w, 1.0), 0.0)[:, None]) @ Q.mT)


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


@EACH
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
    with pytest.raises(nls.ResourceLimitError, match=r"'schur': eliminating 240 variables connects .* 'cholesky'"):
        Schur(memory_limit=1e5).analyze(pattern)
    long = pose_graph(SE2, n=300)
    with pytest.raises(nls.ResourceLimitError, match=r"'schur': R of 900 unknowns"):
        Schur(memory_limit=4e4).analyze(long.graph.linearize(long.values).pattern)


# ---- what is eliminated


def test_the_kinds_with_the_most_columns_are_eliminated() -> None:
    """o is joined to l: l and m go together, 69 columns; o and m would be 10."""
    sample = two_kinds()
    system = sample.graph.linearize(sample.values)
    assert said(system) == "schur, l and m eliminated: 69 of 106 columns"
    same(system)


def test_held_variables_join_nothing() -> None:
    """With every other pose held no pose is joined to another one; with all held none is left."""
    sample = pose_graph(SE3, n=9)
    sample.graph.fix(x[[0, 2, 4, 6, 7, 8]])
    system = sample.graph.linearize(sample.values)
    assert said(system) == "schur, x eliminated: 18 of 18 columns"
    same(system)
    sample.graph.fix(x[0:9])
    system = sample.graph.linearize(sample.values)
    assert said(system) == "schur, nothing eliminated: 0 of 0 columns"
    assert step(Schur(), system).shape == (0,)


def test_a_pose_graph_loses_single_poses() -> None:
    sample = pose_graph(SE2, n=40)
    system = sample.graph.linearize(sample.values)
    blocks = system.pattern.blocks
    gone, words = independent(system.pattern, blocks)
    assert not (gone[blocks.u] & gone[blocks.v]).any()
    assert words == f"{gone.sum()} of 40 x eliminated: {3 * gone.sum()} of 120 columns"
    same(system)


def test_of_few_kinds_the_best_set_and_of_many_a_set_in_time() -> None:
    """Kinds in pairs, joined in a ring: a search among 40 of them takes half an hour."""
    rng = np.random.default_rng(0)
    for n in (3, 8, 16, 17, 40, 1000):
        joined, columns = np.zeros((n, n), dtype=bool), rng.integers(1, 100, n)
        joined[np.arange(n), np.arange(n) - 1] = joined[np.arange(n) - 1, np.arange(n)] = True
        taken = _heaviest(range(n), joined, columns)
        assert not joined[np.ix_(taken, taken)].any()
        others = np.setdiff1d(np.arange(n), taken)
        assert joined[np.ix_(others, taken)].any(axis=1).all()  # none could be added
        if n <= 8:
            sets = [np.flatnonzero([c >> k & 1 for k in range(n)]) for c in range(1 << n)]
            assert columns[taken].sum() == max(columns[s].sum() for s in sets if not joined[np.ix_(s, s)].any())
        assert columns[taken].sum() >= columns.sum() / 3  # each leaves out two of no more columns


# ---- something is free


def loose_pose() -> Sample:
    """A pose more that only looks at one landmark: it can turn around it."""
    sample = landmarks(SE2, seed=13)
    graph = FactorGraph(sample.graph.factors)
    graph.add(Landmark(x[99], l[0], [[1.0, 2.0]], Isotropic(0.1)))
    values = Values({x: (SE2, np.vstack([sample.values[x], [0, 0, 0]]), [*range(12), 99]), l: (R(2), sample.values[l])})
    return Sample(graph, values, values)


@pytest.mark.parametrize(
    ("case", "key"),
    [(lambda: seen_by_range(4), "l99"), (loose_pose, "x99"), (lambda: landmarks(SE2, anchored=False), "x0")],
)
def test_singular_systems_are_refused_by_name(case: Callable[[], Sample], key: str) -> None:
    sample = case()
    system = sample.graph.linearize(sample.values)
    with pytest.raises(SingularSystemError):
        step(Schur(), system)
    with pytest.raises(nls.UnderconstrainedError, match=key):
        sample.graph.optimize(sample.values, GaussNewton(), Schur(), gauge="none")
    same(system, 1e-3 * (1 + diagonal(system)))  # damping holds what is free


def test_a_singular_landmark_shows_before_anything_is_divided_by_its_pivot() -> None:
    sample = seen_by_range(4)
    sample.graph.fix(x[4])
    with pytest.raises(SingularSystemError, match="in a variable that is eliminated by itself"):
        step(Schur(), sample.graph.linearize(sample.values))
    two = seen_by_range(4, 9)
    same(two.graph.linearize(two.values))


def test_a_weak_direction_of_a_landmark_costs_no_digits_elsewhere() -> None:
    """A point known across the line of sight 1e5 times worse than along it: information 1e-10, above rounding."""
    sample = landmarks(SE2, seed=14)
    graph = FactorGraph(sample.graph.factors)
    graph.add(Range(x[[3, 3]], l[[99, 99]], [3.0, 3.1], Isotropic(0.1)))
    graph.add(Prior(l[99], [0.0, 0.0], Isotropic(1e4)))
    points = np.vstack([sample.values[l], sample.values[x][3, :2] + [2.0, 2.0]])
    values = Values({x: (SE2, sample.values[x]), l: (R(2), points, [*range(30), 99])})
    system = graph.linearize(values)
    expected = np.linalg.lstsq(system.A.toarray(), system.b)[0]
    near(step(Schur(), system)[:36], expected[:36], 1e-9)
