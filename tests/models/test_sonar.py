"""Range, azimuth, elevation, the fan image, imaging sonars as data: numbers by hand, refusals; what two views tell."""

from __future__ import annotations

from dataclasses import replace
from math import atan, cos, pi, radians, sin, sqrt

import numpy as np
import pytest

from models import SE3, sensors
from models.algebra import Array
from models.errors import OptionError
from models.sensors import DIDSON_HIGH, DIDSON_LOW, cartesian, elevation, plane_projection, range_azimuth, spherical

same = np.testing.assert_allclose


def points(n: int = 200, seed: int = 0) -> Array:
    """All around the sonar."""
    return np.random.default_rng(seed).normal(scale=3.0, size=(n, 3))


def test_points_by_hand() -> None:
    """Ahead and below at 3-4-5; to starboard; behind, where atan(y / x) would say ahead; up."""
    p = np.array([[4.0, 0.0, 3.0], [0.0, 2.0, 0.0], [-1.0, -1.0, 0.0], [1.0, 0.0, -1.0]])
    h = [[5.0, 0.0, atan(3 / 4)], [2.0, pi / 2, 0.0], [sqrt(2), -3 * pi / 4, 0.0], [sqrt(2), 0.0, -pi / 4]]
    same(spherical(p)[0], h, atol=1e-15)
    same(range_azimuth(p)[0], np.array(h)[:, :2], atol=1e-15)
    same(elevation(p)[0], np.array(h)[:, 2:], atol=1e-15)
    same(cartesian(np.array(h))[0], p, atol=1e-15)


def test_there_and_back() -> None:
    h = np.random.default_rng(1).uniform([1.0, -3.0, -1.5], [9.0, 3.0, 1.5], size=(100, 3))
    same(np.linalg.norm(cartesian(h)[0], axis=1), h[:, 0])  # with the sine of the elevation, not of the azimuth
    same(spherical(cartesian(h)[0])[0], h, atol=1e-12)
    p = points()
    p = p[np.hypot(p[:, 0], p[:, 1]) > 0.3]
    h, J = spherical(p)
    same(range_azimuth(p)[1], J[:, :2])
    same(elevation(p)[1], J[:, 2:])
    q, dq = cartesian(h)
    same(q, p, atol=1e-12)
    same(np.linalg.det(dq), h[:, 0] ** 2 * np.cos(h[:, 2]), rtol=1e-9)


def test_the_fan_image() -> None:
    """r (cos az, sin az): longer than (x, y) by 1 / cos el; the whole arc is one pixel, up to its ends."""
    p = points(seed=3)
    h, _ = spherical(p)
    image = plane_projection(p)
    same(image, p[:, :2] / np.cos(h[:, 2:]), rtol=1e-9)
    same(np.linalg.norm(image, axis=1), h[:, 0])
    els = np.linspace(-pi / 2 + 1e-6, pi / 2 - 1e-6, 7)
    arc, _ = cartesian(np.column_stack([np.full(7, 5.0), np.full(7, 0.2), els]))
    same(plane_projection(arc), np.tile([5 * cos(0.2), 5 * sin(0.2)], (7, 1)), atol=1e-9)
    (p,), _ = cartesian(np.array([[5.0, 0.0, radians(7)]]))
    assert 5.0 - np.hypot(p[0], p[1]) == pytest.approx(0.0373, abs=1e-4)  # how much shorter the planar reading is


def test_the_noise_of_a_didson() -> None:
    """0.3 deg / sqrt(12) = 1.51 mrad; 5 m / 512 / sqrt(12) = 2.8 mm; cells of 8 cm and 0.24 cm for 40 and 1.25 m."""
    didson = replace(DIDSON_HIGH, window=(1.0, 6.0))
    assert didson.sigma_azimuth == pytest.approx(1.51e-3, abs=5e-6)
    assert didson.sigma_range == pytest.approx(2.82e-3, abs=5e-6)
    same(didson.noise_sigmas, [didson.sigma_range, didson.sigma_azimuth])
    worse = replace(didson, quality=4.0)
    same(worse.noise_sigmas, 4 * didson.noise_sigmas)
    assert replace(DIDSON_LOW, window=(1.0, 41.0)).sigma_range * sqrt(12) == pytest.approx(0.08, abs=2e-3)
    assert replace(DIDSON_HIGH, window=(1.0, 2.25)).sigma_range * sqrt(12) == pytest.approx(0.0024, abs=1e-4)
    assert DIDSON_LOW.fan / DIDSON_LOW.beams == pytest.approx(radians(0.6))


