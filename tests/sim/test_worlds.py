"""Worlds: the same bits for a seed, truth that fits its measurements, scenes as defined, graphs that are solved."""

from __future__ import annotations

from math import erf, exp, pi, radians, sqrt
from typing import Any

import numpy as np
import pytest

import sim
from models import LINE, SE2, SE3, LieGroup
from models.errors import GraphError, OptionError
from models.sensors import line_in_frame, normalized
from nls import Values, kinds
from sim.cli import WORLDS
from sim.files import harbor_files, native_files, survey_files
from sim.world import reflected
from tests.combinations import for_all
from tests.sim.scenes import MADE, four_sigma, made

x, l = kinds("x", "l")
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


same = np.testing.assert_allclose
CHARTED = {"landmarks": "independent"}
GYRO = {"azimuth": "absolute"}


def bytes_of(world: sim.LandmarkWorld) -> list[bytes]:
    numbers = [*(v[k] for v in (world.truth, world.start) for k in (x, l)), *(f.z for f in world.graph.factors)]
    return [np.ascontiguousarray(a).tobytes() for a in numbers]


def test_subsea_is_the_scene_it_says() -> None:
    world = made("subsea", noise_scale=0.0)
    X = world.truth[x]
    assert (world.poses, world.landmarks, world.rows) == (181, 6, 3 + 3 * 180 + 2 * len(world.sightings))
    same(np.linalg.norm(X[:, :2], axis=1), 30.0, atol=1e-9)
    same(X[[0, 45, 90, 180]], [[30, 0, pi / 2], [-30, 0, -pi / 2], [30, 0, pi / 2], [30, 0, pi / 2]], atol=1e-9)
    same(X[1], [30 * np.cos(radians(4)), 30 * np.sin(radians(4)), radians(94)], atol=1e-9)
    same(np.linalg.norm(np.diff(X[:, :2], axis=0), axis=1), 2.094, atol=5e-4)
    near = {(i, k) for i in range(181) for k in range(6) if np.hypot(*(world.truth[l[k]] - X[i, :2])) <= 30.0}
    pose, point = world.sightings.keys
    assert set(zip(pose.numbers.tolist(), point.numbers.tolist(), strict=True)) == near
    assert len(world.sightings) == len(near)
    assert (np.diff(pose.numbers) >= 0).all()
    k = int(np.flatnonzero((pose.numbers == 0) & (point.numbers == 0))[0])
    same(world.sightings.z[k], [np.arctan2(9, 9) - pi / 2, 9 * np.sqrt(2)], atol=1e-12)


def test_variants_share_their_noise_and_differ_in_what_is_measured() -> None:
    plain, first, charted, gyro, both = (
        made("subsea", 7, **options)
        for options in ({}, {"landmarks": "first-sight"}, CHARTED, GYRO, {**CHARTED, **GYRO, "known_landmarks": 1})
    )
    assert bytes_of(plain) == bytes_of(first), "first-sight is of filters alone: the graph cannot say it"
    assert [w.landmarks_as for w in (plain, first, charted)] == ["correlated", "first-sight", "independent"]
    assert bytes_of(plain)[4:7] == bytes_of(charted)[4:7] == bytes_of(both)[4:7]
    names = [[f.name for f in world.graph.factors[3:]] for world in (plain, first, charted, gyro, both)]
    assert names == [[], [], ["Prior"], ["Heading"], ["Heading", "Prior"]]
    chart, surveyed = charted.graph.factors[3], both.graph.factors[4]
    assert (chart.noise.sigma.tolist(), surveyed.noise.sigma.tolist()) == ([4.0] * 6, [0.1, *[4.0] * 5])  # type: ignore[attr-defined]
    same(surveyed.z[0] - both.truth[l[0]], (chart.z[0] - both.truth[l[0]]) / 40, atol=1e-12)
    assert len(gyro.graph.factors[3]) == 180


