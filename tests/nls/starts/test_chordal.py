"""Start values: composed along edges one by one, and relaxed all at once; exact where the measurements are."""

from __future__ import annotations

from collections import deque
from itertools import pairwise

import numpy as np
import pytest

from factors import Between, Diagonal, Factor, Isotropic, Prior
from models import SE2, SE3, LieGroup, R
from models.algebra import Array
from nls import FactorGraph, GraphWarning, OptionError, UnderconstrainedError, Values, initialize
from nls.starts import STARTS, chain, chordal, spanning_tree
from nls.starts.chordal import nearest_rotation
from tests.nls.graphs import GROUPS, ODD, Seen, between, distance, in_frame, l, pose_graph, walk, x

PLACES: tuple[LieGroup, ...] = (SE2, SE3)


def edge_list(graph: FactorGraph) -> list[tuple[int, int, Array]]:
    """Every relative measurement as (i, j, z) by number."""
    out = []
    for factor in graph.factors:
        if isinstance(factor, Between):
            z = np.atleast_2d(np.asarray(factor.z, dtype=float))
            numbers = zip(*(keys.numbers.tolist() for keys in factor.keys), strict=True)
            out += [(i, j, z[k % len(z)]) for k, (i, j) in enumerate(numbers)]
    return out


def composed(
    group: LieGroup, edges: list[tuple[int, int, Array]], parent: dict[int, int], poses: dict[int, Array]
) -> None:
    """Poses outward from the known ones, one at a time; the first edge of the file between two nodes counts."""
    while missing := [k for k in parent if k not in poses and parent[k] in poses]:
        for k in missing:
            _, j, z = next(e for e in edges if {e[0], e[1]} == {k, parent[k]})
            poses[k] = group.compose(poses[parent[k]], z if j == k else group.inverse(z))


def reference_tree(group: LieGroup, graph: FactorGraph, values: Values) -> dict[int, Array]:
    """Breadth first from the lowest number of every component: levels, not the choice within a level, are unique."""
    edges = edge_list(graph)
    near: dict[int, set[int]] = {}
    for i, j, _ in edges:
        near.setdefault(i, set()).add(j)
        near.setdefault(j, set()).add(i)
    level: dict[int, int] = {}
    for root in sorted(near):
        if root not in level:
            level[root], queue = 0, deque([root])
            while queue:
                node = queue.popleft()
                for other in near[node]:
                    if other not in level:
                        level[other] = level[node] + 1
                        queue.append(other)
    return {k: np.array(v) for k, v in level.items()}


@pytest.fixture(params=GROUPS, ids=str)
def group(request: pytest.FixtureRequest) -> LieGroup:
    return request.param  # type: ignore[no-any-return]


@pytest.mark.parametrize("numbers", [None, (40, 41, 42, 43, 44, 45, 46, 47), (7, 6, 5, 4, 3, 2, 1, 0)])
def test_the_chain_is_a_loop_of_compositions(group: LieGroup, numbers: tuple[int, ...] | None) -> None:
    sample = pose_graph(group, numbers=numbers, start=1.0)
    found = chain(sample.graph, sample.values)
    edges = edge_list(sample.graph)
    order = sorted(sample.values.stacks["x"].numbers.tolist())
    poses = {order[0]: sample.values[x[order[0]]]}
    composed(group, edges, {b: a for a, b in pairwise(order)}, poses)
    assert distance(group, np.array([poses[k] for k in order]), found[x[order]]) < 1e-12
    assert np.array_equal(found[x[order[0]]], sample.values[x[order[0]]])


def test_backward_edges_are_inverted(group: LieGroup) -> None:
    X = walk(group, 5, np.random.default_rng(0))
    graph = FactorGraph(
        [
            Between(x[[1, 3]], x[[0, 2]], group.between(X[[1, 3]], X[[0, 2]]), Isotropic(1)),
            Between(x[[1, 3]], x[[2, 4]], group.between(X[[1, 3]], X[[2, 4]]), Isotropic(1)),
        ]
    )
    start = Values({x: (group, np.concatenate([X[:1], group.identity(4)]))})
    for method in (chain, spanning_tree):
        assert distance(group, X, method(graph, start)[x]) < 1e-12


