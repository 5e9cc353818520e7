"""Sonar missions: the reference scenes as they are defined, measurements that fit their truth, the start as stated."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from math import pi, radians

import numpy as np
import pytest

import sim
from factors import Elevation, ElevationHinge
from models import SE3, euler
from models.errors import GraphError, OptionError
from models.sensors import ImagingSonar, cartesian, spherical
from nls import kinds
from sim.cli import MISSIONS
from sim.hauv import lawn_mower, swaying
from sim.mission import visible
from tests.combinations import for_all

x, l = kinds("x", "l")
every_mission = for_all(make=MISSIONS.values())
SMALL = {"hauv-floor": {"legs": 2, "per_leg": 12}, "hauv-hull": {"levels": 2, "per_level": 13}}
Make = Callable[..., sim.Mission]


def small(make: Make, seed: int = 0, **options: object) -> sim.Mission:
    return make(np.random.default_rng(seed), **SMALL[make.__name__.replace("_", "-")], **options)


def content(mission: sim.Mission) -> list[bytes]:
    arrays = [mission.truth[x], mission.truth[l], mission.start[x], mission.start[l]]
    arrays += [np.asarray(f.z) for f in mission.graph.factors[:5]] + [k.numbers for k in mission.contacts.keys]
    return [np.ascontiguousarray(a).tobytes() for a in arrays]


def states(mission: sim.Mission) -> dict[str, np.ndarray]:
    names = ("roll", "pitch", "yaw", "x", "y", "z")
    return dict(zip(names, euler.from_se3(mission.truth[x]).T, strict=True))


def seen_from(mission: sim.Mission, i: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(range, azimuth, elevation) of points from poses."""
    S = SE3.compose(mission.truth[x][i], mission.offset[None])
    return spherical(SE3.act(SE3.inverse(S), points))[0]


def four_sigma(chi2: float, dof: int) -> bool:
    return abs(chi2 - dof) < 4 * np.sqrt(2 * dof)


def test_numbers_of_poses() -> None:
    for passes, floor, hull in ((1, 124, 109), (2, 247, 217), (3, 370, 325)):
        assert sim.hauv_floor(np.random.default_rng(0), passes=passes).poses == floor
        assert sim.hauv_hull(np.random.default_rng(0), passes=passes).poses == hull


def test_the_floor_is_mown_as_defined() -> None:
    mission = sim.hauv_floor(np.random.default_rng(0))
    assert mission.distance == pytest.approx(53.0, abs=0.05)
    at, t = states(mission), np.arange(124)
    np.testing.assert_allclose(at["roll"][:124], radians(2) * np.sin(0.31 * t + 1), atol=1e-12)
    np.testing.assert_allclose(at["pitch"][:124], radians(2) * np.sin(0.23 * t), atol=1e-12)
    np.testing.assert_allclose(at["z"][:124], 0.15 * np.sin(0.17 * t), atol=1e-12)
    for k in range(4):
        leg = slice(33 * k, 33 * k + 25)
        there = np.arange(25) * 0.25
        np.testing.assert_allclose(at["x"][leg], there[::-1] if k % 2 else there, atol=1e-12)
        np.testing.assert_allclose(at["y"][leg], 0.8 * k, atol=1e-12)
        np.testing.assert_allclose(np.cos(at["yaw"][leg]), (-1.0) ** k, atol=1e-12)
    for k in range(3):  # the eight poses between two legs, with those at the ends
        between = slice(33 * k + 24, 33 * k + 34)
        np.testing.assert_allclose(np.diff(at["y"][between]), 0.8 / 9, atol=1e-12)
        np.testing.assert_allclose(np.diff(np.unwrap(at["yaw"][between])), pi / 9, atol=1e-12)
        np.testing.assert_allclose(np.ptp(at["x"][between]), 0.0, atol=1e-12)
    np.testing.assert_array_equal(mission.truth[x][123:], mission.truth[x][123::-1])  # back, the same poses
    ahead = SE3.rotation(mission.offset[None])[0][:, 0]
    np.testing.assert_allclose(ahead, [np.cos(radians(35)), 0.0, np.sin(radians(35))], atol=1e-12)  # z is down
    np.testing.assert_allclose(mission.offset[:3], [0.3, 0.0, 0.1])
    low, high = mission.truth[l].min(axis=0), mission.truth[l].max(axis=0)
    assert (low > [-6.0, -4.0, 2.2]).all()
    assert (high < [12.0, 7.0, 2.8]).all()
    assert "750 points" in mission.description


