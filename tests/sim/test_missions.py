"""Sonar missions: the reference scenes as they are defined, measurements that fit their truth, the start as stated."""

from __future__ import annotations

from itertools import product
from math import pi, radians

import numpy as np
import pytest

import sim
from models import SE3, euler
from models.errors import GraphError
from models.sensors import ImagingSonar, cartesian, levelled, spherical, zpr
from nls import kinds
from sim.cli import MISSIONS
from sim.mission import visible
from tests.combinations import for_all
from tests.sim.scenes import made

x, l = kinds("x", "l")
every_mission = for_all(name=MISSIONS)


def states(mission: sim.Mission) -> dict[str, np.ndarray]:
    names = ("roll", "pitch", "yaw", "x", "y", "z")
    return dict(zip(names, euler.from_se3(mission.truth[x]).T, strict=True))


def seen_from(mission: sim.Mission, X: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(range, azimuth, elevation) of points from poses, of each from one."""
    S = SE3.compose(X, mission.offset[None])
    return spherical(SE3.act(SE3.inverse(S), points))[0]


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


@for_all(name=MISSIONS, aperture=[radians(14), radians(28)])
def test_contacts_are_what_the_sonar_sees(name: str, aperture: float) -> None:
    """Every pair in view is a contact and no other: brute force over all poses and landmarks."""
    mission = made(name, aperture=aperture, noise_scale=0.0)
    n, m = mission.poses, mission.landmarks
    h = seen_from(mission, np.repeat(mission.truth[x], m, axis=0), np.tile(mission.truth[l], (n, 1)))
    view = (h[:, 0] >= 1) & (h[:, 0] < 6) & (np.abs(h[:, 1]) < radians(14.4)) & (np.abs(h[:, 2]) <= aperture / 2)
    i, k = np.divmod(np.flatnonzero(view), m)
    np.testing.assert_array_equal(mission.contacts.keys[0].numbers, i)
    np.testing.assert_array_equal(mission.contacts.keys[1].numbers, k)
    np.testing.assert_allclose(mission.contacts.z, h[view, :2], atol=1e-12)
    assert np.bincount(k, minlength=m).min() >= 3


@every_mission
def test_the_start_is_dead_reckoning(name: str) -> None:
    """One step after the other from the first true pose; landmarks where they were first seen, at elevation 0."""
    mission = made(name, 3)
    X, contacts = mission.start[x], mission.contacts
    np.testing.assert_array_equal(X[0], mission.truth[x][0])
    np.testing.assert_allclose(levelled(X[:-1], X[1:])[0], mission.odometry.z, atol=1e-9)
    np.testing.assert_allclose(zpr(X[1:])[0], mission.attitude.z[1:], atol=1e-9)
    numbers, first = np.unique(contacts.keys[1].numbers, return_index=True)  # contacts are in the order of the poses
    h = seen_from(mission, X[contacts.keys[0].numbers[first]], mission.start[l[numbers]])
    np.testing.assert_allclose(h, np.column_stack([contacts.z[first], np.zeros(len(h))]), atol=1e-9)
    anchor, heading = mission.graph.factors[2:4]
    np.testing.assert_allclose(np.ravel(anchor.z), mission.truth[x][0, :2])
    assert float(np.ravel(heading.z)[0]) == pytest.approx(euler.from_se3(mission.truth[x][:1])[0, 2])
    assert (anchor.noise.sqrt_information(1, ("x", "y")) == 1e3).all()
    assert (heading.noise.sqrt_information(1, ("yaw",)) == 1e4).all()


@every_mission
def test_contacts_of_any_noise_are_what_a_sonar_gives(name: str) -> None:
    for seed in range(10):
        z = made(name, seed, noise_scale=1e4, outliers=0.1).contacts.z
        assert (z[:, 0] >= 0).all()
        assert (np.abs(z[:, 1]) <= np.pi).all()


def test_points_that_are_seen_too_seldom() -> None:
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