def test_edges_are_inside() -> None:
    """Of the window, the fan (here all around, where the two edges are one) and the aperture, and of the last cell."""
    around = replace(DIDSON_HIGH, fan=2 * pi, window=(1.0, 11.0))
    behind = np.array([[-3.0, 0.0, 0.0], [-3.0, -0.0, 0.0], [-3.0, 1e-9, 0.0], [-3.0, -1e-9, 0.0]])
    assert around.sees(behind).all()
    assert around.beam([-pi, pi]).tolist() == [0, around.beams - 1]
    assert DIDSON_HIGH.sees(np.array([[1.0, 0.0, 0.0], [11.0, 0.0, 0.0]])).all()
    assert not DIDSON_HIGH.sees(np.array([[np.nextafter(1.0, 0), 0.0, 0.0], [np.nextafter(11.0, 12), 0.0, 0.0]])).any()
    assert DIDSON_HIGH.bin([1.0, 11.0]).tolist() == [0, DIDSON_HIGH.bins - 1]
    square = replace(DIDSON_HIGH, fan=pi / 2, aperture=pi / 2)
    assert square.sees(np.array([[2.0, 2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 0.0, 2.0], [2.0, 0.0, -2.0]])).all()
    same(square.quantized(np.array([[11.0, pi / 4]])), [[11.0 - 5 / 512, pi / 4 - pi / 4 / 96]])


def test_what_is_not_in_sight_has_no_cell() -> None:
    """Nor has the mirror image of a point in sight: same y / x, other side."""
    (p,), _ = cartesian(np.array([[5.0, 0.1, 0.05]]))
    assert DIDSON_HIGH.sees(np.array([p, -p, [-p[0], p[1], p[2]]])).tolist() == [True, False, False]
    p = np.array([[np.nan, 0.0, 0.0], [np.inf, 0.0, 0.0], [3.0, -np.inf, np.nan], [3.0, 0.0, 0.0]])
    assert DIDSON_HIGH.sees(p).tolist() == [False, False, False, True]
    assert DIDSON_HIGH.bin([np.nan, -np.inf, np.inf]).tolist() == [-1, -1, DIDSON_HIGH.bins]
    for bad in ([0.5, 0.0], [12.0, 0.0], [5.0, 0.3], [5.0, -0.3], [np.nan, 0.0], [5.0, np.nan]):
        with pytest.raises(OptionError, match=r"z\[1\].* from 1 to 11 m .* within 0.2513 rad"):
            DIDSON_HIGH.quantized(np.array([[5.0, 0.1], bad, bad]))


NO_SONAR = {
    "beams": [0, 1.5, True],
    "bins": [float("inf"), -1],
    "fan": [28.8, "wide"],
    "aperture": [14.0, None],
    "window": [(6.0, 1.0), (0.0, 1.0), (1.0, float("nan")), None, (1, 2, 3), ("a", "b")],
    "quality": [0.0, np.array([1.0, 2.0])],
}


@pytest.mark.parametrize("name", NO_SONAR)
def test_no_such_sonar(name: str) -> None:
    for value in NO_SONAR[name]:  # type: ignore[attr-defined]
        with pytest.raises(OptionError, match=f"DIDSON, high frequency: {name}: ") as caught:
            replace(DIDSON_HIGH, **{name: value})  # type: ignore[arg-type]
        assert caught.value.value is value


# ---- how well two views of a point tell its elevation, motion by motion: the table of the page on sonar