def test_the_hull_is_strafed_as_defined() -> None:
    mission = sim.hauv_hull(np.random.default_rng(0))
    at, t = states(mission), np.arange(109)
    level = at["z"][:109] - 0.15 * np.sin(0.17 * t)
    np.testing.assert_allclose(at["x"], 0.0, atol=1e-12)
    np.testing.assert_allclose(at["yaw"], 0.0, atol=1e-12)
    for k in range(4):
        leg = slice(28 * k, 28 * k + 25)
        there = np.arange(25) * 0.25
        np.testing.assert_allclose(at["y"][leg], there[::-1] if k % 2 else there, atol=1e-12)
        np.testing.assert_allclose(level[leg], 0.4 * k, atol=1e-12)
    for k in range(3):
        np.testing.assert_allclose(np.diff(level[28 * k + 24 : 28 * k + 29]), 0.1, atol=1e-12)
    np.testing.assert_allclose(mission.offset, [0.3, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0])
    assert (mission.truth[l].min(axis=0) > [2.7, -1.5, -1.2]).all()
    assert (mission.truth[l].max(axis=0) < [3.3, 7.5, 2.6]).all()
    assert "250 points" in mission.description


@for_all(make=MISSIONS.values(), aperture=[radians(14), radians(28)])
def test_contacts_are_what_the_sonar_sees(make: Make, aperture: float) -> None:
    """Every pair in view is a contact and no other: brute force over all poses and landmarks."""
    mission = small(make, aperture=aperture, noise_scale=0.0)
    n, m = mission.poses, mission.landmarks
    h = seen_from(mission, np.repeat(np.arange(n), m), np.tile(mission.truth[l], (n, 1)))
    view = (h[:, 0] >= 1) & (h[:, 0] < 6) & (np.abs(h[:, 1]) < radians(14.4)) & (np.abs(h[:, 2]) <= aperture / 2)
    i, k = np.divmod(np.flatnonzero(view), m)
    np.testing.assert_array_equal(mission.contacts.keys[0].numbers, i)
    np.testing.assert_array_equal(mission.contacts.keys[1].numbers, k)
    np.testing.assert_allclose(mission.contacts.z, h[view, :2], atol=1e-12)
    assert np.bincount(k, minlength=m).min() >= 3


@every_mission
def test_the_start_is_dead_reckoning(make: Make) -> None:
    """One step after the other, by the definition of the levelled step; landmarks where they were first seen."""
    mission = small(make, 3)
    state = euler.from_se3(mission.truth[x][:1])[0]
    expected = [state]
    for (dx, dy, dyaw), (z, pitch, roll) in zip(mission.odometry.z, mission.attitude.z[1:], strict=True):
        _, _, yaw, px, py, _ = expected[-1]
        c, s = np.cos(yaw), np.sin(yaw)
        expected.append(np.array([roll, pitch, yaw + dyaw, px + c * dx - s * dy, py + s * dx + c * dy, z]))
    np.testing.assert_allclose(SE3.local(mission.start[x], euler.to_se3(np.array(expected))), 0.0, atol=1e-9)
    np.testing.assert_array_equal(mission.start[x][0], mission.truth[x][0])
    pose, target = (k.numbers for k in mission.contacts.keys)
    for k in range(0, mission.landmarks, 7):
        first = np.flatnonzero(target == k)[np.argmin(pose[target == k])]
        p = cartesian(np.append(mission.contacts.z[first], 0.0)[None])[0]
        S = SE3.compose(mission.start[x][pose[first]][None], mission.offset[None])
        np.testing.assert_allclose(mission.start[l][k], SE3.act(S, p)[0], atol=1e-9)
    anchor, heading = mission.graph.factors[2:4]
    np.testing.assert_allclose(np.ravel(anchor.z), mission.truth[x][0, :2])
    assert float(np.ravel(heading.z)[0]) == pytest.approx(euler.from_se3(mission.truth[x][:1])[0, 2])
    assert (anchor.noise.sqrt_information(1, ("x", "y")) == 1e3).all()
    assert (heading.noise.sqrt_information(1, ("yaw",)) == 1e4).all()