def test_lines_is_the_scene_it_says() -> None:
    world = made("lines", noise_scale=0.0)
    X, walls = world.truth[x], world.truth[l]
    assert (world.poses, world.landmarks) == (481, 12)
    assert world.rows == 3 + 2 * 480 + 2 * len(world.sightings)
    same(X[[0, 48, 240, 480]], [[-6, -8, 0], [6, -8, 0], [-6, -8, 0], [-6, -8, 0]], atol=1e-9)
    same(np.linalg.norm(np.diff(X[:, :2], axis=0), axis=1), 0.25, atol=1e-12)
    same(X[60, 2], pi / 2, atol=1e-12)
    same(np.sort(walls[:, 1]), [6] * 4 + [10] * 4 + [12] * 4)
    near = set()
    for i, (px, py, _) in enumerate(X):
        for k, (alpha, r) in enumerate(walls):
            foot = -px * np.sin(alpha) + py * np.cos(alpha)
            half = {10.0: 10.0, 6.0: 6.0, 12.0: 3.0}[float(r)]
            if abs(r - px * np.cos(alpha) - py * np.sin(alpha)) < 5 and abs(foot) <= half:
                near.add((i, k))
    pose, wall = world.sightings.keys
    assert set(zip(pose.numbers.tolist(), wall.numbers.tolist(), strict=True)) == near
    h, _ = line_in_frame(X[pose.numbers], walls[wall.numbers])
    assert (h[:, 1] < 0).any(), "the inner walls are seen from outside"
    same(LINE.local(h, world.sightings.z), 0.0, atol=1e-12)
    np.testing.assert_array_equal(normalized(world.sightings.z), world.sightings.z)


def test_ranges_are_reflected_at_0() -> None:
    """Mean square h^2 + sigma^2, mean of the folded normal distribution; what is not below 0 stays bit for bit."""
    h, sigma = 0.1, 0.2
    drawn = h + sigma * np.random.default_rng(0).standard_normal(400_000)
    z = reflected(drawn)
    assert (z >= 0).all()
    np.testing.assert_array_equal(z[drawn >= 0], drawn[drawn >= 0])
    assert np.square(z).mean() == pytest.approx(h**2 + sigma**2, rel=0.01)
    mean = sigma * sqrt(2 / pi) * exp(-((h / sigma) ** 2) / 2) + h * erf(h / sigma / sqrt(2))
    assert z.mean() == pytest.approx(mean, rel=0.005)


nan = float("nan")
GRAPHS = [name for name in MADE if name not in ("survey", "harbor")]
NOT_POSSIBLE: dict[str, dict[str, list[Any]]] = {
    "manhattan": {"n_poses": [2, 10.5, True, 10**9], "streets": [1], "block": [0], "spacing": [0.0]}
    | {"radius": [-1.0], "closure_ratio": [-0.1]},
    "grid3d": {"sigma_t": [0.0], "sigma_r": [nan], "noise_scale": [float("inf")]},
    "ring": {"laps": [0], "per_lap": [3, 10**9], "diameter": [-3.0], "wobble": [-0.1]},
    "sphere": {"rings": [1], "per_ring": ["50"], "radius": ["big"], "sigma_t": [-1.0]},
    "torus": {"coils": [2], "per_coil": [3], "tube": [20.0], "closure_share": [1.5]},
    "hauv-floor": {"passes": [0], "legs": [0, 10**8], "per_leg": [1], "points": [0], "aperture": [0.0]}
    | {"noise_scale": [1e300, -1.0], "elevation": ["guess"]},
    "hauv-hull": {"levels": [0], "per_level": [1.5], "aperture": [np.pi], "drop_outs": [1.0], "outliers": [-0.1]}
    | {"wrong_associations": [1.0, 1.1]},
    "subsea": {"laps": [0], "landmarks": ["guessed"], "azimuth": ["north"], "known_start": ["no"]}
    | {"known_landmarks": [7], "noise_scale": [-1.0, 1e31]},
    "lines": {"laps": [1.5], "noise_scale": [nan]},
    "rig": {"poses": [1, 10**8], "points": [3, 60.0], "views": [0, 7], "noise_scale": [-1.0, nan, 1e31]},
    "survey": {"legs": [0], "leg": [0.0, 1e12], "spacing": [1.0], "depth": [40.0], "speed": [0.1], "drop_outs": [1.0]}
    | {"usbl_outliers": [1.5], "ahrs_clock": [1.0], "dvl_yaw": [2.0], "noise_scale": [-1.0, 2e5, 1e20]},
    "harbor": {"geometry": ["beach"], "keyframes": [39], "laps": [3, 0], "drift": [-1.0], "signal": [nan, 3100.0]}
    | {"false_alarms": [1.0], "images": [1]},
}


