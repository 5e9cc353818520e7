"""The EKF against the batch solution where both are exact, and its parts against the dense formulas."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from factors import BearingRange, Between, Diagonal, Heading, Isotropic, Landmark, Position, Prior
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
