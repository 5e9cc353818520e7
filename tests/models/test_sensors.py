"""Sensor equations against numbers done by hand, and their derivatives against central differences."""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, pi, sqrt

import numpy as np
import pytest

from models import SE2, SE3, euler
from models.algebra import Array
from models.errors import SingularGeometryError
from models.sensors import (
    SingularAt,
    direction,
    distance,
    heading,
    point_from_direction_range,
    point_in_frame,
    point_on_body,
    project,
)
from models.sensors.singular import CLOSE
from tests.models.differences import difference, on_group

same = np.testing.assert_allclose
HALF = sqrt(0.5)


def test_distance_by_hand() -> None:
    r, J = distance(np.array([[3.0, -4.0, 12.0], [0.0, 0.0, 2.0]]))
    same(r, [[13.0], [2.0]])
    same(J, [[[3 / 13, -4 / 13, 12 / 13]], [[0.0, 0.0, 1.0]]])


def test_bearing_by_hand() -> None:
    """Starboard is positive; astern is -pi, not pi."""
    h, J = direction(np.array([[1.0, 1.0], [0.0, -2.0], [-3.0, 0.0], [-1.0, 1.0]]))
    same(h, [[pi / 4], [-pi / 2], [-pi], [3 * pi / 4]])
    same(J[:2], [[[-0.5, 0.5]], [[0.5, 0.0]]], atol=1e-16)


def test_azimuth_and_elevation_by_hand() -> None:
    """Down (z > 0) is positive elevation."""
    h, J = direction(np.array([[1.0, 1.0, sqrt(2)], [-3.0, 4.0, -5.0]]))
    same(h, [[pi / 4, pi / 4], [atan2(4, -3), -pi / 4]])
    same(J[0], [[-0.5, 0.5, 0.0], [-0.25, -0.25, sqrt(2) / 4]])
    same(J[1, 1], [-0.06, 0.08, 0.1])


def test_derivatives_and_the_way_back_from_direction_and_range() -> None:
    for d in (2, 3):
        p = np.random.default_rng(2).uniform(1, 6, size=(20, d)) * np.random.default_rng(3).choice([-1, 1], (20, d))
        same(point_from_direction_range(np.concatenate([direction(p)[0], distance(p)[0]], axis=1)), p, atol=1e-13)
        for f in (distance, direction):
            same(f(p)[1], difference(lambda q, f=f: f(q)[0], p), atol=1e-8)
    for near in (CLOSE * 2, CLOSE * 1e3, CLOSE * 1e6):
        r, direct = distance(np.array([[near, 0.0]])), direction(np.array([[near, 0.0]]))
        same(r[0], [[near]])
        same(r[1], [[[1.0, 0.0]]])
        same(direct[0], [[0.0]])
        same(direct[1], [[[0.0, 1 / near]]])


@pytest.mark.parametrize(
    ("f", "singular", "where"),
    [
        (distance, [[0.0, 0.0], [0.0, 0.0, 1e-10], [1e-200, 1e-200, 0.0]], "zero range"),
        (direction, [[0.0, 0.0]], "its bearing"),
        (direction, [[0.0, 0.0, 7.0], [1e-10, 0.0, -7.0]], "z axis"),
    ],
)
def test_singular_targets_are_named(f: Callable[[Array], object], singular: list[list[float]], where: str) -> None:
    for p in singular:
        with pytest.raises(SingularAt, match=where) as caught:
            f(np.array([np.ones(len(p)), p, p]))
        assert caught.value.index == 1
        assert isinstance(caught.value, SingularGeometryError)


def test_a_point_in_the_frame_of_a_pose_by_hand() -> None:
    """At (1, 2), looking along +y: the point (1, 5) is 3 m ahead; (4, 2) is 3 m on the right, -y in these axes."""
    X = np.array([[1.0, 2.0, pi / 2]] * 2)
    p, (H_S, H_l) = point_in_frame(SE2, X, np.array([[1.0, 5.0], [4.0, 2.0]]))
    same(p, [[3.0, 0.0], [0.0, -3.0]], atol=1e-15)
    same(H_S, [[[-1, 0, 0], [0, -1, -3]], [[-1, 0, -3], [0, -1, 0]]], atol=1e-15)
    same(H_l, [[[0, 1], [-1, 0]]] * 2, atol=1e-15)
    T = np.array([[1.0, 2.0, 3.0, 0.0, 0.0, HALF, HALF]])
    p, (H_T, H_l) = point_in_frame(SE3, T, np.array([[1.0, 5.0, 4.0]]))
    same(p, [[3.0, 0.0, 1.0]], atol=1e-15)
    same(H_T, [[[-1, 0, 0, 0, -1, 0], [0, -1, 0, 1, 0, -3], [0, 0, -1, 0, 3, 0]]], atol=1e-15)
    same(H_l, [[[0, 1, 0], [-1, 0, 0], [0, 0, 1]]], atol=1e-15)