def content(world: Any) -> dict[str, bytes]:
    """All numbers of a world, as its files have them."""
    if isinstance(world, sim.SurveyLog):
        return survey_files(world)[0]
    return harbor_files(world)[0] if isinstance(world, sim.Harbor) else native_files(world)


def test_every_world_has_a_small_one() -> None:
    assert set(WORLDS) < set(NOT_POSSIBLE) < set(MADE)
    assert set(WORLDS) < set(sim.__all__)


@for_all(name=MADE)
def test_a_seed_gives_the_same_bits(name: str) -> None:
    one, other = made(name, 5), made(name, 6)
    assert content(one) == content(made(name, 5)) != content(other)
    assert (one.seed, other.seed) == (5, 6)
    with pytest.raises(OptionError, match="rng: 0 is not possible"):
        MADE[name][0](0)


@for_all(name=GRAPHS)
def test_without_noise_the_truth_is_the_optimum(name: str) -> None:
    exact, noisy = made(name, noise_scale=0.0), made(name)
    assert exact.graph.chi2(exact.truth) < 1e-15 * exact.rows
    assert exact.graph.optimize(exact.truth).converged
    assert name == "rig" or exact.ate(exact.start) < 1e-9
    away = np.subtract(*(v.stack("x").manifold.position(v.stack("x").X) for v in (noisy.start, noisy.truth)))
    assert noisy.ate(noisy.start) == pytest.approx(np.linalg.norm(away) / np.sqrt(noisy.poses))
    if isinstance(exact, sim.LandmarkWorld):
        return  # the way of these is drawn as well
    for kind in noisy.truth.stacks:  # the noise is all that differs
        np.testing.assert_array_equal(exact.truth.stack(kind).X, noisy.truth.stack(kind).X)


@for_all(name=GRAPHS)
def test_chi2_over_seeds(name: str) -> None:
    """At the truth, and of pose graphs at the optimum; of each seed and of all together."""
    worlds = [made(name, seed) for seed in range(10)]
    chi2 = [getattr(world, "sensed", world.graph).chi2(world.truth) for world in worlds]
    rows = [world.rows for world in worlds]
    assert all(map(four_sigma, chi2, rows))
    assert four_sigma(sum(chi2), sum(rows))
    if name not in WORLDS:
        return
    results = [world.graph.optimize(world.start) for world in worlds]
    for world, result, at_truth in zip(worlds, results, chi2, strict=True):
        assert result.converged, result.reason
        assert result.dof == world.dof
        assert four_sigma(result.chi2_final, world.dof)
        assert result.chi2_final < at_truth
        assert sim.position_error(result.values, world.truth) < sim.position_error(world.start, world.truth)
    assert four_sigma(sum(result.chi2_final for result in results), sum(world.dof for world in worlds))


def test_impossible_options_are_refused() -> None:
    for name, options in NOT_POSSIBLE.items():
        for option, values in options.items():
            for value in values:
                with pytest.raises(OptionError, match="is not possible") as caught:
                    made(name, **{option: value})
                assert option in caught.value.option, (name, option, value)