def test_a_gap_in_the_chain_is_bridged_by_the_shortest_jump(group: LieGroup) -> None:
    X = walk(group, 6, np.random.default_rng(1))
    i, j = np.array([0, 1, 3, 4, 0, 1]), np.array([1, 2, 4, 5, 5, 3])  # 2-3 is missing; 1-3 jumps over less than 0-5
    z = group.between(X[i], X[j])
    z[4] = group.compose(z[4], group.exp(np.full(group.dim, 0.7)))  # so that the wrong bridge is noticed
    found = chain(
        FactorGraph([Between(x[i], x[j], z, Isotropic(1))]), Values({x: (group, np.repeat(X[:1], 6, axis=0))})
    )
    assert distance(group, X, found[x]) < 1e-12


@pytest.mark.parametrize("method", [chain, spanning_tree, chordal])
@pytest.mark.parametrize("group", PLACES, ids=str)
def test_several_components_under_odd_numbers(method: object, group: LieGroup) -> None:
    X, number = walk(group, 8, np.random.default_rng(2)), np.array(ODD)
    i, j = np.array([0, 1, 2, 4, 5, 6]), np.array([1, 2, 3, 5, 6, 7])
    graph = FactorGraph([Between(x[number[i]], x[number[j]], group.between(X[i], X[j]), Isotropic(1))])
    start = group.retract(X, np.random.default_rng(3).normal(size=(8, group.dim)))
    first = [min(range(4), key=lambda k: ODD[k]), min(range(4, 8), key=lambda k: ODD[k])]
    start[first] = X[first]  # the lowest number of a component keeps its value
    found = method(graph, Values({x: (group, start, number)}))  # type: ignore[operator]
    assert distance(group, X, found[x]) < 1e-9
    assert np.array_equal(found[x[number[first]]], X[first])


@pytest.mark.parametrize("method", [chain, spanning_tree, chordal])
@pytest.mark.parametrize("group", PLACES, ids=str)
def test_a_fixed_pose_holds_its_component_in_place_of_the_first(method: object, group: LieGroup) -> None:
    X = walk(group, 8, np.random.default_rng(2))
    i = np.array([0, 1, 2, 4, 5, 6])
    graph = FactorGraph([Between(x[i], x[i + 1], group.between(X[i], X[i + 1]), Isotropic(1))])
    graph.fix(x[2])
    start = group.retract(X, np.random.default_rng(3).normal(size=(8, group.dim)))
    kept = [2, 4]  # the other component has no fixed one
    start[kept] = X[kept]
    found = method(graph, Values({x: (group, start)}))  # type: ignore[operator]
    assert distance(group, X, found[x]) < 1e-9
    assert np.array_equal(found[x[kept]], X[kept])


def test_the_spanning_tree_takes_the_fewest_edges(group: LieGroup) -> None:
    sample = pose_graph(group, n=20, numbers=tuple(np.random.default_rng(0).permutation(60)[:20].tolist()), start=0.5)
    found = spanning_tree(sample.graph, sample.values)
    level, edges = reference_tree(group, sample.graph, sample.values), edge_list(sample.graph)
    root = min(level)
    assert np.array_equal(found[x[root]], sample.values[x[root]])
    for k in set(level) - {root}:
        from_parents = [
            group.compose(found[x[i if j == k else j]], z if j == k else group.inverse(z))
            for i, j, z in edges
            if k in (i, j) and level[i if j == k else j] == level[k] - 1
        ]
        assert min(distance(group, pose[None], found[x[k]][None]) for pose in from_parents) < 1e-12


@pytest.mark.parametrize("method", list(STARTS))
def test_what_a_start_leaves_alone(method: str) -> None:
    """Poses without an edge, other kinds, and the caller's values."""
    sample = pose_graph(SE2, start=1.0)
    stack = sample.values.stacks["x"]
    lonely = np.array([[5.0, 6.0, 0.5]])
    values = Values({x: (SE2, np.concatenate([stack.X, lonely])), l: (R(2), [[1.0, 2.0]])})
    before = values[x]
    found = STARTS[method](sample.graph, values)
    assert np.array_equal(values[x], before)
    assert np.array_equal(found[x[8]], lonely[0])
    assert np.array_equal(found[l], [[1.0, 2.0]])
    assert (method == "file") == np.array_equal(found[x], before)


