"""The EKF against the batch solution where both are exact, and its parts against the dense formulas."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from factors import (
    BearingRange,
    Between,
    Diagonal,
    Heading,
    Isotropic,
    Landmark,
    Position,
    Prior,
    Wheels,
)
from factors.keys import Keys
from models import SE2, SE3, LieGroup, R
from models.algebra import Array
from models.errors import EvaluationError
from nls import FactorGraph, Marginals, Values, kinds
from nls.filters.base import Track, steps
from nls.filters.ekf import EKF
from nls.filters.map_state import MapState
from tests.combinations import for_all
from tests.nls.graphs import walk
from tests.sim.scenes import thinned

x, l = kinds("x", "l")
Scene = tuple[FactorGraph, Values, Values]


def scene(group: LieGroup, sigma: float, seed: int, loops: int = 2) -> Scene:
    """A walk there and back `loops` times past four landmarks, measured with a sigma so small that all is linear."""
    rng = np.random.default_rng(seed)
    X = np.concatenate([walk(group, 6, rng), walk(group, 6, rng)])[: 6 * loops]
    n, d = len(X), group.point_dim
    L = rng.normal(size=(4, d)) * 3
    noise = Diagonal(sigma * rng.uniform(0.5, 2.0, size=group.dim))
    steps_ = group.retract(group.between(X[:-1], X[1:]), sigma * rng.normal(size=(n - 1, group.dim)))
    i, k = np.divmod(np.arange(4 * n), 4)
    kept = rng.uniform(size=4 * n) < 0.6
    i, k = i[kept], k[kept]
    z = group.act(group.inverse(X[i]), L[k]) + sigma * rng.normal(size=(len(i), d))
    graph = FactorGraph(
        [
            Prior(x[0], group.retract(X[:1], sigma * rng.normal(size=(1, group.dim))), Isotropic(sigma)),
            Between(x[0 : n - 1], x[1:n], steps_, noise),
            Landmark(x[i], l[k], z, Diagonal(sigma * rng.uniform(0.5, 2.0, size=d))),
            Position(x[[n // 2]], group.position(X[[n // 2]]) + sigma, Isotropic(3 * sigma)),
        ]
    )
    truth = Values({x: (group, X), l: (R(d), L)})
    return graph, truth, Values({x: (group, X), l: (R(d), L + 0.1)})


def agrees(track: Track, graph: FactorGraph, start: Values, rtol: float, relative: float) -> None:
    """Mean (in sigmas) and covariance of last pose and landmarks are those of the batch."""
    best = graph.optimize(start).values
    marginals = Marginals(graph, best)
    last = track.x[[len(track.x) - 1]]
    P = marginals.covariance(last, frame="body")[0]
    sigma = np.sqrt(np.diag(P))
    away = track.manifold.local(best[last], track.X[-1:])[0]
    assert np.abs(away / sigma).max() < relative
    assert np.abs(track.P[-1] - P).max() < rtol * np.abs(P).max()
    P_l = marginals.covariance(track.landmarks)
    assert np.abs(track.P_landmarks - P_l).max() < rtol * np.abs(P_l).max()
    away_l = track.values[track.landmarks] - best[track.landmarks]
    assert (np.abs(away_l) / np.sqrt(np.diagonal(P_l, axis1=1, axis2=2))).max() < relative


def test_it_is_the_batch_solution_of_a_linear_problem() -> None:
    rng = np.random.default_rng(7)
    n = 9
    noise = Diagonal([0.3, 0.1])
    graph = FactorGraph(
        [
            Prior(x[0], [1.0, 2.0], Isotropic(0.5)),
            Between(x[0 : n - 1], x[1:n], rng.normal(size=(n - 1, 2)), noise),
            Prior(l[[4, 2]], [[3.0, 3.0], [-1.0, 0.0]], Diagonal([[5.0, 2.0], [1.0, 1.0]])),
            Between(x[[3, 5, 5, 8, 8]], l[[4, 4, 2, 2, 4]], rng.normal(size=(5, 2)), Isotropic(0.2)),
            Prior(x[[4]], [[9.0, 0.0]], Isotropic(0.7), components=("y",)),
            Prior(l[2], [-2.0, 1.0], Isotropic(3.0)),  # a second one of the same landmark
        ]
    )
    values = Values({x: (R(2), np.zeros((n, 2))), l: (R(2), np.zeros((2, 2)), [2, 4])})
    for options in ({}, {"first_estimates": True}, {"landmarks": "independent"}):
        track = EKF(**options).run(graph, values)  # type: ignore[arg-type]
        agrees(track, graph, values, rtol=1e-10, relative=1e-9)
        assert sorted(track.landmarks.numbers.tolist()) == [2, 4]


@for_all(group=[SE2, SE3], first_estimates=[False, True])
def test_it_is_the_batch_solution_where_noise_is_small(group: LieGroup, first_estimates: bool) -> None:
    """Landmarks are added with their correlations: 1e-6 of noise leaves 1e-4 of nonlinearity at most."""
    for seed in (0, 1):
        graph, _, start = scene(group, 1e-6, seed)
        track = EKF(first_estimates=first_estimates).run(graph, start)
        agrees(track, graph, start, rtol=2e-4, relative=2e-4)


def test_bearings_and_lines_and_wheels_too() -> None:
    world = sim.lines(np.random.default_rng(0), laps=1, noise_scale=1e-4)
    track = EKF().run(world.graph, world.start)
    agrees(track, world.graph, world.start, rtol=3e-3, relative=1e-2)
    world = sim.subsea(np.random.default_rng(0), laps=1, known_start=True, azimuth="absolute", noise_scale=1e-4)
    agrees(EKF().run(world.graph, world.start), world.graph, world.start, rtol=3e-3, relative=1e-2)


def test_a_landmark_seen_twice_from_where_it_is_seen_first() -> None:
    X = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.3]])
    graph = FactorGraph(
        [
            Prior(x[0], X[0], Isotropic(1e-5)),
            Between(x[0], x[1], SE2.between(X[0], X[1]), Isotropic(1e-5)),
            Landmark(x[[1, 1, 0]], l[[5, 5, 6]], [[2.0, 1.0], [2.0, 1.00001], [1.0, 1.0]], Isotropic(1e-5)),
            BearingRange(
                x[[1, 1]], l[[5, 6]], [[np.arctan2(1, 2), 5**0.5], [np.pi - 0.3 - np.pi / 2, 1.0]], Isotropic(2e-5)
            ),
        ]
    )
    values = Values({x: (SE2, X), l: (R(2), np.zeros((2, 2)), [5, 6])})
    agrees(EKF().run(graph, values), graph, values, rtol=1e-3, relative=1e-3)


def test_one_step_at_a_time_is_the_run() -> None:
    graph, _, start = scene(SE2, 0.05, 3)
    track, ekf = EKF().run(graph, start), EKF()
    cut = steps(graph, start)
    ekf.start(cut[0], start)
    for step, X, P in zip(cut[1:], track.X[1:], track.P[1:], strict=True):
        ekf.step(step)
        assert np.array_equal(ekf.pose[0], X)
        assert np.array_equal(ekf.pose[1], P)
    assert np.array_equal(ekf.state.P, ekf.state.P.T)
    assert np.linalg.eigvalsh(ekf.state.P).min() > 0
    again = ekf.run(graph, start)  # a filter that was used starts anew
    assert np.array_equal(again.X, track.X)


def state_of(m: int, seed: int = 0) -> MapState:
    """A pose and m landmarks with a full random covariance."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3 + 2 * m, 3 + 2 * m))
    P = A @ A.T
    state = MapState((SE2, R(2)), np.array([1.0, 2.0, 0.5]), P[:3, :3], False)
    if m:
        state.add(np.arange(m), rng.normal(size=(m, 2)), np.zeros((m, 2, 3)), np.tile(np.eye(2), (m, 1, 1)))
        state.P[:] = P
    return state