@every_mission
def test_chi2_at_the_truth_over_seeds(make: Make) -> None:
    missions = [small(make, seed) for seed in range(12)]
    chi2 = [mission.sensed.chi2(mission.truth) for mission in missions]
    rows = [mission.rows for mission in missions]
    assert rows[0] == 3 * (2 * missions[0].poses - 1) + 2 * len(missions[0].contacts)
    assert four_sigma(sum(chi2), sum(rows))
    assert all(four_sigma(c, r) for c, r in zip(chi2, rows, strict=True))
    for mission, c in zip(missions, chi2, strict=True):  # the anchor is exact, and no hinge is touched at the truth
        assert mission.graph.chi2(mission.truth) == pytest.approx(c)


@every_mission
def test_noise_of_each_kind_over_seeds(make: Make) -> None:
    """The factors, one by one, have the sigmas of the scene: standard deviations of raw residuals."""
    raw: list[list[np.ndarray]] = [[], [], []]
    for seed in range(10):
        noisy, exact = small(make, seed), small(make, seed, noise_scale=0.0)
        for rows, of in zip(raw, ("odometry", "attitude", "contacts"), strict=True):
            rows.append(getattr(noisy, of).z - getattr(exact, of).z)
    xy, yaw = 0.01, radians(0.25)
    for rows, sigmas in zip(raw, ([xy, xy, yaw], [0.01, radians(0.1), radians(0.1)], [0.01, yaw]), strict=True):
        e = np.concatenate(rows)
        e[:, 1:] = (e[:, 1:] + pi) % (2 * pi) - pi
        np.testing.assert_allclose(e.std(axis=0), sigmas, rtol=4 / np.sqrt(2 * len(e)))


@every_mission
def test_a_seed_gives_the_same_bits(make: Make) -> None:
    one, same, other = small(make, 5), small(make, 5, elevation="free"), small(make, 6)
    assert content(one) == content(same)  # the treatment draws nothing
    assert content(one) != content(other)
    assert (one.seed, other.seed) == (5, 6)
    with pytest.raises(OptionError, match="rng: 0 is not possible"):
        make(0)


@every_mission
def test_without_noise_the_truth_is_the_optimum(make: Make) -> None:
    mission = small(make, noise_scale=0.0)
    assert mission.graph.chi2(mission.truth) < 1e-15 * mission.rows
    assert mission.ate(mission.start) < 1e-9
    assert mission.graph.optimize(mission.truth).converged


@for_all(make=MISSIONS.values(), elevation=["free", "hinge", "prior"])
def test_treatments_of_the_elevation(make: Make, elevation: str) -> None:
    kind = {"free": None, "hinge": ElevationHinge, "prior": Elevation}[elevation]
    mission = small(make, elevation=elevation)
    rest = mission.graph.factors[5:]
    assert [type(f) for f in rest] == ([] if kind is None else [kind])
    if elevation == "hinge":
        assert rest[0].limit == pytest.approx(radians(7))
        assert rest[0].noise.sigma == pytest.approx(radians(1))


