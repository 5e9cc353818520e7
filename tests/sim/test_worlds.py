"""Worlds: the same bits for a seed, truth that fits its measurements, graphs that can be solved."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

import sim
from models import SE2, SE3, LieGroup
from models.errors import GraphError, OptionError, ResourceLimitError
from nls import Values, kinds
from sim.cli import WORLDS
from sim.paths import attitudes, grid_walk, meetings, quarter_turns

(x,) = kinds("x")
SMALL = {
    "manhattan": {"n_poses": 150},
    "grid3d": {"n_poses": 120},
    "ring": {"laps": 2, "per_lap": 50},
    "sphere": {"rings": 6, "per_ring": 10},
    "torus": {"coils": 6, "per_coil": 10},
}
DEFAULT_POSES = {"manhattan": 3500, "grid3d": 2000, "ring": 400, "sphere": 2500, "torus": 5000}
every_world = pytest.mark.parametrize("name", sorted(WORLDS))


def small(name: str, seed: int = 0, **options: float) -> sim.World:
    return WORLDS[name](np.random.default_rng(seed), **SMALL[name], **options)


def content(world: sim.World) -> list[bytes]:
    numbers = [world.truth[x], world.start[x], *(f.z for f in world.graph.factors)]
    return [
        np.ascontiguousarray(a).tobytes() for a in numbers + [k.numbers for f in world.graph.factors for k in f.keys]
    ]


def four_sigma(chi2: float, dof: int) -> bool:
    """A chi-square variable has mean dof and variance 2 dof."""
    return abs(chi2 - dof) < 4 * np.sqrt(2 * dof)


def test_every_world_has_a_small_one() -> None:
    assert set(SMALL) == set(WORLDS) == set(DEFAULT_POSES)
    assert set(WORLDS) < set(sim.__all__)


@every_world
def test_a_seed_gives_the_same_bits(name: str) -> None:
    assert content(small(name, 5)) == content(small(name, 5))


@every_world
def test_seeds_differ(name: str) -> None:
    one, two = small(name, 5), small(name, 6)
    assert not np.array_equal(one.graph.factors[0].z, two.graph.factors[0].z)
    assert (one.seed, two.seed) == (5, 6)


@every_world
def test_default_sizes(name: str) -> None:
    world = WORLDS[name](np.random.default_rng(0))
    assert world.poses == DEFAULT_POSES[name]
    assert f"{world.poses} poses" in world.description
    assert world.closures > 0.2 * world.poses
    assert four_sigma(world.graph.chi2(world.truth), world.rows)
    assert sim.position_error(world.start, world.truth) > 1.0  # odometry alone gets lost


@every_world
def test_chi2_at_the_truth_over_seeds(name: str) -> None:
    worlds = [small(name, seed) for seed in range(20)]
    chi2 = [world.graph.chi2(world.truth) for world in worlds]
    assert four_sigma(sum(chi2), sum(world.rows for world in worlds))
    assert all(four_sigma(c, world.rows) for c, world in zip(chi2, worlds, strict=True))


@every_world
def test_optimum_over_seeds(name: str) -> None:
    total = dof = 0.0
    for seed in range(20):
        world = small(name, seed)
        result = world.graph.optimize(world.start)
        assert result.converged, result.reason
        assert result.dof == world.dof
        assert four_sigma(result.chi2_final, world.dof)
        assert result.chi2_final < world.graph.chi2(world.truth)
        assert sim.position_error(result.values, world.truth) < sim.position_error(world.start, world.truth)
        total, dof = total + result.chi2_final, dof + world.dof
    assert four_sigma(total, int(dof))


@every_world
def test_without_noise_the_truth_is_the_optimum(name: str) -> None:
    world = small(name, noise_scale=0.0)
    assert world.graph.chi2(world.truth) < 1e-20 * world.rows
    assert sim.position_error(world.start, world.truth) < 1e-9
    noisy = small(name)
    np.testing.assert_array_equal(world.truth[x], noisy.truth[x])  # the noise is all that differs
    assert content(world)[4:] == content(noisy)[4:]


@every_world
def test_poses_are_connected_and_loops_close(name: str) -> None:
    world = small(name)
    odometry, closures = world.graph.factors
    i, j = (k.numbers for k in odometry.keys)
    np.testing.assert_array_equal(i, np.arange(world.poses - 1))
    np.testing.assert_array_equal(j, i + 1)
    graph = sp.coo_array((np.ones(len(i)), (i, j)), shape=(world.poses, world.poses))
    assert connected_components(graph, directed=False)[0] == 1
    i, j = (k.numbers for k in closures.keys)
    assert world.closures == len(i) > 0
    assert (np.abs(i - j) > 1).all()
    pairs = np.sort(np.stack([i, j], axis=1), axis=1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)


@every_world
def test_the_start_is_the_chained_odometry(name: str) -> None:
    world = small(name)
    group = world.truth.stack("x").manifold
    X = world.start[x]
    np.testing.assert_array_equal(X[0], world.truth[x][0])
    np.testing.assert_allclose(group.local(group.between(X[:-1], X[1:]), world.graph.factors[0].z), 0.0, atol=1e-9)


@pytest.mark.parametrize(("name", "radius"), [("manhattan", 1.5), ("grid3d", 1.5), ("ring", 1.0)])
def test_closures_join_near_poses_far_apart_in_time(name: str, radius: float) -> None:
    world = small(name)
    i, j = world.graph.factors[1].keys
    group = world.truth.stack("x").manifold
    away = np.linalg.norm(group.position(world.truth[i]) - group.position(world.truth[j]), axis=1)
    assert away.max() <= radius
    assert (j.numbers - i.numbers).min() >= 10


def test_manhattan_moves_forward_and_turns_at_right_angles() -> None:
    world = small("manhattan", noise_scale=0.0)
    steps = world.graph.factors[0].z
    np.testing.assert_allclose(steps[:, :2], np.tile([1.0, 0.0], (len(steps), 1)), atol=1e-12)
    quarters = steps[:, 2] / (np.pi / 2)
    np.testing.assert_allclose(quarters, np.round(quarters), atol=1e-12)
    assert set(np.round(quarters).astype(int)) == {-1, 0, 1}


def test_grid3d_moves_forward_and_turns_at_right_angles() -> None:
    world = small("grid3d", noise_scale=0.0)
    steps = SE3.log(world.graph.factors[0].z)
    turn = np.linalg.norm(steps[:, 3:], axis=1) / (np.pi / 2)
    np.testing.assert_allclose(world.graph.factors[0].z[:, :3], np.tile([1.0, 0, 0], (len(steps), 1)), atol=1e-12)
    np.testing.assert_allclose(turn, np.round(turn), atol=1e-7)
    assert set(np.round(turn).astype(int)) == {0, 1}


def test_sphere_lies_on_a_sphere_and_ties_rings() -> None:
    world = small("sphere", radius=7.0)
    i, j = world.graph.factors[1].keys
    np.testing.assert_allclose(np.linalg.norm(world.truth[x][:, :3], axis=1), 7.0)
    np.testing.assert_array_equal(j.numbers - i.numbers, 10)
    up = SE3.act(world.truth[x], [0.0, 0.0, 1.0]) - world.truth[x][:, :3]
    np.testing.assert_allclose(7.0 * up, world.truth[x][:, :3], atol=1e-12)
    ahead = SE3.act(world.truth[x][:-1], [1.0, 0.0, 0.0]) - world.truth[x][:-1, :3]
    assert (np.sum(ahead * np.diff(world.truth[x][:, :3], axis=0), axis=1) > 0).all()


def test_torus_lies_on_a_torus_and_ends_where_it_began() -> None:
    world = small("torus", radius=5.0, tube=2.0, closure_share=1.0)
    p = world.truth[x][:, :3]
    np.testing.assert_allclose(np.hypot(np.hypot(p[:, 0], p[:, 1]) - 5.0, p[:, 2]), 2.0)
    i, j = world.graph.factors[1].keys
    np.testing.assert_array_equal((j.numbers - i.numbers) % 60, 10)
    assert (j.numbers < i.numbers).sum() == 10  # the last coil sees the first


@pytest.mark.parametrize("group", [SE2, SE3])
@pytest.mark.parametrize("n", [0, 1, 2, 3, 8, 13])
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
    world = small("sphere")
    moved = Values({x: (SE3, SE3.compose(SE3.exp([1.0, 2.0, 3.0, 0.4, 0.5, 0.6]), world.start[x]))})
    assert sim.position_error(moved, world.truth) == pytest.approx(sim.position_error(world.start, world.truth))
    one_off = np.array([[0.0, 0, 0], [1, 3, 0], [2, 0, 0]])
    line = Values({x: (SE2, [[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])})
    assert sim.position_error(Values({x: (SE2, one_off)}), line) == pytest.approx(np.sqrt(3.0))


def test_position_error_wants_the_same_poses() -> None:
    with pytest.raises(GraphError, match="expected the same poses"):
        sim.position_error(small("ring").truth, small("manhattan").truth)


@pytest.mark.parametrize("dim", [2, 3])
def test_grid_walk_stays_in_the_city(dim: int) -> None:
    positions, directions = grid_walk(np.random.default_rng(3), 500, dim, 4, 3, 2.0)
    assert positions.shape == directions.shape == (500, dim)
    assert positions.min() == 0.0
    assert positions.max() == (4 - 1) * 3 * 2.0
    np.testing.assert_array_equal(np.diff(positions, axis=0), 2.0 * directions[:-1])
    np.testing.assert_array_equal(np.abs(directions).sum(axis=1), 1.0)
    assert (np.sum(directions[:-1] * directions[1:], axis=1) >= 0).all()  # it never turns back on the spot


def test_attitudes_look_along_the_way() -> None:
    forward = np.random.default_rng(0).standard_normal((20, 3))
    R = SE3.rotation(np.column_stack([np.zeros((20, 3)), attitudes(forward, np.array([[0.0, 0, 1]]))]))
    np.testing.assert_allclose(R[:, :, 0], forward / np.linalg.norm(forward, axis=1, keepdims=True), atol=1e-12)
    np.testing.assert_allclose(R[:, 2, 1], 0.0, atol=1e-12)  # y stays level
    assert (R[:, 2, 2] > 0).all()
    assert quarter_turns(np.eye(3)).shape == (3, 4)


def test_far_too_many_meetings_are_refused_before_they_are_listed() -> None:
    with pytest.raises(ResourceLimitError, match="choose a smaller radius"):
        meetings(np.random.default_rng(0), np.random.default_rng(0).random((11_000, 2)), 10.0, 5, 1.0)


@pytest.mark.parametrize(
    ("name", "options", "refused"),
    [
        ("manhattan", {"n_poses": 2}, "n_poses"),
        ("manhattan", {"n_poses": 10.5}, "n_poses"),
        ("manhattan", {"n_poses": True}, "n_poses"),
        ("manhattan", {"n_poses": 10**9}, "n_poses"),
        ("manhattan", {"streets": 1}, "streets"),
        ("manhattan", {"block": 0}, "block"),
        ("manhattan", {"spacing": 0.0}, "spacing"),
        ("manhattan", {"radius": -1.0}, "radius"),
        ("manhattan", {"closure_ratio": -0.1}, "closure_ratio"),
        ("grid3d", {"sigma_t": 0.0}, "sigma_t"),
        ("grid3d", {"sigma_r": float("nan")}, "sigma_r"),
        ("grid3d", {"noise_scale": float("inf")}, "noise_scale"),
        ("ring", {"laps": 0}, "laps"),
        ("ring", {"per_lap": 3}, "per_lap"),
        ("ring", {"laps": 10**6, "per_lap": 10**6}, "per_lap"),
        ("ring", {"diameter": -3.0}, "diameter"),
        ("ring", {"wobble": -0.1}, "wobble"),
        ("sphere", {"rings": 1}, "rings"),
        ("sphere", {"per_ring": "50"}, "per_ring"),
        ("sphere", {"radius": "big"}, "radius"),
        ("sphere", {"sigma_t": -1.0}, "sigma_t"),
        ("torus", {"coils": 2}, "coils"),
        ("torus", {"per_coil": 3}, "per_coil"),
        ("torus", {"tube": 20.0}, "tube"),
        ("torus", {"closure_share": 1.5}, "closure_share"),
    ],
)
def test_impossible_options_are_refused(name: str, options: dict[str, float], refused: str) -> None:
    with pytest.raises(OptionError, match=r"is not possible; expected") as caught:
        WORLDS[name](np.random.default_rng(0), **options)
    assert refused in caught.value.option


@pytest.mark.parametrize("make", WORLDS.values(), ids=list(WORLDS))
def test_a_seed_is_not_a_generator(make: Callable[..., sim.World]) -> None:
    with pytest.raises(OptionError, match=r"rng: 0 is not possible; expected a generator such as"):
        make(0)


def test_a_generator_of_unknown_origin_has_no_seed() -> None:
    assert sim.ring(np.random.default_rng(3).spawn(1)[0], laps=1, per_lap=10).seed is None
    assert sim.ring(np.random.default_rng(np.random.SeedSequence(9)), laps=1, per_lap=10).seed == 9


def test_sim_does_not_import_matplotlib() -> None:
    code = "import sys, sim, sim.cli; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