# The point has the parameters (r, az, el) in the frame of the first view, which measures the first two. What both views
# say of el when r and az are unknown too is the Schur complement of their information matrix.
SIGMAS = np.array([0.01, 0.005])  # range, m; azimuth, rad
STEP = {  # a motion of the sonar from its first view to its second: (x, y, z, roll, pitch, yaw), m and rad
    "surge": [0.3, 0, 0, 0, 0, 0],
    "sway": [0, 0.3, 0, 0, 0, 0],
    "heave": [0, 0, 0.3, 0, 0, 0],
    "roll": [0, 0, 0, 0.1, 0, 0],
    "pitch": [0, 0, 0, 0, 0.1, 0],
    "yaw": [0, 0, 0, 0, 0, 0.1],
    "planar": [0.3, 0.2, 0, 0, 0, 0.1],
}
MOUNT = SE3.exp([0.0, 0.0, 0.0, 0.0, -np.deg2rad(35), 0.0])  # a sonar that looks down
STEP["surge, looking down"] = SE3.log(SE3.compose(SE3.inverse(MOUNT), SE3.compose(SE3.exp(STEP["surge"]), MOUNT)))
TABLE = {  # information on el, 1/rad^2, of a point at 4 m and 0.2 rad: at elevation 0 and at 0.05 rad
    "heave": (448.74, 450.99),
    "roll": (192.50, 192.89),
    "surge, looking down": (167.39, 190.24),
    "pitch": (7.984, 8.143),
    "planar": (0.0, 1.641),
    "surge": (0.0, 1.268),
    "sway": (0.0, 0.3155),
    "yaw": (0.0, 0.0),
}


def second_view(step: str, h: Array) -> tuple[Array, Array]:
    """(r, az) (n, 2) of the second view and their derivative (n, 2, 3) by (r, az, el) of the first."""
    p, dp = cartesian(h)
    q, (_, R_inv) = sensors.point_in_frame(SE3, np.tile(SE3.exp(STEP[step]), (len(h), 1)), p)
    z, J = range_azimuth(q)
    return z, J @ R_inv @ dp


def information(step: str, r: float = 4.0, az: float = 0.2, el: float = 0.0) -> float:
    """Of el, 1/rad^2: I_el,el - I_el,o I_o,o^-1 I_o,el with o = (r, az)."""
    _, H_2 = second_view(step, np.array([[r, az, el]]))
    A = np.concatenate([np.eye(3)[:2], H_2[0]]) / np.tile(SIGMAS, 2)[:, None]
    I = A.T @ A
    return float(I[2, 2] - I[2, :2] @ np.linalg.solve(I[:2, :2], I[:2, 2]))


TINY = 1e-10  # of informations of 10 to 1000
AZIMUTHS = (-0.25, 0.0, 0.2)


@pytest.mark.parametrize("step", ["surge", "sway", "planar"])
def test_motion_in_the_plane_says_nothing_at_elevation_0_and_little_beside_it(step: str) -> None:
    """The derivative is proportional to sin el, the information to its square; up and down look the same."""
    for az in AZIMUTHS:
        assert abs(information(step, az=az, el=0.0)) < TINY
        found = [information(step, az=az, el=el) for el in (0.025, 0.05, 0.1)]
        same(np.array(found[1:]) / found[:-1], 4.0, rtol=0.05)
    h = np.random.default_rng(1).uniform([1.0, -0.25, -0.2], [6.0, 0.25, 0.2], size=(50, 3))
    same(second_view(step, h)[0], second_view(step, h * [1, 1, -1])[0], atol=1e-14)
    _, H = second_view(step, h * [1, 1, 0])
    same(H[:, :, 2], 0.0, atol=1e-15)  # Gauss-Newton started at elevation 0 never leaves it


def test_the_table() -> None:
    for step, row in TABLE.items():
        assert [information(step, el=el) for el in (0.0, 0.05)] == pytest.approx(row, rel=1e-3, abs=TINY), step
