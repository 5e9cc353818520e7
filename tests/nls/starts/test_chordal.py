"""Start values: composed along edges one by one, and relaxed all at once; exact where the measurements are."""

from __future__ import annotations

import importlib
from itertools import pairwise

import numpy as np
import pytest

from factors import Between, Diagonal, Factor, Isotropic, Prior, SqrtInformation
from models import SE2, SE3, LieGroup, R
from nls import FactorGraph, GraphWarning, OptionError, UnderconstrainedError, Values, initialize
from nls.starts import STARTS, chain, chordal, spanning_tree
from tests.nls.graphs import GROUPS, ODD, Seen, between, distance, in_frame, l, pose_graph, walk, x

PLACES: tuple[LieGroup, ...] = (SE2, SE3)
COMPOSED = (chain, spanning_tree, chordal)
UNIT = Isotropic(1)
same = np.testing.assert_allclose


@pytest.mark.parametrize("numbers", [None, (7, 6, 5, 4, 3, 2, 1, 0)])
def test_the_chain_is_a_loop_of_compositions(numbers: tuple[int, ...] | None) -> None:
    for group in GROUPS:
        sample = pose_graph(group, numbers=numbers, start=1.0)
        order = sorted(sample.values.stack("x").numbers.tolist())
        poses = [sample.values[x[order[0]]]]
        edges = [
            (i, j, z)
            for f in between(sample)
            for i, j, z in zip(*(k.numbers.tolist() for k in f.keys), f.bind(group, group).z, strict=True)
        ]
        for a, b in pairwise(order):  # the first edge of the file between two nodes counts
            i, _, z = next(edge for edge in edges if {*edge[:2]} == {a, b})
            poses.append(group.compose(poses[-1], z if i == a else group.inverse(z)))
        found = chain(sample.graph, sample.values)[x[order]]
        assert distance(group, np.array(poses), found) < 1e-12
        assert np.array_equal(found[0], poses[0])


def test_the_spanning_tree_takes_closures_and_the_chain_steps() -> None:
    """Backward, too; a wrong step is in the way of the chain alone, a wrong jump in the way of none."""
    for group in GROUPS:
        X = walk(group, 6, np.random.default_rng(0))
        i, j = np.array([1, 1, 3, 3, 4, 5]), np.array([0, 2, 2, 4, 5, 0])
        z = group.between(X[i], X[j])
        start = Values({x: (group, np.repeat(X[:1], 6, axis=0))})
        for method in (chain, spanning_tree):
            assert distance(group, X, method(FactorGraph([Between(x[i], x[j], z, UNIT)]), start)[x]) < 1e-12
        for wrong, method in ((5, chain), (3, spanning_tree)):  # 5-0 closes the loop, 3-4 is farthest from 0
            off = z.copy()
            off[wrong] = group.compose(z[wrong], group.exp(np.full(group.dim, 0.7)))
            found = [m(FactorGraph([Between(x[i], x[j], off, UNIT)]), start)[x] for m in (method, chain)]
            assert distance(group, X, found[0]) < 1e-12
            assert (distance(group, X, found[1]) > 0.1) == (wrong == 3)


@pytest.mark.parametrize("group", PLACES, ids=str)
@pytest.mark.parametrize("fixed", [(), (2,)])
def test_every_component_keeps_its_fixed_pose_or_its_first(group: LieGroup, fixed: tuple[int, ...]) -> None:
    rng, number = np.random.default_rng(2), np.array(ODD)
    X, i = walk(group, 8, rng), np.array([0, 1, 2, 4, 5, 6])
    kept = [*(fixed or [int(np.argmin(number[:4]))]), 4 + int(np.argmin(number[4:]))]
    graph = FactorGraph([Between(x[number[i]], x[number[i + 1]], group.between(X[i], X[i + 1]), UNIT)])
    graph.fix(x[number[list(fixed)]])
    start = group.retract(X, rng.normal(size=(8, group.dim)))
    start[kept] = X[kept]
    for method in COMPOSED:
        found = method(graph, Values({x: (group, start, number)}))[x]
        assert distance(group, X, found) < 1e-9
        assert np.array_equal(found[kept], X[kept])


