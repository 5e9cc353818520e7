"""Sonar missions as they are defined and their start, and synthetic images: echoes, speckle, contacts."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import pi, radians

import numpy as np
import pytest

import sim
from models import SE3, euler
from models.errors import GraphError, OptionError
from models.sensors import (
    ARIS_3000,
    DIDSON_HIGH,
    DIDSON_LOW,
    ImagingSonar,
    cartesian,
    levelled,
    range_azimuth,
    spherical,
    zpr,
)
from nls import kinds
from sim import Scene
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


NEAR = replace(DIDSON_HIGH, window=(1.0, 6.0))
SONARS = [NEAR, DIDSON_LOW, ARIS_3000]
every_sonar = for_all(sonar=SONARS)


def cell(sonar: ImagingSonar) -> np.ndarray:
    return np.array([(sonar.window[1] - sonar.window[0]) / sonar.bins, sonar.fan / sonar.beams])


def spread_points(sonar: ImagingSonar, seed: int) -> np.ndarray:
    """Points (30, 3) on a grid of the fan, well apart, at random elevations."""
    rng = np.random.default_rng(seed)
    near, far = sonar.window
    r, azimuth = np.meshgrid(np.linspace(near, far, 8)[1:-1], np.linspace(-0.45, 0.45, 5) * sonar.fan)
    h = np.column_stack([r.ravel(), azimuth.ravel(), rng.uniform(-0.5, 0.5, 30) * sonar.aperture])
    h[:, :2] += rng.uniform(-2, 2, (30, 2)) * cell(sonar)
    return cartesian(h)[0]


@for_all(sonar=SONARS, seed=[0, 1])
def test_contacts_are_found_within_a_cell(sonar: ImagingSonar, seed: int) -> None:
    p = spread_points(sonar, seed)
    image = sim.sonar_image(p, sonar, np.random.default_rng(seed))
    found = sim.contacts(image, sonar, threshold=0.5)
    true = range_azimuth(p)[0]
    assert len(found) == len(true) == 30
    away = np.abs(found[:, None] - true[None]) / cell(sonar)
    nearest = away.max(axis=2).argmin(axis=0)
    assert len(set(nearest)) == 30  # each point its own contact
    assert away.max(axis=2).min(axis=0).max() <= 1.0


@every_sonar
def test_without_speckle_an_echo_is_a_bell(sonar: ImagingSonar) -> None:
    """At the center of a cell: the peak is the amplitude, one cell beside it exp(-1/2) of that, or exp(-1/8)."""
    b, k = sonar.beams // 3, sonar.bins // 2
    near, _ = sonar.window
    h = np.array([[near + (k + 0.5) * cell(sonar)[0], ((b + 0.5) / sonar.beams - 0.5) * sonar.fan, 0.05]])
    for spread in (1.0, 2.0):
        image = sim.sonar_image(
            cartesian(h)[0], sonar, np.random.default_rng(0), echo=3.0, background=0.0, spread=spread
        )
        assert image[b, k] == pytest.approx(3.0)
        for at in ((b + 1, k), (b - 1, k), (b, k + 1), (b, k - 1)):
            assert image[at] == pytest.approx(3.0 * np.exp(-0.5 / spread**2))
        assert image[b + 2, k - 1] == pytest.approx(3.0 * np.exp(-2.5 / spread**2))
        assert image.sum() == pytest.approx(3.0 * 2 * np.pi * spread**2, rel=1e-3)
        np.testing.assert_allclose(sim.contacts(image, sonar, 1.0), h[:, :2], atol=1e-9)


def test_elevation_leaves_no_trace() -> None:
    images = [
        sim.sonar_image(cartesian(np.array([[4.0, 0.1, el]]))[0], NEAR, np.random.default_rng(0))
        for el in radians(1.0) * np.array([-6.5, 0.0, 3.0, 6.5])
    ]
    for image in images[1:]:
        np.testing.assert_allclose(image, images[0], atol=1e-12)
    above = sim.sonar_image(cartesian(np.array([[4.0, 0.1, radians(8)]]))[0], NEAR, np.random.default_rng(0))
    assert above.max() < 0.5 < images[0].max()


def test_speckle_of_the_background() -> None:
    """Rayleigh: mean sqrt(pi/2) w, mean square 2 w^2, above 4 w once in 2,981 cells."""
    for w in (0.05, 1.0):
        image = sim.sonar_image(np.zeros((0, 3)), NEAR, np.random.default_rng(1), background=w)
        n = image.size
        assert image.min() > 0
        assert image.mean() == pytest.approx(np.sqrt(np.pi / 2) * w, rel=4 * 0.523 / np.sqrt(n))
        assert (image**2).mean() == pytest.approx(2 * w**2, rel=4 / np.sqrt(n))
        above = (image > 4 * w).sum()
        assert abs(above - n * np.exp(-8)) < 4 * np.sqrt(n * np.exp(-8))


def test_speckle_of_k_distributed_amplitudes() -> None:
    """Mean square 2 w^2; the mean fourth power over its square is 2 (1 + 1 / nu), 2 for Rayleigh."""
    for nu in (0.5, 2.0):
        image = sim.sonar_image(np.zeros((0, 3)), NEAR, np.random.default_rng(2), speckle="k", nu=nu)
        power = image**2
        assert power.mean() == pytest.approx(2 * 0.05**2, rel=0.05)
        assert (power**2).mean() / power.mean() ** 2 == pytest.approx(2 * (1 + 1 / nu), rel=0.1)


def test_a_wall_has_the_stated_amplitude() -> None:
    """Root mean square: the echo at right angles, half of it at 60 deg. A bell squared has the sum sqrt(pi) s."""
    wall = Scene(walls=[[[-9.0, 0.0], [9.0, 0.0]]])
    for turn, amplitude in ((0.0, 2.0), (np.pi / 3, 1.0)):
        pose = [0.0, -2.5, np.pi / 2 - turn]
        image = sim.sonar_image(wall, NEAR, np.random.default_rng(0), echo=2.0, background=0.0, pose=pose)
        power = (image[40:56] ** 2).sum(axis=1) / np.sqrt(np.pi)
        assert np.sqrt(power.mean()) == pytest.approx(amplitude, rel=0.1)


def test_a_pile_hides_the_wall_and_the_rock_behind_it() -> None:
    scene = Scene(walls=[[[5.0, -9.0], [5.0, 9.0]]], piles=[[3.0, 0.0, 0.2]], rocks=[[4.0, 0.0], [4.0, 0.7]])
    image = sim.sonar_image(scene, NEAR, np.random.default_rng(0), pose=[0, 0, 0])
    bins = (np.array([2.8, np.hypot(4, 0.7), 5.0]) - 1) / 5 * 512
    pile, rock, wall = np.rint(bins).astype(int)
    beam = int((np.arctan2(0.7, 4) / NEAR.fan + 0.5) * 96)
    open_water = image[2:20, 250:350].mean()
    shade = image[40:56, pile + 10 : wall + 50]
    assert image[44:52, pile - 1 : pile + 2].mean() > 5 * open_water
    assert image[2:20].max(axis=1).min() > 4 * open_water  # the wall beside it
    assert shade.max() < 0.1  # neither rock nor wall
    assert shade.mean() == pytest.approx(0.3 * open_water, rel=0.05)
    assert image[beam, rock - 1 : rock + 2].max() > 0.7


def test_peaks_that_are_equal_are_one() -> None:
    image = np.zeros((96, 512))
    image[10, 20] = image[10, 21] = 1.0
    image[50, 100] = 1.0
    found = sim.contacts(image, NEAR, 0.5)
    assert len(found) == 2
    assert found[0, 0] == pytest.approx(1.0 + 21 * 5 / 512)
    assert len(sim.contacts(image, NEAR, 1.1)) == 0
    assert sim.contacts(image, NEAR, 1.1).shape == (0, 2)


def test_mistakes_are_named() -> None:
    with pytest.raises(GraphError, match=r"shape \(512, 96\).*makes \(96, 512\): beams, bins"):
        sim.contacts(np.zeros((512, 96)), NEAR, 0.5)
    for option, value in {"echo": -1.0, "background": -0.1, "spread": 0.0}.items():
        with pytest.raises(OptionError, match=option):
            sim.sonar_image(np.zeros((0, 3)), NEAR, np.random.default_rng(0), **{option: value})
    for options, match in (
        ({"speckle": "weibull"}, "'rayleigh' or 'k'"),
        ({"speckle": "k"}, "nu: None"),
        ({"nu": 1.0}, "speckle='k'"),
        ({"speckle": "k", "nu": 0.0}, "nu"),
        ({"shadow": 1.5}, "shadow"),
        ({"pose": [0, 0, 0]}, "points are in the frame of the sonar"),
    ):
        with pytest.raises((OptionError, GraphError), match=match):
            sim.sonar_image(np.zeros((0, 3)), NEAR, np.random.default_rng(0), **options)
    for pose in (None, [0.0, 0.0]):
        with pytest.raises(GraphError, match=r"a scene needs a pose \(3,\)"):
            sim.sonar_image(Scene(), NEAR, np.random.default_rng(0), pose=pose)
    with pytest.raises(OptionError, match="a generator such as"):
        sim.sonar_image(np.zeros((0, 3)), NEAR, 1)
