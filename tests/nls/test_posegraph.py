"""Relative poses as arrays: which are odometry, their covariances and weights, and the trees along them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

import factors as f
import nls
import sim
from factors import Between, BetweenSensors, Diagonal, Factor, Information, Isotropic, Noise, Prior, Wheels
from factors.base import Jacobians, Model
from factors.keys import Keys
from models import SE2, SE3, LieGroup, Manifold, Measured
from models.algebra import Array, Index
from models.errors import GraphError
from models.vehicles import wheel_travel
from nls import FactorGraph, Values
from nls.analysis.leave_one_out import kinds_of
from nls.posegraph import Edges, PoseGraph, closures, odometry, pose_graphs
from nls.robust.loop_graph import refuse_infinite
from tests.nls.graphs import informations, walk, x, y

RNG = np.random.default_rng
UNIT = Isotropic(1)
PLACES = (SE2, SE3)


def posed(group: LieGroup, i: list[int], j: list[int], n: int, fixed: tuple[int, ...] = ()) -> tuple[PoseGraph, Array]:
    """Exact edges between poses 0 to n - 1 of a walk."""
    X = walk(group, n, RNG(0))
    graph = FactorGraph([Between(x[i], x[j], group.between(X[i], X[j]), UNIT)])
    if fixed:
        graph.fix(x[list(fixed)])
    (poses,) = pose_graphs(graph, Values({x: (group, X)}))
    return poses, X


def test_neighbors_in_number_are_odometry_and_other_relative_poses_closures() -> None:
    numbers = np.array([30, -5, 10, 20])  # in order: -5, 10, 20, 30
    z, level = [1.0, 0.0, 0.0], ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    steps = Between(x[[-5, 20, -5]], x[[10, 10, 20]], z, UNIT)  # ahead, back, a jump
    sensors, apart = BetweenSensors(x[[30, 30]], x[[20, -5]], z, UNIT, level), Between(y[0], y[1], z, UNIT)
    across = Between(x[[-5, 30]], y[[0, 0]], z, UNIT)  # y0 follows x30 in the stack
    graph = FactorGraph([steps, Prior(x[30], z, UNIT), sensors, across, apart])
    pattern = graph.pattern(Values({x: (SE2, np.zeros((4, 3)), numbers), y: (SE2, np.zeros((2, 3)))}))
    along = [[True, True, False], [False], [True, False], [False, False], [True]]
    others = [[False, False, True], [False], [False, True], [True, True], [False]]
    assert [mask.tolist() for mask in odometry(pattern)] == along
    assert [mask.tolist() for mask in closures(pattern)] == others
    assert closures(FactorGraph([]).pattern(Values())) == []


def test_nodes_are_the_stacks_one_after_the_other() -> None:
    X, Y = walk(SE2, 3, RNG(0)), walk(SE2, 2, RNG(1))
    graph = FactorGraph([Between(y[[3, 1]], x[[9, 7]], [1.0, 0, 0], UNIT), Between(x[8], x[9], [2.0, 0, 0], UNIT)])
    graph.fix(x[9])
    values = Values({y: (SE2, Y, np.array([3, 1])), x: (SE2, X, np.array([9, 7, 8])), "s": (SE3, SE3.identity(1))})
    (poses,) = pose_graphs(graph, values)
    assert (poses.kinds, poses.n) == (("y", "x"), 5)
    assert (poses.i.tolist(), poses.j.tolist(), poses.z[:, 0].tolist()) == ([0, 1, 4], [2, 3, 2], [1, 1, 2])
    assert (poses.order.tolist(), poses.place.tolist()) == ([1, 0, 3, 4, 2], [1, 0, 4, 2, 3])
    assert poses.fixed.tolist() == [False, False, True, False, False]
    assert poses.roots.tolist() == [2, 1]  # the fixed one, and the first in order of y1 - x7
    assert poses.odometry.tolist() == [False, False, True]
    assert [part.tolist() for part in poses.by_batch(poses.i)] == [[0, 1], [4]]
    np.testing.assert_array_equal(poses.stack(values), [*Y, *X])
    other = poses.replaced(values, poses.stack(values) + 1)
    np.testing.assert_array_equal(other[x[[9, 7, 8]]], X + 1)
    np.testing.assert_array_equal(other[y[[3, 1]]], Y + 1)


@pytest.mark.parametrize("group", PLACES, ids=str)
def test_covariances_are_those_of_a_motion_of_the_end(group: LieGroup) -> None:
    rng, d, h, k = RNG(2), group.dim, 1e-6, np.arange(4)
    T_i, z = walk(group, 4, rng), walk(group, 4, rng)
    ends, noise = group.compose(T_i, z), Information(informations(4, d, rng))
    values = Values({x: (group, T_i), y: (group, ends)})
    for convention in ("log", "g2o", "graphslam", "gtsam"):
        factor = Between(x[k], y[k], z, noise, convention)
        (poses,) = pose_graphs(FactorGraph([factor]), values)
        error, steps = values.gather(factor)[0].error, h * np.eye(d)[:, None] * np.ones((4, 1))
        A = [(error(T_i, group.retract(ends, s)) - error(T_i, group.retract(ends, -s))) / (2 * h) for s in steps]
        expected = np.linalg.inv(np.einsum("ank,bnk->nab", A, A))
        np.testing.assert_allclose(poses.C, expected, rtol=1e-6, atol=1e-9 * expected.max())


def test_a_covariance_needs_information_of_every_component_in_units_of_its_own() -> None:
    weights = [np.diag([4.0, 4.0, 1e20]), np.diag([4.0, 0.0, 1e4])]
    edges = [Between(x[[0]], x[[1]], [1.0, 0, 0], Information(M), convention="gtsam") for M in weights]
    values = Values({x: (SE2, np.zeros((2, 3)))})
    (poses,) = pose_graphs(FactorGraph(edges[:1]), values)
    np.testing.assert_allclose(poses.C[0], np.diag([0.25, 0.25, 1e-20]))
    (poses,) = pose_graphs(FactorGraph(edges), values)
    assert np.isfinite(poses.C).all(axis=(1, 2)).tolist() == [True, False]
    refuse_infinite(poses, np.array([0]))
    with pytest.raises(GraphError, match=r"^Between\(x0, x1\): its weights say nothing of one of its components"):
        refuse_infinite(poses, np.array([0, 1]))


def test_every_group_has_a_pose_graph_by_name() -> None:
    space, plane = Between(y[0], y[1], SE3.identity(1), UNIT), Between(x[[0, 1]], x[[1, 2]], [1.0, 0, 0], UNIT)
    values = Values({x: (SE2, np.zeros((3, 3))), y: (SE3, SE3.identity(2))})
    for factors in ([space, plane, space], [plane, space, space]):
        graphs = pose_graphs(FactorGraph(factors), values)
        assert [(poses.group, poses.n, len(poses.i)) for poses in graphs] == [(SE2, 3, 2), (SE3, 2, 2)]
    factor = BetweenSensors(x[[0, 1, 0]], x[[1, 2, 2]], np.zeros((3, 3)), UNIT, y[0])  # from a place nobody knows
    values = Values({x: (SE2, np.zeros((3, 3))), y: (SE2, np.zeros((1, 3)))})
    assert list(pose_graphs(FactorGraph([factor]), values)) == []
    assert closures(FactorGraph([factor]).pattern(values))[0].tolist() == [False, False, True]


def test_pose_graphs_are_kept_until_other_poses_are_fixed() -> None:
    graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], [1.0, 0, 0], UNIT)])
    values = Values({x: (SE2, np.zeros((3, 3)))})
    (poses,) = pose_graphs(graph, values)
    moved = values.copy()
    moved[x[1]] = [5.0, 5.0, 1.0]
    assert pose_graphs(graph, moved)[0] is poses  # the same variables, wherever they are
    graph.fix(x[2])
    (held,) = pose_graphs(graph, values)
    assert (poses.roots.tolist(), held.roots.tolist()) == ([0], [2])
    graph.release(x[2])
    assert pose_graphs(graph, values)[0].roots.tolist() == [0]
    graph.add(Between(x[0], x[2], [2.0, 0, 0], UNIT))
    assert len(pose_graphs(graph, values)[0].i) == 3


@pytest.mark.parametrize("group", PLACES, ids=str)
def test_an_edge_turned_forward_says_the_same(group: LieGroup) -> None:
    rng, d = RNG(3), group.dim
    z, C = walk(group, 2, rng), informations(2, d, rng)
    edges = Edges(group, np.array([5, 1]), np.array([2, 4]), z, C).forward()
    assert (edges.i.tolist(), edges.j.tolist()) == ([2, 1], [5, 4])
    np.testing.assert_array_equal(edges.z[1], z[1])
    np.testing.assert_array_equal(edges.C[1], C[1])
    L = 1e-6 * np.linalg.cholesky(C[0]).T  # rows xi: an end that is off by xi puts the beginning off by eta
    eta = group.log(group.between(edges.z[[0]], group.inverse(group.compose(z[[0]], group.exp(L)))))
    np.testing.assert_allclose(1e12 * eta.T @ eta, edges.C[0], rtol=1e-4, atol=1e-4)
    both = edges[np.array([False, True])].joined(edges[np.array([0])])
    assert (len(both), both.i.tolist(), both.j.tolist()) == (2, [1, 2], [4, 5])
    np.testing.assert_array_equal(both.C, edges.C[::-1])


@pytest.mark.parametrize("group", PLACES, ids=str)
def test_weights_are_means_of_information_and_of_covariance(group: LieGroup) -> None:
    D, d, rng = group.dim, group.point_dim, RNG(4)
    I, z = informations(2, D, rng), walk(group, 2, rng)
    noises = [Information(I), Diagonal(np.arange(1.0, D + 1)), f.SqrtInformation(np.linalg.cholesky(I[0]).T)]
    graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], z, noise) for noise in noises])
    (poses,) = pose_graphs(graph, Values({x: (group, walk(group, 3, rng))}))
    Omega = np.array([*I, *2 * [np.diag(np.arange(1.0, D + 1) ** -2)], I[0], I[0]])
    kappa, tau = poses.mean_weights()
    np.testing.assert_allclose(kappa, [np.trace(M[d:, d:]) / (D - d) for M in Omega])
    np.testing.assert_allclose(tau, [np.trace(M[:d, :d]) / d for M in Omega])
    kappa, tau = poses.isotropic_weights()
    np.testing.assert_allclose(tau, [d / np.trace(np.linalg.inv(M[:d, :d])) for M in Omega])
    inverse = [np.trace(np.linalg.inv(M[d:, d:])) for M in Omega]
    np.testing.assert_allclose(kappa, [1 / t if d == 2 else 1.5 / t for t in inverse])
    blind = np.array([np.diag([1.0, 0, 1]), np.diag([1.0, 1, 0]), np.eye(3), [[1.0, 1, 0], [1, 1, 0], [0, 0, 1]]])
    graph = FactorGraph([Between(x[[0, 0, 0, 0]], x[[1, 1, 1, 1]], [1.0, 0, 0], Information(blind))])
    (poses,) = pose_graphs(graph, Values({x: (SE2, np.zeros((2, 3)))}))
    kappa, tau = poses.isotropic_weights()  # without an inverse they are zero
    assert (kappa.tolist(), tau.tolist()) == ([1, 0, 1, 1], [0, 1, 1, 0])


def test_odometry_bridges_a_gap_by_the_shortest_jump() -> None:
    poses, _ = posed(SE3, [0, 4, 1, 0, 2, 2], [1, 3, 2, 4, 0, 4], 5)  # 2 to 3 is missing; 2 to 4 jumps over less
    parent, edge = poses.odometry_tree()
    assert (parent.tolist(), edge.tolist()) == ([-1, 0, 1, 4, 2], [-1, 0, 2, 1, 5])


class Counts(Factor):
    """An odometer that nobody has announced: 100 counts a meter ahead, a meter to the left, a radian of turn."""

    slots = (SE2, SE2)
    relative = True

    def __init__(self, i: Keys, j: Keys, z: npt.ArrayLike, noise: Noise) -> None:
        super().__init__([i, j], z, noise)

    def space(self, manifolds: tuple[Manifold, ...]) -> Manifold:
        return Measured("ahead", "left", "turn")

    def predict(self, manifolds: tuple[Manifold, ...], *X: Array) -> tuple[Array, Jacobians]:
        h = SE2.between(*X)
        H_j = np.zeros((len(h), 3, 3))
        H_j[:, :2, :2], H_j[:, 2, 2] = 100 * SE2.rotation(h), 100
        return 100 * h, (-H_j @ SE2.adjoint_inverse(h), H_j)

    def relative_poses(self, model: Model) -> Array:
        return model.z / 100


def square(rng: np.random.Generator) -> tuple[Index, Index, Array]:
    """Ends i and j of 120 steps, five times around a square, and of 20 closures, and z; the last closure is wrong."""
    X = sim.chain(SE2, np.zeros(3), np.tile([[1.0, 0, 0], [1, 0, 0], [1, 0, np.pi / 2]], (40, 1)))
    i, j = np.r_[np.arange(120), np.arange(0, 100, 5)], np.r_[np.arange(1, 121), np.arange(12, 112, 5)]
    z = SE2.compose(SE2.between(X[i], X[j]), SE2.exp(0.01 * rng.normal(size=(140, 3))))
    z[-1] += [0.8, -0.9, 0.7]
    return i, j, z


@pytest.mark.parametrize("kind", ["counts", "wheels", "sensors"])
def test_an_odometer_that_says_its_poses_is_one_of_ours(kind: str) -> None:
    """Starts chain it, gnc judges its closures, explain names the wrong one: as of a `Between`."""
    i, j, z = square(RNG(6))
    O = np.array([0.5, 0.2, 0.3])
    factor = {
        "counts": lambda: Counts(x[i], x[j], 100 * z, Isotropic(1.0)),
        "wheels": lambda: Wheels(x[i], x[j], wheel_travel(SE2.identity(140), z, 0.5)[0], Isotropic(0.01), 0.5),
        "sensors": lambda: BetweenSensors(
            x[i], x[j], SE2.compose(SE2.compose(SE2.inverse(O[None]), z), O[None]), Isotropic(0.01), (O, O)
        ),
    }[kind]()
    values = Values({x: (SE2, np.zeros((121, 3)))})
    graph, ours = FactorGraph([factor]), FactorGraph([Between(x[i], x[j], z, Isotropic(0.01))])
    (poses,), (expected,) = pose_graphs(graph, values), pose_graphs(ours, values)
    np.testing.assert_allclose(poses.z, expected.z, atol=1e-12)
    np.testing.assert_array_equal(poses.odometry, expected.odometry)
    for start, atol in (("odometry", 1e-9), ("chordal", 0.2)):  # m and rad; the weights of wheels are of their own
        track, expected_track = (nls.initialize(g, values, start)[0][x] for g in (graph, ours))
        np.testing.assert_allclose(SE2.local(track, expected_track), 0, atol=atol)
    robust = nls.gnc(graph, values)
    assert [len(robust.rejected), np.flatnonzero(robust.weights[0] == 0).tolist()] == [1, [139]]
    findings = nls.explain(graph, graph.optimize(nls.initialize(graph, values)[0]).values).findings
    (finding,) = [f for f in findings if f.kind is nls.FindingKind.WRONG_CLOSURE]
    assert finding.measurements == ((0, 139),)


def test_sequential_matches_are_neither_odometry_nor_closures() -> None:
    """Matches are a kind of their own, and gnc doubts the closures beside them alone, whichever factor comes first."""
    i, j, z = square(RNG(6))
    k = np.arange(0, 117, 2)
    near = SE2.compose(SE2.compose(z[k], z[k + 1]), z[k + 2])
    near = SE2.compose(near, SE2.exp(0.02 * RNG(2).normal(size=near.shape)))
    poses, matches = Between(x[i], x[j], z, Isotropic(0.01)), f.SequentialMatch(x[k], x[k + 3], near, Isotropic(0.02))
    for order in (1, -1):
        graph, values = FactorGraph([poses, matches][::order]), Values({x: (SE2, np.zeros((121, 3)))})
        pattern = graph.pattern(values)
        assert [int(mask.sum()) for mask in odometry(pattern)][::order] == [120, 0]
        assert [int(mask.sum()) for mask in closures(pattern)][::order] == [20, 0]
        (both,) = pose_graphs(graph, values)
        assert [int(mask.sum()) for mask in (both.odometry, both.closures)] == [120, 20]
        kinds = {name: sum(len(index) for _, index in rows) for name, rows in kinds_of(pattern, 2).items()}
        assert kinds == {"Between, steps": 120, "Between, closures": 20, "SequentialMatch": len(k)}
        robust = nls.gnc(graph, values)
        assert (robust.doubted, [r.factor for r in robust.rejected]) == (20, ["Between(x95, x107)"])


def test_poses_of_another_shape_are_refused_by_name() -> None:
    class OneRow(Counts):
        def relative_poses(self, model: Model) -> Array:
            return model.z[0] / 100

    graph = FactorGraph([OneRow(x[[0, 1]], x[[1, 2]], [[100.0, 0, 0]] * 2, Isotropic(1.0))])
    with pytest.raises(GraphError, match=r"OneRow.*returned an array of shape \(3,\), expected \(2, 3\), poses in SE2"):
        nls.starts.chain(graph, Values({x: (SE2, np.zeros((3, 3)))}))
