"""Sensor equations against numbers done by hand, where they have no value, presets of a DVL, depth from pressure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import atan2, pi, radians, sqrt
from typing import Any

import numpy as np
import pytest

from models import SE2, SE3, euler, sensors
from models.algebra import Array
from models.errors import LeadlineError, OptionError
from models.pressure import GRAVITY, depth_by_density, depth_unesco
from models.sensors import direction, distance, levelled, point_in_frame, point_on_body, project, relative_xyh, zpr
from models.sensors.dvl import DVL, HOLOOCEAN_DVL, dvl_velocity
from models.sensors.singular import CLOSE

same = np.testing.assert_allclose
HALF = sqrt(0.5)


def test_by_hand_and_back() -> None:
    """Starboard is positive, astern is -pi, not pi; down (z > 0) is positive elevation."""
    same(distance(np.array([[3.0, -4.0, 12.0], [0.0, 0.0, 2.0]]))[0], [[13.0], [2.0]])
    bearings = direction(np.array([[1.0, 1.0], [0.0, -2.0], [-3.0, 0.0], [-1.0, 1.0]]))[0]
    same(bearings, [[pi / 4], [-pi / 2], [-pi], [3 * pi / 4]])
    angles = direction(np.array([[1.0, 1.0, sqrt(2)], [-3.0, 4.0, -5.0]]))[0]
    same(angles, [[pi / 4, pi / 4], [atan2(4, -3), -pi / 4]])
    for d in (2, 3):
        p = np.random.default_rng(2).uniform(1, 6, size=(20, d)) * np.random.default_rng(3).choice([-1, 1], (20, d))
        same(
            sensors.point_from_direction_range(np.concatenate([direction(p)[0], distance(p)[0]], axis=1)), p, atol=1e-13
        )
    for near in (CLOSE * 2, CLOSE * 1e3, CLOSE * 1e6):
        r, direct = distance(np.array([[near, 0.0]])), direction(np.array([[near, 0.0]]))
        same(r[0], [[near]])
        same(r[1], [[[1.0, 0.0]]])
        same(direct[0], [[0.0]])
        same(direct[1], [[[0.0, 1 / near]]])


def test_points_and_poses_by_hand() -> None:
    """At (1, 2), looking along +y: the point (1, 5) is 3 m ahead; (4, 2) is 3 m on the right, -y in these axes."""
    X, T = np.array([[1.0, 2.0, pi / 2]] * 2), np.array([[1.0, 2.0, 3.0, 0.0, 0.0, HALF, HALF]])
    same(point_in_frame(SE2, X, np.array([[1.0, 5.0], [4.0, 2.0]]))[0], [[3.0, 0.0], [0.0, -3.0]], atol=1e-15)
    same(point_in_frame(SE3, T, np.array([[1.0, 5.0, 4.0]]))[0], [[3.0, 0.0, 1.0]], atol=1e-15)
    same(point_on_body(SE2, X[:1], np.array([[3.0, 0.0]]))[0], [[1.0, 5.0]])
    same(point_on_body(SE3, T, np.array([[3.0, 0.0, 1.0]]))[0], [[1.0, 5.0, 4.0]])


def states(n: int, seed: int) -> Array:
    """Euler vectors (roll, pitch, yaw, x, y, z), pitched up to 89 deg."""
    limit = np.array([pi, radians(89), pi, 5.0, 5.0, 5.0])
    return np.random.default_rng(seed).uniform(-limit, limit, size=(n, 6))


def test_levelled_steps_are_differences_of_poses_of_the_plane() -> None:
    """By hand, rolled: 3 m east, 1 m north, down 4 m, east to south-west is 3 ahead, 1 to port, 135 deg."""
    i, j = [[0.5, -0.3, pi / 2, 1.0, 2.0, 5.0]], [[-0.2, 0.1, -3 * pi / 4, 2.0, 5.0, 9.0]]
    same(levelled(euler.to_se3(i), euler.to_se3(j))[0], [[3.0, -1.0, 3 * pi / 4]], atol=1e-14)
    a, b = states(300, 1), states(300, 2)
    plane = SE2.between(a[:, [3, 4, 2]], b[:, [3, 4, 2]])
    h, _ = levelled(euler.to_se3(a), euler.to_se3(b))
    same(h[:, :2], plane[:, :2], atol=1e-12)
    same(np.exp(1j * h[:, 2]), np.exp(1j * plane[:, 2]), atol=1e-12)
    assert (np.abs(h[:, 2]) <= pi).all()
    same(zpr(euler.to_se3(a))[0], a[:, [5, 1, 0]], atol=1e-11)


LOCKED = euler.to_se3([[0.3, 0.1, 0.1, 1, 2, 3], [0.3, pi / 2, 0.1, 1, 2, 3], [0.3, -pi / 2, 0.1, 1, 2, 3]])
LEVEL = SE3.identity(3)
SINGULAR: list[tuple[Callable[..., object], list[Any], str]] = [  # of three measurements the second has no value
    *((distance, [[np.ones(len(p)), p, p]], "zero range") for p in ([0, 0], [0, 0, 1e-10], [1e-200, 1e-200, 0])),
    (direction, [[[1, 1], [0, 0], [0, 0]]], "its bearing"),
    (direction, [[[1, 1, 1], [0, 0, 7], [1e-10, 0, -7]]], "z axis"),
    (lambda X: sensors.heading(SE3, X), [LOCKED], "gimbal lock"),
    (zpr, [LOCKED], "gimbal lock"),
    (levelled, [LOCKED, LEVEL], "gimbal lock"),
    (levelled, [LEVEL, LOCKED], "gimbal lock"),
    (relative_xyh, [LEVEL, LOCKED], "gimbal lock"),
    (project, [np.zeros((3, 6)), [[10, 0, 0]] * 3, [[1, 2, 4], [1, 2, 0], [0, 0, 0]]], "in the plane of the camera"),
    (project, [np.zeros((3, 6)), [[10, 0, 0]] * 3, [[1, 2, 4], [1e6, 0, 1e-5], [0, 0, 0]]], "in the plane"),
]


def test_measurements_without_a_value_are_named() -> None:
    for f, arguments, named in SINGULAR:
        with pytest.raises(sensors.SingularAt, match=named) as caught:
            f(*(np.array(argument, dtype=float) for argument in arguments))
        assert caught.value.index == 1
    up = euler.to_se3([[0.0, pi / 2, 0.0, 0.0, 0.0, 0.0]])  # a relative step between two such poses has a value
    same(relative_xyh(up, SE3.compose(up, euler.to_se3([[0.1, 0.2, 0.3, 1.0, 2.0, 3.0]])))[0], [[1.0, 2.0, 0.3]])
    behind = project(np.zeros((1, 6)), np.array([[10.0, 0.0, 0.0]]), np.array([[1.0, 2.0, 4.0]]))
    same(behind[0], [[-2.5, -5.0]])


def test_the_velocity_of_a_dvl_by_hand_and_one_mounting_for_all() -> None:
    mount = np.array([[-1.5, 0.2, 0.4, 0.0, 0.0, HALF, HALF]])  # aft, its x to starboard
    v, w = np.tile([1.0, 0.5, -0.2], (7, 1)), np.tile([0.0, 0.0, 0.1], (7, 1))
    v_d, one = dvl_velocity(v, w, mount)
    body = np.array([1.0 - 0.1 * 0.2, 0.5 - 0.1 * 1.5, -0.2])  # v + w x a
    same(v_d, np.tile([body[1], -body[0], body[2]], (7, 1)), atol=1e-15)
    assert [H.shape for H in one] == [(7, 3, 3), (7, 3, 3), (7, 3, 6)]


def test_a_dvl_is_a_value_that_can_be() -> None:
    ahead = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    mounted = replace(HOLOOCEAN_DVL, mount=np.array(ahead))
    assert mounted == replace(HOLOOCEAN_DVL, mount=ahead)
    assert len({mounted, HOLOOCEAN_DVL}) == 2
    for name, bads in (("sigma", (0.0, float("nan"), "a")), ("scale", (-0.1,)), ("mount", ((0.0,) * 3, (0.0,) * 7))):
        for bad in bads:
            with pytest.raises(OptionError, match=f"{name}: "):
                DVL(**{"name": "mine", "sigma": 0.01, name: bad})


def test_the_check_value_of_the_source() -> None:
    assert float(depth_unesco(1e8, 30.0)) == pytest.approx(9712.653, abs=5e-4)


def test_teos_10_has_the_same_but_for_a_hundredth_of_a_percent() -> None:
    gsw = pytest.importorskip("gsw")
    for latitude in (-60.0, 0.0, 45.0):
        for dbar, most in ((10.0, 3e-6), (1000.0, 3e-6), (10000.0, 1.3e-4)):
            assert float(depth_unesco(dbar * 1e4, latitude)) == pytest.approx(-gsw.z_from_p(dbar, latitude), rel=most)


def test_a_column_of_water_weighs_its_pressure() -> None:
    assert float(depth_by_density(1025.0 * GRAVITY * 37.0, 1025.0)) == pytest.approx(37.0)
    assert float(depth_by_density(0.0, 1025.0)) == 0.0
    for density in (0.0, -1.0, np.nan, "sea"):
        with pytest.raises(LeadlineError, match="density"):
            depth_by_density(1e5, density)  # type: ignore[arg-type]
    with pytest.raises(LeadlineError, match="latitude"):
        depth_unesco(1e5, 91.0)