@pytest.mark.parametrize("numbers", [None, ODD])
@pytest.mark.parametrize("group", PLACES, ids=str)
def test_chordal_recovers_what_was_measured_without_noise(group: LieGroup, numbers: tuple[int, ...] | None) -> None:
    for seed in range(3):
        sample = pose_graph(group, numbers=numbers, seed=seed)
        graph = FactorGraph()
        for f in between(sample):
            graph.add(Between(*f.keys, group.between(*(sample.truth[k] for k in f.keys)), f.noise))
        stack = sample.truth.stacks["x"]
        start = group.retract(stack.X, np.random.default_rng(seed).normal(size=(8, group.dim)))
        root = int(np.argmin(stack.numbers))
        start[root] = stack.X[root]
        found = chordal(graph, Values({x: (group, start, stack.numbers)}))
        assert distance(group, stack.X, found[x]) < 1e-9
        assert np.array_equal(found[x][root], stack.X[root])


@pytest.mark.parametrize("group", PLACES, ids=str)
def test_chordal_does_not_depend_on_the_world_frame_or_the_start(group: LieGroup) -> None:
    sample = pose_graph(group, n=12, seed=5, anchored=False)
    one = chordal(sample.graph, sample.values)[x]
    T = group.exp(np.linspace(1.0, -2.0, group.dim))
    start = group.compose(T, sample.values[x])
    start[1:] = group.identity(11)
    other = chordal(sample.graph, Values({x: (group, start)}))[x]
    assert distance(group, group.compose(T, one), other) < 1e-9


@pytest.mark.parametrize("group", PLACES, ids=str)
def test_chordal_minimizes_its_two_sums(group: LieGroup) -> None:
    """Against dense least squares of sum kappa |M_j - M_i R_ij|^2, projected, then sum tau |t_j - t_i - R_i t_ij|^2."""
    sample = pose_graph(group, n=6, seed=6, anchored=False)
    d = group.point_dim
    X = sample.values[x]
    rows, right = [], []
    data = []
    for f in between(sample):
        model = f.bind(group, group)
        W = model.W if model.W.ndim == 3 else model.W[..., None] * np.eye(group.dim)
        Omega = np.broadcast_to(W.mT @ W, (len(f), group.dim, group.dim))
        for k, (i, j) in enumerate(zip(*(keys.numbers for keys in f.keys), strict=True)):
            tau, kappa = np.trace(Omega[k][:d, :d]) / d, np.trace(Omega[k][d:, d:]) / (group.dim - d)
            data.append((i, j, group.rotation(model.z[k]), model.z[k][:d], tau, kappa))
    n, eye = 6, np.eye(d)
    for i, j, Rij, _, _, kappa in data:  # M_j' - R_ij' M_i' = 0
        row = np.zeros((d, n * d))
        row[:, j * d : j * d + d] = eye
        row[:, i * d : i * d + d] = -Rij.T
        rows.append(np.sqrt(kappa) * row)
    A = np.concatenate(rows)
    M = np.linalg.lstsq(A[:, d:], -A[:, :d] @ group.rotation(X[0]).T)[0].reshape(n - 1, d, d).transpose(0, 2, 1)
    U, _, Vt = np.linalg.svd(M)
    if d == 2:  # (cos, sin) of the first column, as the relaxation in the plane keeps M of that form
        U[..., -1] *= np.linalg.det(U @ Vt)[:, None]
    else:
        U[..., -1] *= np.linalg.det(U @ Vt)[:, None]
    Rots = np.concatenate([group.rotation(X[:1]), U @ Vt])
    rows = []
    for i, j, _, tij, tau, _ in data:
        row = np.zeros((d, n * d))
        row[:, j * d : j * d + d], row[:, i * d : i * d + d] = eye, -eye
        rows.append(np.sqrt(tau) * row)
        right.append(np.sqrt(tau) * Rots[i] @ tij)
    A, b = np.concatenate(rows), np.concatenate(right)
    t = np.linalg.lstsq(A[:, d:], b - A[:, :d] @ X[0, :d])[0].reshape(n - 1, d)
    found = chordal(sample.graph, sample.values)[x]
    np.testing.assert_allclose(group.rotation(found[1:]), Rots[1:], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found[1:, :d], t, rtol=0, atol=1e-9)


