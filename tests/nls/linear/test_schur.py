"""`schur`: what is eliminated, the step of Cholesky on landmark graphs, singular ones refused, other inverses."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Huber, Isotropic, Landmark, Prior
from models import SE2, SE3, LieGroup, R
from models.algebra import Array
from nls import FactorGraph, GaussNewton, LevenbergMarquardt, Schur, Stop, Values
from nls.linear import LU
from nls.linear.schur.roots import inverse_root
from nls.linear.schur.solver import SchurDecomposition
from tests.nls.graphs import SAMPLES, Sample, diagonal, mixed, pose_graph
from tests.nls.landmarks import l, landmarks, reference, said, same, seen_by_range, step, two_kinds, x

GRAPHS: dict[str, Callable[[], Sample]] = {
    **SAMPLES,
    "plane": lambda: landmarks(SE2, seed=1),
    "space": lambda: landmarks(SE3, seed=2),
    "many points": lambda: landmarks(SE3, n=6, k=150, seed=3),
    "few points": lambda: landmarks(SE2, n=40, k=5, seed=4),
}


# ---- the step


@pytest.mark.parametrize("name", GRAPHS)
@pytest.mark.parametrize("robust", [False, True])
def test_the_step_is_that_of_cholesky(name: str, robust: bool) -> None:
    sample = GRAPHS[name]()
    graph = sample.graph.robust(Huber(0.5)) if robust else sample.graph
    same(graph.linearize(sample.values))


@pytest.mark.parametrize("relative", [1e-6, 1.0, 1e4])
@pytest.mark.parametrize("name", ["plane", "space", "mixed"])
def test_damped_steps_too(name: str, relative: float) -> None:
    sample = GRAPHS[name]()
    system = sample.graph.linearize(sample.values)
    same(system, relative * diagonal(system) * np.random.default_rng(0).uniform(0.5, 2, system.pattern.n))


@pytest.mark.parametrize("group", [SE2, SE3])
@pytest.mark.parametrize("held", [x[[3, 7]], l[[0, 5, 29]], l[0:30], x[0:12]])
def test_held_poses_and_held_landmarks(group: LieGroup, held: nls.Keys) -> None:
    sample = landmarks(group, seed=5)
    sample.graph.fix(held)
    system = sample.graph.linearize(sample.values)
    same(system)
    free = {"x": 12, "l": 30}
    free[held.kind] -= len(held)
    if free["l"]:
        dims = {"x": 3 if group is SE2 else 6, "l": 2 if group is SE2 else 3}
        assert said(system).endswith(
            f": {(columns := free['l'] * dims['l'])} of {columns + free['x'] * dims['x']} columns"
        )


def test_the_complement_is_the_formula() -> None:
    """S = H_pp - H_pl H_ll^-1 H_lp, with points that a pose sees twice and points of two dimensions."""
    sample = two_kinds()
    system = sample.graph.linearize(sample.values)
    state = Schur().analyze(system.pattern).factorization
    decomposition = state.decomposition
    assert isinstance(decomposition, SchurDecomposition)
    complement = decomposition._complement
    filled = complement.fill(system.H_blocks)
    p, n = state.hessian.permutation, complement.n
    H = system.H.toarray()[np.ix_(p, p)]
    S = H[n:, n:] - H[n:, :n] @ np.linalg.inv(H[:n, :n]) @ H[:n, n:]
    found = complement.hessian.symmetric(filled.flat).toarray()
    np.testing.assert_allclose(found, S, rtol=0, atol=1e-12 * np.abs(H).max())
    np.testing.assert_allclose(filled.pivots, np.linalg.cholesky(H[:n, :n]).diagonal() ** 2, rtol=1e-10)
    assert np.abs(H[n:, n:] - S).max() > 0.1 * np.abs(H).max()


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_factors_and_variables_does_not_matter(seed: int) -> None:
    sample, rng = landmarks(SE3, seed=6), np.random.default_rng(seed)
    poses, points = rng.permutation(12), rng.permutation(30)
    shuffled = FactorGraph()
    for factor in (sample.graph.factors[k] for k in rng.permutation(len(sample.graph.factors))):
        shuffled.add(factor[rng.permutation(len(factor))])
    values = Values(
        {
            l: (R(3), sample.values[l][points], points),
            x: (SE3, sample.values[x][poses], poses),
        }
    )
    stop = GaussNewton(Stop(max_iterations=1))
    one = sample.graph.optimize(sample.values, stop, Schur()).values
    two = shuffled.optimize(values, stop, Schur()).values
    for kind in (x, l):
        assert two[kind[0:12]] == pytest.approx(one[kind[0:12]], rel=0, abs=1e-9)


@pytest.mark.parametrize("optimizer", [GaussNewton(), LevenbergMarquardt(), nls.Dogleg()])
def test_whole_optimizations(optimizer: nls.Optimizer) -> None:
    sample = landmarks(SE2, seed=7)
    one = sample.graph.optimize(sample.values, optimizer, reference())
    two = sample.graph.optimize(sample.values, optimizer, Schur())
    assert two.converged
    assert two.linear_solver == "schur, l eliminated: 60 of 96 columns"
    assert two.chi2_final == pytest.approx(one.chi2_final, rel=1e-9)
    assert (two.iterations, two.status) == (one.iterations, one.status)


def test_a_kept_step_is_that_of_the_kept_factorization() -> None:
    sample = landmarks(SE3, seed=8)
    old, new = sample.graph.linearize(sample.values), sample.graph.linearize(sample.truth)
    solver = Schur()
    analyzed = solver.analyze(old.pattern)
    assert analyzed.solve(old).seconds.keys() == {"assemble", "factorize", "solve"}
    kept = analyzed.again(new)
    assert kept is not None
    expected = np.linalg.solve(old.H.toarray(), new.gradient)
    assert kept.dx == pytest.approx(expected, rel=0, abs=1e-9 * np.abs(expected).max())


def test_a_free_gauge_takes_the_shortest_step() -> None:
    sample = landmarks(SE2, seed=9, anchored=False)
    one_step = GaussNewton(Stop(max_iterations=1))
    one = sample.graph.optimize(sample.values, one_step, nls.Pinv(), gauge="free").values
    two = sample.graph.optimize(sample.values, one_step, Schur(), gauge="free").values
    assert two[x] == pytest.approx(one[x], rel=0, abs=1e-9)
    assert two[l] == pytest.approx(one[l], rel=0, abs=1e-9)


def test_without_suitesparse_superlu_factorizes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.import_module("nls.linear.cholesky"), "cholmod", lambda: None)
    sample = landmarks(SE3, seed=10)
    system = sample.graph.linearize(sample.values)
    expected = step(LU(), system)
    assert step(Schur(), system) == pytest.approx(expected, rel=0, abs=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("superlu", [False, True])
def test_covariances_come_from_its_factor(superlu: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if superlu:
        monkeypatch.setattr(importlib.import_module("nls.linear.cholesky"), "cholmod", lambda: None)
    sample = landmarks(SE2, n=40, k=5, seed=11)
    one = nls.Marginals(sample.graph, sample.values, LU())
    two = nls.Marginals(sample.graph, sample.values, Schur())
    for kind in (x, l):
        assert two.all(kind, "world") == pytest.approx(one.all(kind, "world"), rel=1e-9, abs=1e-12)
    assert two.joint([x[3], l[3]], "body").matrix == pytest.approx(
        one.joint([x[3], l[3]], "body").matrix, rel=1e-9, abs=1e-12
    )


def test_bundle_adjustment(data: Path) -> None:
    graph, values, _ = nls.load(data / "bal" / "problem-49-7776-pre.txt.gz")
    system = graph.linearize(values)
    assert said(system) == "schur, l eliminated: 23,328 of 23,769 columns"
    damping = 1e-4 * diagonal(system)
    expected = step(reference(), system, damping)
    assert step(Schur(), system, damping) == pytest.approx(expected, rel=0, abs=1e-9 * np.abs(expected).max())


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

    expected = step(Schur(), system)
    assert step(Schur(inverse), system) == pytest.approx(expected, rel=0, abs=1e-9 * np.abs(expected).max())
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
    assert step(Schur(truncated), system) == pytest.approx(expected, rel=0, abs=1e-9 * np.abs(expected).max())
    bearing = sample.values[l[99]] - sample.values[x[4]][:2]
    across = np.array([-bearing[1], bearing[0]]) / np.linalg.norm(bearing)
    assert across @ expected[-2:] == pytest.approx(0.0, abs=1e-9)  # what is not known does not move


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        (lambda H: H[:1], r"\(1, 2, 2\) is not possible; expected finite inverses \(30, 2, 2\)"),
        (lambda H: np.full(H.shape, np.nan), "finite"),
        (lambda H: -np.linalg.inv(H), "positive semi-definite"),
        (lambda H: H + np.triu(H), "symmetric"),
    ],
)
def test_what_is_no_inverse_is_refused(wrong: Callable[[Array], Array], match: str) -> None:
    sample = landmarks(SE2)
    with pytest.raises(nls.OptionError, match=match):
        step(Schur(wrong), sample.graph.linearize(sample.values))


def test_options_are_checked() -> None:
    with pytest.raises(nls.OptionError, match="block_inverse: 3 is not possible"):
        Schur(3)  # type: ignore[arg-type]
    with pytest.raises(nls.OptionError, match="memory_limit"):
        Schur(memory_limit=-1.0)


@pytest.mark.parametrize(
    "ask",
    [lambda m: m.covariance(l[0]), lambda m: m.all(l), lambda m: m.joint([l[0], l[1]])],
    ids=["covariance", "all", "joint"],
)
def test_no_covariance_from_another_inverse(ask: Callable[[nls.Marginals], object]) -> None:
    sample = landmarks(SE2)
    ask(nls.Marginals(sample.graph, sample.values, Schur()))
    for another in (truncated, np.linalg.inv):
        with pytest.raises(
            nls.OptionError, match=r"linear_solver: Schur\(block_inverse=...\) is .* factorizes A'A itself"
        ):
            ask(nls.Marginals(sample.graph, sample.values, Schur(another)))


@pytest.mark.parametrize("optimizer", [GaussNewton(), LevenbergMarquardt(), nls.Dogleg()])
def test_where_nothing_may_move_nothing_has_converged(optimizer: nls.Optimizer) -> None:
    """x, of more columns, is eliminated, and 0 is taken for its inverse: it stays 5 m from where it is known to be."""
    graph = FactorGraph(
        [Prior(x[0], [0, 0, 0], Isotropic(0.1)), Landmark(x[0], l[0], [1.0, 2.0], Isotropic(0.1))],
    )
    start = Values({x: (SE2, [5.0, 0.0, 0.0]), l: (R(2), [0.0, 0.0])})
    result = graph.optimize(start, optimizer, Schur(block_inverse=lambda H: 0 * H))
    assert result.status is nls.Status.STALLED
    assert re.fullmatch(
        r".*, but the measurements still pull one unknown by 35\.4 sigmas: chi2 can fall where the steps of the linear "
        r"solver do not lead \(schur, x eliminated: 3 of 5 columns, 3 directions left alone\)",
        result.reason,
    )
    assert result.values[x[0]].tolist() == [5.0, 0.0, 0.0]
    exact = graph.optimize(start, optimizer, Schur(block_inverse=np.linalg.inv))
    assert exact.converged
    assert exact.linear_solver == "schur, x eliminated: 3 of 5 columns, 0 directions left alone"
    assert exact.values[l[0]] == pytest.approx([1.0, 2.0])


def test_what_is_left_alone_is_counted_in_the_latest_solve() -> None:
    sample = seen_by_range(4)
    solver = Schur(truncated)
    analyzed = solver.analyze(sample.graph.linearize(sample.values).pattern)
    analyzed.solve(sample.graph.linearize(sample.values))
    assert analyzed.description.endswith(", 1 directions left alone")
    assert analyzed.again(sample.graph.linearize(sample.values)) is None


def test_a_root_of_an_inverse() -> None:
    W = np.random.default_rng(0).normal(size=(5, 3, 2))
    V = W @ W.mT  # of rank 2
    X = inverse_root(lambda H: V, np.zeros((5, 3, 3)))
    np.testing.assert_allclose(X.mT @ X, V, rtol=0, atol=1e-12)


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


def test_in_an_odd_graph_kinds_of_every_size() -> None:
    for seed in range(6):
        sample = mixed(seed)
        same(sample.graph.linearize(sample.values))