@for_all(count=[1, 2, 5])
def test_lawn_mower_by_hand(count: int) -> None:
    path = lawn_mower(count, 3, [1, 0, 0, 0], [0, 3, 0, 1], between=2)
    expected = []
    for leg in range(count):
        expected += [(u, 3 * leg, leg) for u in ((2, 1, 0) if leg % 2 else (0, 1, 2))]
        if leg < count - 1:
            expected += [(expected[-1][0], 3 * leg + step, leg + step / 3) for step in (1, 2)]
    np.testing.assert_allclose(path[:, [0, 1, 3]], expected)
    assert len(swaying(path, 4)) == 4 * (len(path) - 1) + 1


def test_larger_missions_keep_the_density() -> None:
    one, four = (sim.hauv_floor(np.random.default_rng(0), passes=1, per_leg=k) for k in (25, 97))
    assert (one.poses, four.poses) == (124, 412)
    assert "1500 points" in four.description  # 36 m x 11 m
    assert len(four.contacts) / four.poses == pytest.approx(len(one.contacts) / one.poses, rel=0.1)
    assert sim.hauv_hull(np.random.default_rng(0), points=900).landmarks > 3 * 87


@every_mission
def test_contacts_of_any_noise_are_what_a_sonar_gives(make: Make) -> None:
    for seed in range(10):
        z = small(make, seed, noise_scale=1e4, outliers=0.1).contacts.z
        assert (z[:, 0] >= 0).all()
        assert (np.abs(z[:, 1]) <= np.pi).all()


def test_impossible_options_are_refused() -> None:
    floor = {"passes": 0, "legs": 0, "per_leg": 1, "points": 0, "noise_scale": 1e300, "aperture": 0.0}
    more = {"elevation": "guess", "noise_scale": -1.0}
    hull = {"aperture": np.pi, "levels": 0, "per_level": 1.5, "drop_outs": 1.0, "outliers": -0.1}
    for make, options in (
        *((sim.hauv_floor, {name: value}) for name, value in (*floor.items(), *more.items())),
        (sim.hauv_floor, {"per_leg": 10**6, "legs": 10**6}),
        *((sim.hauv_hull, {name: value}) for name, value in hull.items()),
        *((sim.hauv_hull, {"wrong_associations": value}) for value in (1.0, 1.1)),
    ):
        with pytest.raises(OptionError, match="is not possible") as caught:
            make(np.random.default_rng(0), **options)  # type: ignore[arg-type]
        assert next(iter(options)) in caught.value.option
    for options in ({"legs": 1, "per_leg": 2, "passes": 1}, {"legs": 1, "per_leg": 2, "points": 1}):
        with pytest.raises(GraphError, match=r"hauv-floor: none of \d+ points is seen 3 times from \d poses"):
            sim.hauv_floor(np.random.default_rng(0), **options)


@for_all(fan=[10.0, 28.8, 89.0, 130.0, 200.0, 360.0], aperture=[5.0, 60.0, 150.0])
def test_visible_finds_what_any_sonar_sees(fan: float, aperture: float) -> None:
    """Against every pair, for views from a narrow cone to all around; and points at the far corners of the view."""
    rng = np.random.default_rng(int(fan + aperture))
    sonar = ImagingSonar("any", 96, 512, radians(fan), radians(aperture), (0.5, 5.0))
    offset, X = SE3.exp(rng.standard_normal((1, 6)))[0], SE3.exp(rng.standard_normal((7, 6)))
    S = SE3.compose(X, offset[None])
    half = [0.4999 * radians(fan), 0.4999 * radians(aperture)]
    edge = np.column_stack([np.full(4, 4.9999), np.array(list(product((-1, 1), repeat=2))) * half])
    points = np.concatenate([rng.uniform(-6, 6, (300, 3)), SE3.act(S[[2] * 4], cartesian(edge)[0])])
    i, k = np.divmod(np.arange(7 * len(points)), len(points))
    seen = sonar.sees(SE3.act(SE3.inverse(S[i]), points[k]))
    found = visible(X, points, sonar, offset)
    np.testing.assert_array_equal(found[0], i[seen])
    np.testing.assert_array_equal(found[1], k[seen])
    assert set(range(300, 304)) <= set(k[seen & (i == 2)])
