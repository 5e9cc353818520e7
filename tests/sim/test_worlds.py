"""Worlds: the same bits for a seed, truth that fits its measurements, graphs that can be solved."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from models import SE2, SE3, LieGroup
from models.errors import GraphError
from nls import Values, kinds
from sim.cli import WORLDS
from tests.combinations import for_all
from tests.sim.scenes import made

(x,) = kinds("x")
DEFAULT_POSES = {"manhattan": 3500, "grid3d": 2000, "ring": 400, "sphere": 2500, "torus": 5000}


def test_default_sizes() -> None:
    for name, poses in DEFAULT_POSES.items():
        world = WORLDS[name](np.random.default_rng(0))
        assert world.poses == poses
        assert f"{poses} poses" in world.description
        assert world.closures > 0.2 * poses
        assert sim.position_error(world.start, world.truth) > 1.0  # odometry alone gets lost


@for_all(name=WORLDS)
def test_odometry_chains_to_the_start_and_loops_close(name: str) -> None:
    world = made(name)
    odometry, closures = world.graph.factors
    i, j = (k.numbers for k in odometry.keys)
    np.testing.assert_array_equal(i, np.arange(world.poses - 1))
    np.testing.assert_array_equal(j, i + 1)
    group, X = world.truth.stack("x").manifold, world.start[x]
    np.testing.assert_array_equal(X[0], world.truth[x][0])
    np.testing.assert_allclose(group.local(group.between(X[:-1], X[1:]), odometry.z), 0.0, atol=1e-9)
    i, j = (k.numbers for k in closures.keys)
    assert world.closures == len(i) > 0
    assert (np.abs(i - j) > 1).all()
    pairs = np.sort(np.stack([i, j], axis=1), axis=1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    if name in (radius := {"manhattan": 1.5, "grid3d": 1.5, "ring": 1.0}):  # near poses, far apart in time
        p = group.position(world.truth[x])
        assert np.linalg.norm(p[i] - p[j], axis=1).max() <= radius[name]
        assert (j - i).min() >= 10


def test_manhattan_moves_forward_and_turns_at_right_angles() -> None:
    world = made("manhattan", noise_scale=0.0)
    steps = world.graph.factors[0].z
    np.testing.assert_allclose(steps[:, :2], np.tile([1.0, 0.0], (len(steps), 1)), atol=1e-12)
    quarters = steps[:, 2] / (np.pi / 2)
    np.testing.assert_allclose(quarters, np.round(quarters), atol=1e-12)
    assert set(np.round(quarters).astype(int)) == {-1, 0, 1}


def test_grid3d_moves_forward_and_turns_at_right_angles() -> None:
    world = made("grid3d", noise_scale=0.0)
    steps = SE3.log(world.graph.factors[0].z)
    turn = np.linalg.norm(steps[:, 3:], axis=1) / (np.pi / 2)
    np.testing.assert_allclose(world.graph.factors[0].z[:, :3], np.tile([1.0, 0, 0], (len(steps), 1)), atol=1e-12)
    np.testing.assert_allclose(turn, np.round(turn), atol=1e-7)
    assert set(np.round(turn).astype(int)) == {0, 1}


def test_sphere_lies_on_a_sphere_and_ties_rings() -> None:
    world = made("sphere", radius=7.0)
    i, j = world.graph.factors[1].keys
    np.testing.assert_allclose(np.linalg.norm(world.truth[x][:, :3], axis=1), 7.0)
    np.testing.assert_array_equal(j.numbers - i.numbers, 10)
    up = SE3.act(world.truth[x], [0.0, 0.0, 1.0]) - world.truth[x][:, :3]
    np.testing.assert_allclose(7.0 * up, world.truth[x][:, :3], atol=1e-12)
    ahead = SE3.act(world.truth[x][:-1], [1.0, 0.0, 0.0]) - world.truth[x][:-1, :3]
    steps = np.diff(world.truth[x][:, :3], axis=0)
    assert (np.vecdot(ahead, steps) > 0.8 * np.linalg.norm(steps, axis=1)).all()


def test_torus_lies_on_a_torus_and_ends_where_it_began() -> None:
    world = made("torus", radius=5.0, tube=2.0, closure_share=1.0)
    p = world.truth[x][:, :3]
    np.testing.assert_allclose(np.hypot(np.hypot(p[:, 0], p[:, 1]) - 5.0, p[:, 2]), 2.0)
    i, j = world.graph.factors[1].keys
    np.testing.assert_array_equal((j.numbers - i.numbers) % 60, 10)
    assert (j.numbers < i.numbers).sum() == 10  # the last coil sees the first


@for_all(group=[SE2, SE3], n=[0, 1, 2, 3, 8, 13])
def test_chain_is_the_product_one_by_one(group: LieGroup, n: int) -> None:
    rng = np.random.default_rng(n)
    X = [group.exp(rng.standard_normal(group.dim))]
    steps = group.exp(rng.standard_normal((n, group.dim)))
    for step in steps:
        X.append(group.compose(X[-1], step))
    np.testing.assert_allclose(group.local(sim.chain(group, X[0], steps), np.array(X)), 0.0, atol=1e-12)


def test_measurement_noise_lives_in_the_tangent_space() -> None:
    rng, sigmas = np.random.default_rng(0), np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    X_i, X_j = SE3.exp(rng.standard_normal((2, 4000, 6)))
    v = SE3.local(SE3.between(X_i, X_j), sim.measure(rng, SE3, X_i, X_j, sigmas))
    np.testing.assert_allclose(v.std(axis=0), sigmas, rtol=0.05)
    np.testing.assert_allclose(v.mean(axis=0) / sigmas, 0.0, atol=4 / np.sqrt(4000))


def test_position_error_does_not_see_the_frame() -> None:
    world = made("sphere")
    moved = Values({x: (SE3, SE3.compose(SE3.exp([1.0, 2.0, 3.0, 0.4, 0.5, 0.6]), world.start[x]))})
    assert sim.position_error(moved, world.truth) == pytest.approx(sim.position_error(world.start, world.truth))
    one_off = np.array([[0.0, 0, 0], [1, 3, 0], [2, 0, 0]])
    line = Values({x: (SE2, [[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])})
    assert sim.position_error(Values({x: (SE2, one_off)}), line) == pytest.approx(np.sqrt(3.0))
    with pytest.raises(GraphError, match="expected the same poses"):
        sim.position_error(made("ring").truth, made("manhattan").truth)


def test_a_generator_of_unknown_origin_has_no_seed() -> None:
    assert sim.ring(np.random.default_rng(3).spawn(1)[0], laps=1, per_lap=10).seed is None
    assert sim.ring(np.random.default_rng(np.random.SeedSequence(9)), laps=1, per_lap=10).seed == 9