def test_the_prediction_is_the_dense_one() -> None:
    rng = np.random.default_rng(1)
    state, F, Q = state_of(7), rng.normal(size=(3, 3)), np.diag([1.0, 2.0, 3.0])
    whole = np.eye(17)
    whole[:3, :3] = F
    noise = np.zeros((17, 17))
    noise[:3, :3] = Q
    expected = whole @ state.P @ whole.T + noise
    state.predict(np.zeros(3), F, Q)
    assert np.allclose(state.P, expected, rtol=1e-13)
    assert np.array_equal(state.P, state.P.T)


def test_the_prediction_neither_reads_nor_writes_the_map() -> None:
    """O(n): of the (3 + 2m)^2 numbers of P it touches three rows and three columns."""
    state = state_of(50)
    state.P[3:, 3:] = np.nan
    state.predict(np.zeros(3), np.diag([1.0, 2.0, 3.0]), np.eye(3))
    assert np.isfinite(state.P[:3]).all()
    assert np.isfinite(state.P[:, :3]).all()
    assert np.isnan(state.P[3:, 3:]).all()


def test_adding_and_updating_are_the_dense_ones() -> None:
    rng = np.random.default_rng(2)
    state, G, Q = state_of(3), rng.normal(size=(2, 2, 3)), np.tile(np.eye(2) * 0.3, (2, 1, 1))
    T = np.zeros((13, 9))
    T[:9] = np.eye(9)
    T[9:, :3] = G.reshape(4, 3)
    expected = T @ state.P @ T.T
    expected[9:, 9:] += np.kron(np.eye(2), Q[0])
    state.add(np.array([8, 20]), np.zeros((2, 2)), G, Q)
    assert np.allclose(state.P, expected, rtol=1e-13)
    assert state.rows(np.array([20, 1, 5, 8])).tolist() == [4, 1, -1, 3]

    A, b, columns = rng.normal(size=(4, 5)), rng.normal(size=4), np.array([0, 1, 2, 9, 10])
    H = np.zeros((4, 13))
    H[:, columns] = A
    S = H @ state.P @ H.T + np.eye(4)
    K = state.P @ H.T @ np.linalg.inv(S)
    L, after = state.L.copy(), state.P - K @ S @ K.T
    delta = K @ b
    theta = state.X[2]
    state.update(A, columns, b, x[0])
    assert np.allclose(state.L, L + delta[3:].reshape(5, 2))
    assert np.allclose(state.X, SE2.retract(np.array([[1.0, 2.0, 0.5]]), delta[None, :3])[0])
    turned = np.eye(13)  # the axes of the body have turned
    c, s = np.cos(state.X[2] - theta), np.sin(state.X[2] - theta)
    turned[:2, :2] = [[c, s], [-s, c]]
    assert np.allclose(state.P, turned @ after @ turned.T)