def test_what_a_start_leaves_alone() -> None:
    """Poses without an edge, points, the caller's values and their memory."""
    sample = pose_graph(SE2, start=1.0)
    stack, lonely = sample.values.stack("x"), np.array([[5.0, 6.0, 0.5]])
    values = Values({l: (R(2), [[3.0, 4.0]]), x: (SE2, np.concatenate([stack.X, lonely]))})
    seen = FactorGraph([*sample.graph.factors, Seen(x[0], l[0], in_frame(stack.X[:1], values[l]), Isotropic(0.1))])
    before = values[x].copy()
    for name, method in STARTS.items():
        found = method(sample.graph, values)
        assert np.array_equal(found[x[8]], lonely[0])
        assert np.array_equal(found[l], [[3.0, 4.0]])
        assert (name == "file") == np.array_equal(found[x], before)
        assert initialize(sample.graph, values, name)[1:] == (name, {name: sample.graph.chi2(found)})
    for compose in COMPOSED:
        found = compose(seen, values)
        assert np.array_equal(found[l], [[3.0, 4.0]])
        assert not np.array_equal(found[x], before)
        found[l[0]] = [9.0, 9.0]
        assert np.array_equal(values[x], before)
        assert values[l].tolist() == [[3.0, 4.0]]


@pytest.mark.parametrize("group", PLACES, ids=str)
def test_chordal_minimizes_its_two_sums(group: LieGroup, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against dense least squares of sum kappa |M_j - M_i R_ij|^2, projected, then sum tau |t_j - t_i - R_i t_ij|^2."""
    n, d = 6, group.point_dim
    sample = pose_graph(group, n=n, seed=6, anchored=False)
    X = sample.values[x]
    of_M, of_t, right = [], [], []
    for f in between(sample):
        model = f.bind(group, group)
        W = model.W if model.W.ndim == 3 else model.W[..., None] * np.eye(group.dim)
        Omega = np.broadcast_to(W.mT @ W, (len(f), group.dim, group.dim))
        for k, (i, j) in enumerate(zip(*(keys.numbers for keys in f.keys), strict=True)):
            tau, kappa = np.trace(Omega[k][:d, :d]) / d, np.trace(Omega[k][d:, d:]) / (group.dim - d)
            row, step = np.zeros((2, d, n, d))
            row[:, j], row[:, i] = np.eye(d), -group.rotation(model.z[k]).T  # M_j' - R_ij' M_i' = 0
            step[:, j], step[:, i] = np.eye(d), -np.eye(d)
            of_M.append(np.sqrt(kappa) * row.reshape(d, -1))
            of_t.append(np.sqrt(tau) * step.reshape(d, -1))
            right.append((i, np.sqrt(tau) * model.z[k][:d]))
    A = np.concatenate(of_M)
    M = np.linalg.lstsq(A[:, d:], -A[:, :d] @ group.rotation(X[0]).T)[0].reshape(n - 1, d, d).transpose(0, 2, 1)
    U, _, Vt = np.linalg.svd(M)
    U[..., -1] *= np.linalg.det(U @ Vt)[:, None]
    Rots = np.concatenate([group.rotation(X[:1]), U @ Vt])
    A, b = np.concatenate(of_t), np.concatenate([Rots[i] @ t for i, t in right])
    t = np.linalg.lstsq(A[:, d:], b - A[:, :d] @ X[0, :d])[0].reshape(n - 1, d)
    for cholmod in (True, False):
        if not cholmod:
            monkeypatch.setattr(importlib.import_module("nls.linear.cholesky"), "cholmod", lambda: None)
        found = chordal(sample.graph, sample.values)[x]
        same(group.rotation(found[1:]), Rots[1:], rtol=0, atol=1e-9)
        same(found[1:, :d], t, rtol=0, atol=1e-9)


def test_auto_takes_the_lowest_and_lists_what_it_tried() -> None:
    sample = pose_graph(SE2, n=30, seed=7, start=0.5)
    overconfident = FactorGraph([Between(*f.keys, f.z, Isotropic(1e-4)) for f in sample.graph.factors[:3]])
    optimum = sample.graph.optimize(sample.values).values
    for graph, given, tried, best in (
        (sample.graph, sample.values, {"file", "chordal"}, "chordal"),  # near: nobody asks for the odometry
        (sample.graph, optimum, {"file", "chordal"}, "file"),
        (overconfident, sample.values, {"file", "odometry", "chordal"}, None),
    ):
        values, name, chi2 = initialize(graph, given)
        assert set(chi2) == tried
        assert chi2[name] == min(chi2.values()) == graph.chi2(values)
        assert chi2["file"] == graph.chi2(given)
        assert name == (best or name)
        assert best != "file" or np.array_equal(values[x], optimum[x])
    assert min(chi2.values()) > 10 * 3 * len(overconfident)
    assert chi2["odometry"] == overconfident.chi2(chain(overconfident, sample.values))
    with pytest.raises(OptionError, match="init: 'magic' is not possible; expected one of auto, file, odometry"):
        initialize(sample.graph, sample.values, "magic")


@pytest.mark.parametrize("group", PLACES, ids=str)
def test_chordal_refuses_what_leaves_a_pose_free(group: LieGroup) -> None:
    X, W = walk(group, 4, np.random.default_rng(0)), np.diag(10.0 * (np.arange(group.dim) < group.point_dim))
    graph = FactorGraph([Between(x[0:3], x[1:4], group.between(X[:-1], X[1:]), SqrtInformation(W))])  # positions alone
    values = Values({x: (group, group.identity(4))})
    with pytest.raises(UnderconstrainedError, match="chordal relaxation: some poses have no rotation"):
        chordal(graph, values)
    with pytest.warns(GraphWarning, match="guess 'chordal' was left out: chordal relaxation: some poses") as caught:
        _, name, chi2 = initialize(graph, values)
    assert [warning.filename for warning in caught] == [__file__]
    assert (name, set(chi2)) == ("odometry", {"file", "odometry"})
    back = FactorGraph([Between(x[[0, 0]], x[[1, 1]], [[1.0, 0.0, 0.0], [1.0, 0.0, -np.pi]], UNIT)])
    with pytest.raises(UnderconstrainedError, match="contradicting rotations cancel"):
        chordal(back, Values({x: (SE2, SE2.identity(2))}))


@pytest.mark.parametrize("group", PLACES, ids=str)
def test_chordal_keeps_rotations_that_shrink_along_the_way(group: LieGroup) -> None:
    """A ladder of 250 noisy squares: each halves the relaxed rotations, down to 1e-50, and leaves their directions."""
    n, d, rng = 250, group.point_dim, np.random.default_rng(0)
    k = np.arange(n)
    i = np.concatenate([2 * k[:-1], 2 * k[:-1] + 1, 2 * k])
    j = np.concatenate([2 * k[1:], 2 * k[1:] + 1, 2 * k + 1])
    noise = rng.normal(size=(len(i), group.dim)) * np.repeat([0.01, 0.7], [d, group.dim - d])
    graph = FactorGraph([Between(x[i], x[j], group.exp(noise), Isotropic(0.1))])
    _, name, chi2 = initialize(graph, Values({x: (group, group.identity(2 * n))}))
    assert name == "chordal"
    assert chi2["chordal"] < 0.7 * chi2["odometry"]


def test_graphs_without_relative_poses_keep_their_values() -> None:
    graph = FactorGraph([Prior(l[0], [1.0, 2.0], Diagonal([0.1, 0.1]))])
    graph.add(Factor.from_function(lambda a: a - 1.0, l[0], 2))
    values = Values({l: (R(2), [[5.0, 5.0]])})
    for method in STARTS.values():
        assert np.array_equal(method(graph, values)[l], [[5.0, 5.0]])
    assert initialize(graph, values)[1] == "file"