def test_auto_takes_the_lowest_and_lists_what_it_tried() -> None:
    sample = pose_graph(SE2, n=30, seed=7, start=0.5)
    values, name, chi2 = initialize(sample.graph, sample.values)
    assert set(chi2) == {"file", "chordal"}  # which is near: nobody asks for the odometry
    assert chi2[name] == min(chi2.values()) == sample.graph.chi2(values)
    assert chi2["file"] == sample.graph.chi2(sample.values)
    assert name == "chordal"


def test_auto_tries_the_odometry_where_nothing_else_is_near() -> None:
    sample = pose_graph(SE2, n=30, seed=7, start=0.5)
    overconfident = FactorGraph([Between(*f.keys, f.z, Isotropic(1e-4)) for f in sample.graph.factors[:3]])
    values, name, chi2 = initialize(overconfident, sample.values)
    assert set(chi2) == {"file", "odometry", "chordal"}
    assert min(chi2.values()) > 10 * 3 * len(overconfident)
    assert chi2[name] == min(chi2.values()) == overconfident.chi2(values)
    assert chi2["odometry"] == overconfident.chi2(chain(overconfident, sample.values))


def test_auto_keeps_the_file_where_it_is_best() -> None:
    sample = pose_graph(SE2, n=30, seed=8)
    optimum = sample.graph.optimize(sample.values).values
    values, name, _ = initialize(sample.graph, optimum)
    assert name == "file"
    assert values is optimum or np.array_equal(values[x], optimum[x])


@pytest.mark.parametrize("method", list(STARTS))
def test_by_name(method: str) -> None:
    sample = pose_graph(SE3)
    values, name, chi2 = initialize(sample.graph, sample.values, method)
    assert name == method
    assert chi2 == {method: sample.graph.chi2(values)}


def test_an_unknown_start_lists_the_known() -> None:
    sample = pose_graph(SE2)
    with pytest.raises(OptionError, match="init: 'magic' is not possible; expected one of auto, file, odometry"):
        initialize(sample.graph, sample.values, "magic")


def without_rotation(group: LieGroup, sigma: float = 0.1) -> FactorGraph:
    """Every edge measures the position alone."""
    from factors import SqrtInformation

    W = np.diag([1 / sigma] * group.point_dim + [0.0] * (group.dim - group.point_dim))
    X = walk(group, 4, np.random.default_rng(0))
    return FactorGraph([Between(x[0:3], x[1:4], group.between(X[:-1], X[1:]), SqrtInformation(W))])


@pytest.mark.parametrize("group", PLACES, ids=str)
def test_chordal_refuses_what_leaves_a_pose_free(group: LieGroup) -> None:
    graph, values = without_rotation(group), Values({x: (group, group.identity(4))})
    with pytest.raises(UnderconstrainedError, match="chordal relaxation: some poses have no rotation"):
        chordal(graph, values)
    said = "start 'chordal' was left out: chordal relaxation: some poses have no rotation"
    with pytest.warns(GraphWarning, match=said) as caught:
        _, name, chi2 = initialize(graph, values)
    assert [warning.filename for warning in caught] == [__file__]
    assert set(chi2) == {"file", "odometry"}
    assert name == "odometry"


