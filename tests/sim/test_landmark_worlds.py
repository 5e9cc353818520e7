"""Subsea and lines: the same bits for a seed, the scenes they say they are, the errors a batch solution has there."""

from __future__ import annotations

from math import erf, exp, pi, radians, sqrt

import numpy as np
import pytest

import sim
from models import LINE
from models.sensors import line_in_frame, normalized
from nls import kinds
from sim.world import reflected
from tests.sim.scenes import made

same = np.testing.assert_allclose
x, l = kinds("x", "l")
CHARTED = {"landmarks": "independent"}
GYRO = {"azimuth": "absolute"}


def content(world: sim.LandmarkWorld) -> list[bytes]:
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
    assert content(plain) == content(first), "first-sight is of filters alone: the graph cannot say it"
    assert [w.landmarks_as for w in (plain, first, charted)] == ["correlated", "first-sight", "independent"]
    assert content(plain)[4:7] == content(charted)[4:7] == content(both)[4:7]
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