def test_the_frame_of_the_world_does_not_matter() -> None:
    """Headings and bearings that cross +-pi somewhere else."""
    world = thinned(sim.subsea(np.random.default_rng(4), laps=1, known_start=True))
    plain = EKF().run(world.graph, world.start)
    for turn in (1.0, -2.0):
        T = np.array([[30.0, -20.0, turn]])
        first = Prior(x[0], SE2.compose(T, world.first.z), world.first.noise)
        graph = FactorGraph([first, *world.graph.factors[1:]])
        moved = EKF().run(graph, world.start)
        assert np.allclose(SE2.local(SE2.compose(T, plain.X), moved.X), 0, atol=1e-8)
        assert np.allclose(moved.P, plain.P, rtol=1e-6, atol=1e-12)


def sigma_of_common_heading(X: Array, L: Array, P: Array) -> float:
    """Least sigma, rad, of a rotation of everything together, wherever its center is: motions N, (N' P^-1 N)^-1."""
    shifts, turns = np.tile(np.eye(2), (len(L), 1)), np.stack([-L[:, 1], L[:, 0]], axis=1).reshape(-1, 1)
    N = np.concatenate([SE2.adjoint_inverse(X[None])[0], np.concatenate([shifts, turns], axis=1)])
    return float(np.sqrt(np.linalg.inv(N.T @ np.linalg.solve(P, N))[2, 2]))