@pytest.mark.parametrize("group", PLACES, ids=str)
def test_chordal_keeps_rotations_that_shrink_along_the_way(group: LieGroup) -> None:
    """A ladder of 250 noisy squares: each halves the relaxed rotations, down to 1e-50, and leaves their directions."""
    n, d, rng = 250, group.point_dim, np.random.default_rng(0)
    k = np.arange(n)
    i = np.concatenate([2 * k[:-1], 2 * k[:-1] + 1, 2 * k])
    j = np.concatenate([2 * k[1:], 2 * k[1:] + 1, 2 * k + 1])
    noise = rng.normal(size=(len(i), group.dim)) * np.repeat([0.01, 0.7], [d, group.dim - d])
    graph = FactorGraph([Between(x[i], x[j], group.exp(noise), Isotropic(0.1))])
    values, name, chi2 = initialize(graph, Values({x: (group, group.identity(2 * n))}))
    assert (name, chi2["chordal"]) == ("chordal", graph.chi2(values))
    assert chi2["chordal"] < 0.7 * chi2["odometry"]
    M = rng.normal(size=(50, 3, 3))
    for scale in (1e-150, 1.0, 1e100):
        R, size = nearest_rotation(M * scale)
        np.testing.assert_allclose(R, nearest_rotation(M)[0], rtol=0, atol=1e-12)
        np.testing.assert_allclose(size, nearest_rotation(M)[1] * scale, rtol=1e-12)


def test_chordal_refuses_rotations_that_cancel() -> None:
    back = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, -np.pi]])
    graph = FactorGraph([Between(x[[0, 0]], x[[1, 1]], back, Isotropic(1))])
    with pytest.raises(UnderconstrainedError, match="contradicting rotations cancel"):
        chordal(graph, Values({x: (SE2, SE2.identity(2))}))


@pytest.mark.parametrize("group", PLACES, ids=str)
def test_chordal_without_suitesparse(group: LieGroup, monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib

    sample = pose_graph(group, n=20, seed=9)
    expected = chordal(sample.graph, sample.values)[x]
    monkeypatch.setattr(importlib.import_module("nls.linear.cholesky"), "cholmod", lambda: None)
    assert distance(group, expected, chordal(sample.graph, sample.values)[x]) < 1e-9


def test_graphs_without_relative_poses_keep_their_values() -> None:
    graph = FactorGraph([Prior(l[0], [1.0, 2.0], Diagonal([0.1, 0.1]))])
    graph.add(Factor.from_function(lambda a: a - 1.0, l[0], 2))
    values = Values({l: (R(2), [[5.0, 5.0]])})
    for method in STARTS.values():
        assert np.array_equal(method(graph, values)[l], [[5.0, 5.0]])
    assert initialize(graph, values)[1] == "file"


def test_landmarks_stay_and_poses_move() -> None:
    sample = pose_graph(SE2, start=1.0)
    stack = sample.values.stacks["x"]
    values = Values({l: (R(2), [[3.0, 4.0]]), x: (SE2, stack.X)})
    sample.graph.add(Seen(x[0], l[0], in_frame(stack.X[:1], np.array([[3.0, 4.0]])), Isotropic(0.1)))
    for method in (chain, spanning_tree, chordal):
        found = method(sample.graph, values)
        assert np.array_equal(found[l], values[l])
        assert not np.array_equal(found[x], values[x])


def test_a_start_does_not_share_the_memory_of_the_callers_values() -> None:
    sample = pose_graph(SE2)
    stack = sample.values.stacks["x"]
    values = Values({l: (R(2), [[3.0, 4.0]]), x: (SE2, stack.X)})
    found = chordal(sample.graph, values)
    found[l[0]] = [9.0, 9.0]
    assert values[l[0]].tolist() == [3.0, 4.0]


def test_the_nearest_rotation_is_never_a_reflection() -> None:
    """Of all rotations the one with the largest trace of R'M, also where M turns space inside out."""
    rng = np.random.default_rng(10)
    M = rng.normal(size=(40, 3, 3))
    assert (np.linalg.det(M) < 0).sum() > 5
    found, size = nearest_rotation(M)
    np.testing.assert_allclose(np.linalg.det(found), 1.0, rtol=1e-12)
    np.testing.assert_allclose(found @ found.mT, np.broadcast_to(np.eye(3), (40, 3, 3)), rtol=0, atol=1e-12)
    others = SE3.rotation(walk(SE3, 300, rng))
    best = np.einsum("nij,nij->n", found, M)
    assert (np.einsum("kij,nij->nk", others, M) <= best[:, None] + 1e-12).all()
    assert (size > 0).all()