def test_a_point_on_the_body_by_hand() -> None:
    q, H = point_on_body(SE2, np.array([[1.0, 2.0, pi / 2]]), np.array([[3.0, 0.0]]))
    same(q, [[1.0, 5.0]])
    same(H, [[[0, -1, -3], [1, 0, 0]]], atol=1e-15)
    q, H = point_on_body(SE3, np.array([[1.0, 2.0, 3.0, 0.0, 0.0, HALF, HALF]]), np.array([[3.0, 0.0, 1.0]]))
    same(q, [[1.0, 5.0, 4.0]])
    same(H, [[[0, -1, 0, 1, 0, -3], [1, 0, 0, 0, 1, 0], [0, 0, 1, 0, -3, 0]]], atol=1e-15)


def test_derivatives_for_poses() -> None:
    rng = np.random.default_rng(5)
    for group in (SE2, SE3):
        X = group.exp(rng.uniform(-1.1, 1.1, size=(8, group.dim)))
        l, a = rng.normal(size=(2, 8, group.point_dim))
        p, (H_S, H_l) = point_in_frame(group, X, l)
        same(H_S, on_group(group, lambda Y, g=group, l=l: point_in_frame(g, Y, l)[0], X), atol=1e-8)
        same(H_l, difference(lambda q, g=group, X=X: point_in_frame(g, X, q)[0], l), atol=1e-8)
        same(point_on_body(group, X, p)[0], l, atol=1e-14)
        H_a = on_group(group, lambda Y, g=group, a=a: point_on_body(g, Y, a)[0], X)
        same(point_on_body(group, X, a)[1], H_a, atol=1e-8)
        H = np.broadcast_to(heading(group, X)[1], (8, 1, group.dim))
        same(H, on_group(group, lambda Y, g=group: heading(g, Y)[0], X), atol=1e-8)
    for pitch in (pi / 2, -pi / 2):
        with pytest.raises(SingularAt, match="gimbal lock") as caught:
            heading(SE3, euler.to_se3(np.array([[0.0, 0.1, 0.4, 1, 2, 3], [0.0, pitch, 0.4, 1, 2, 3]])))
        assert caught.value.index == 1


def test_derivatives_of_an_image() -> None:
    rng = np.random.default_rng(6)
    camera = rng.normal([0, 0, 0, 0, 0, -9], size=(9, 6))
    camera[0, :3], camera[1, :3] = 0.0, [3.14, 0.0, 0.0]
    intrinsics, X = rng.normal([3, 0, 0], 0.1, size=(9, 3)), rng.normal(size=(9, 3))
    h, (H_c, H_f, H_X) = project(camera, intrinsics, X)
    assert h.shape == (9, 2)
    same(H_c, difference(lambda c: project(c, intrinsics, X)[0], camera), atol=2e-8)
    same(H_f, difference(lambda f: project(camera, f, X)[0], intrinsics), atol=2e-8)
    same(H_X, difference(lambda x: project(camera, intrinsics, x)[0], X), atol=2e-8)


def test_a_point_behind_the_camera_has_an_image_in_its_plane_it_has_none() -> None:
    f, origin = np.array([[10.0, 0.0, 0.0]]), np.zeros((1, 6))
    same(project(origin, f, np.array([[1.0, 2.0, 4.0]]))[0], [[-2.5, -5.0]])
    for X in ([[1.0, 2.0, 0.0]], [[0.0, 0.0, 0.0]], [[1e6, 0.0, 1e-5]]):
        with pytest.raises(SingularAt, match="in the plane of the camera"):
            project(origin, f, np.array(X))