def test_first_estimates_learn_nothing_about_a_rotation_of_everything() -> None:
    """What is known of the heading of everything is the prior, 0.5 deg; relative measurements add nothing to it."""
    world = thinned(sim.subsea(np.random.default_rng(0)))
    best = world.graph.optimize(world.start).values
    joint = Marginals(world.graph, best).joint([x[60], l[0:6]], frame="body")
    batch = sigma_of_common_heading(best[x[60]], best[l], joint.matrix)
    assert np.radians(0.5) < batch < np.radians(0.52)
    sigma = {}
    for first_estimates in (False, True):
        ekf = EKF(first_estimates=first_estimates)
        ekf.run(world.graph, world.start)
        state = ekf.state
        sigma[first_estimates] = sigma_of_common_heading(state.first, state.L_first, state.P)
    assert sigma[True] == pytest.approx(batch, rel=5e-4)
    assert sigma[False] < 0.98 * batch


def test_wheels_and_a_turn_rate_are_one_motion_together() -> None:
    """Several relative factors between two poses add up; what they say of the pose before, beside, is refused."""
    graph = FactorGraph(
        [
            Prior(x[0], [0, 0, 0.4], Isotropic(1e-5)),
            Wheels(x[0], x[1], [1.1, 0.9], Diagonal([1e-5, 1e-5, 1e-6]), base=0.5),
            Between(x[0], x[1], SE2.exp([0.98, 0.2, 0.4]), Isotropic(1e-5)),
        ]
    )
    values = Values({x: (SE2, SE2.identity(2))})
    track = EKF().run(graph, values)
    best = graph.optimize(values).values
    assert np.allclose(track.X[1], best[x[1]], atol=1e-9)
    assert np.allclose(track.P[1], Marginals(graph, best).covariance(x[1], frame="body"), rtol=1e-2, atol=1e-14)


def test_numbers_that_are_not_finite_name_the_step() -> None:
    state = state_of(2)
    state.P[0, 0] = np.nan
    with pytest.raises(EvaluationError, match=r"EKF at x17: the covariance of its innovations is not finite"):
        state.update(np.eye(1, 3), np.arange(3), np.zeros(1), Keys("x", 17))
    state.P[0, 0] = -5.0
    with pytest.raises(EvaluationError, match=r"EKF at x17: the covariance of its innovations is not positive"):
        state.update(np.eye(1, 3), np.arange(3), np.zeros(1), Keys("x", 17))


def test_all_that_is_known_of_the_first_pose_counts() -> None:
    """Several priors of it, two of them in one factor, before and after what is seen from it."""
    graph = FactorGraph(
        [
            Heading(x[[0, 0]], [3.1, -3.1], Isotropic([0.1, 0.2])),
            Landmark(x[[0, 0]], l[[0, 1]], [[1.0, 0.0], [2.0, 0.0]], Isotropic(0.1)),
            Position(x[[0, 0]], [[1.0, 2.0], [1.2, 2.0]], Isotropic(0.1)),
            Prior(x[0], [0.9, 2.0, 3.1], Isotropic(1.0)),
        ]
    )
    values = Values({x: (SE2, [0, 0, 3.0]), l: (R(2), np.zeros((2, 2)))})
    agrees(EKF().run(graph, values), graph, values, rtol=1e-6, relative=1e-6)


def test_headings_wrap() -> None:
    graph = FactorGraph([Prior(x[0], [0, 0, 3.1], Isotropic(0.1)), Heading(x[0], -3.1, Isotropic(0.1))])
    track = EKF().run(graph, Values({x: (SE2, [0, 0, 3.0])}))
    assert abs(abs(track.X[0, 2]) - np.pi) < 1e-9
    assert track.P[0, 2, 2] == pytest.approx(0.005)
