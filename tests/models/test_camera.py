"""The camera: images and derivatives by hand, rays back from every pixel, what has none; where a ray meets a range."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from models.algebra import Array
from models.errors import GraphError, OptionError, SingularGeometryError
from models.ray_range import ray_range
from models.sensors import Camera, SingularAt
from tests.models.differences import difference

same = np.testing.assert_allclose
WIDE = (-0.28, 0.07, 0.0005, -0.0003)  # k1 k2 p1 p2: about that of a wide-angle camera behind a flat port
LENSES = [(), (-0.05,), WIDE, (0.1, -0.02, 0.001, 0.002, 0.005), (0.3, 0.1), (-0.3, 0.1, 1e-3, -2e-3, -0.01)]


def camera_with(distortion: tuple[float, ...]) -> Camera:
    return Camera((600.0, 610.0), (630.0, 485.0), distortion, (1280, 960))


def pixels() -> Array:
    """A grid over the whole image, its edges and corners included."""
    u, v = np.meshgrid(np.linspace(0, 1280, 65), np.linspace(0, 960, 49))
    return np.column_stack([u.ravel(), v.ravel()])


def scattered(n: int, seed: int, wide: float = 0.8) -> Array:
    """Points in front, at different depths."""
    rng = np.random.default_rng(seed)
    m = rng.uniform(-wide, wide, size=(n, 2))
    return np.column_stack([m, np.ones(n)]) * rng.uniform(0.5, 20.0, size=(n, 1))


def test_images_by_hand() -> None:
    p = np.array([[1.0, -2.0, 4.0], [0.0, 0.0, 0.5]])
    same(Camera().project(p)[0], [[0.25, -0.5], [0.0, 0.0]])
    same(Camera((600.0, 500.0), (640.0, 480.0)).project(p)[0], [[790.0, 230.0], [640.0, 480.0]])
    b, _ = Camera((100.0, 200.0), (50.0, 60.0)).ray([[50.0, 60.0], [150.0, 60.0]])
    same(b, [[0, 0, 1], [np.sqrt(0.5), 0, np.sqrt(0.5)]], atol=1e-15)


def test_every_coefficient_of_the_distortion_by_hand() -> None:
    """At (x, y) = (1/2, 1): r^2 = 5/4. One coefficient at a time, in the order k1 k2 p1 p2 k3."""
    p = np.array([[1.0, 2.0, 2.0]])
    moved = [(0.5 * 1.25, 1.25), (0.5 * 1.25**2, 1.25**2), (2 * 0.5, 1.25 + 2), (1.25 + 2 * 0.25, 2 * 0.5)]
    moved.append((0.5 * 1.25**3, 1.25**3))
    for k, (dx, dy) in enumerate(moved):
        distortion = (*[0.0] * k, 0.01)
        same(Camera(distortion=distortion).project(p)[0], [[0.5 + 0.01 * dx, 1 + 0.01 * dy]], rtol=1e-15)
        assert Camera(distortion=distortion) != Camera()


@pytest.mark.parametrize("distortion", LENSES, ids=str)
def test_there_and_back_over_the_whole_image(distortion: tuple[float, ...]) -> None:
    camera, p, z = camera_with(distortion), scattered(40, 1), pixels()
    for some in (p, p[:1]):
        h, J = camera.project(some)
        same(J, difference(lambda q: camera.project(q)[0], some), rtol=1e-6, atol=1e-5)
        same(np.matvec(J, some), 0.0, atol=1e-10)  # along the ray nothing changes
        same(camera.ray(h)[0], some / np.linalg.norm(some, axis=1, keepdims=True), atol=1e-11)
    b, J = camera.ray(z)
    same(np.linalg.norm(b, axis=1), 1.0, rtol=1e-14)
    assert (b[:, 2] > 0).all()
    for depth in (0.1, 50.0):
        same(camera.project(depth * b)[0], z, atol=1e-8)
    same(J, difference(lambda y: camera.ray(y)[0], z, 1e-3), atol=1e-10)
    same(np.matvec(J.mT, b), 0.0, atol=1e-15)  # a unit vector turns
    for bad in ([0.5, 0.1, -2.0], [0.5, 0.1, 0.0], [1.0, 1.0, 1e-10], [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]):
        with pytest.raises(SingularAt, match="behind the camera") as caught:
            camera.project(np.array([[0.0, 0.0, 1.0], bad, bad]))
        assert caught.value.index == 1
        same(camera.sees(np.array([[0.0, 0.0, 1.0], bad])), [True, False])


def test_reach() -> None:
    for distortion, reach in (
        ((), np.inf),
        ((0.3,), np.inf),
        ((-0.2,), np.sqrt(1 / 0.6)),  # 1 + 3 k1 s = 0
        ((0.0, -0.1), 2**0.25),  # 1 + 5 k2 s^2 = 0
        ((0.0, 0.0, 0.0, 0.0, -1 / 7), 1.0),  # 1 + 7 k3 s^3 = 0
        ((0.0, 0.0, 0.03, 0.04), 1 / 0.3),  # 1 - 6 |q| sqrt(s) = 0
    ):
        assert Camera(distortion=distortion).reach == pytest.approx(reach, rel=1e-12)


@pytest.mark.parametrize("distortion", [(-0.2,), (-0.2, 0.0, 0.01, -0.005)], ids=str)
def test_a_pixel_beyond_the_fold_has_no_ray(distortion: tuple[float, ...]) -> None:
    """The image of a barrel distortion ends where it folds: along x at m = reach, for the first at 2/3 of it."""
    camera, z, a = camera_with(distortion), pixels(), np.linspace(0, 2 * pi, 361)
    m = 0.999 * camera.reach * np.array([np.cos(a), np.sin(a)])
    edge = camera.project(np.column_stack([*m, np.ones(361)]))[0]
    radius, r = (np.linalg.norm((y - camera.center) / camera.focal, axis=1) for y in (edge, z))
    inside, outside = r < radius.min(), r > 1.01 * radius.max()
    assert min(inside.sum(), outside.sum()) > 100
    same(camera.project(camera.ray(z[inside])[0])[0], z[inside], atol=1e-8)
    first = int(np.argmax(outside))
    limit = np.degrees(np.arctan(camera.reach))
    with pytest.raises(SingularAt, match=rf"\({z[first, 0]:g}, {z[first, 1]:g}\) .* {limit:.3g} deg") as caught:
        camera.ray(np.concatenate([z[inside][:3], z[[first]], z[outside][-1:]]))
    assert caught.value.index == 3
    for k in np.flatnonzero(outside)[::97]:
        with pytest.raises(SingularGeometryError, match="no ray"):
            camera.ray(z[[k]])
    for any_camera in (Camera((600.0, 600.0), (640.0, 480.0)), camera):
        with pytest.raises(SingularAt, match=r"\(nan, 3\)"):
            any_camera.ray([[640.0, 480.0], [np.nan, 3.0]])


def test_sees() -> None:
    camera = camera_with(())
    b = camera.ray([[0.0, 0.0], [1280.0, 960.0], [640.0, 480.0]])[0]
    same(camera.sees(9 * 0.999999 * b + [[1e-6, 1e-6, 0], [-1e-6, -1e-6, 0], [0, 0, 0]]), True)
    outside = camera.ray([[-0.1, 5.0], [5.0, -0.1], [1280.1, 5.0], [5.0, 960.1]])[0]
    same(camera.sees(outside), False)
    same(Camera(camera.focal, camera.center).sees(outside), True)  # no edges
    same(camera.sees(np.array([[np.nan, 0, 1], [0, np.inf, 1], [0, 0, np.nan], [0.0, 0.0, np.inf]])), False)
    assert camera.sees(np.zeros((0, 3))).shape == (0,)


NO_CAMERA = {
    "focal": [(600.0, 0.0), (600.0, -1.0), 600.0, (600.0, np.nan)],
    "center": [(640.0,), (640.0, np.inf), "ab"],
    "distortion": [(0.0,) * 6, 0.1, (np.nan,)],
    "size": [(1280.0, 960.0), (0, 960), (1280, 960, 3)],
}


def test_cameras_that_are_none() -> None:
    for name, values in NO_CAMERA.items():
        for value in values:
            with pytest.raises(OptionError, match=f"Camera: {name}: "):
                Camera(**{name: value})  # type: ignore[arg-type]
    camera = Camera([600.0, 600.0], [640.0, 480.0], [-0.1], [1280, 960])  # type: ignore[arg-type]
    assert camera == Camera((600.0, 600.0), (640.0, 480.0), (-0.1,), (1280, 960))
    assert len({camera}) == 1
    for wrong in ([640.0, 480.0], [[640.0, 480.0, 1.0]]):
        with pytest.raises(GraphError, match=r"expected \(n, 2\)"):
            camera.ray(wrong)


AHEAD = np.array([0.0, 0.0, 1.0])


def test_cases() -> None:
    """Sonars, ranges, depths on a ray ahead, and whether the ray passes or meets behind the camera."""
    for s, r, depth, missed, behind in (
        ([0, 0, 0], 4, [4], False, False),  # sonar at the camera: d = r
        ([0, 3, 0], 5, [4], False, False),  # beside it
        ([0, 0, -1], 4, [3], False, False),  # behind it
        ([0, 0, 1], 4, [5], False, False),  # ahead, the camera inside of the sphere: -3 is behind
        ([0, 3, 8], 5, [12, 4], False, False),  # in and out
        ([0, 3, -8], 5, [], False, True),  # in and out, both behind
        ([0, 3, 8], 2, [], True, False),  # passes
        ([0, 3, -8], 2, [], True, False),  # passes, behind
        ([0, 3, 8], 3, [8], False, False),  # touches
        ([0, 0, 5], 5, [10], False, False),  # the camera on the sphere, which is ahead
        ([0, 0, -5], 5, [], False, True),  # on the sphere, which is behind
        ([0, 0, 5], 0, [5], False, False),  # range 0: the sonar itself
    ):
        found = ray_range([AHEAD], s, [float(r)])
        assert found.roots.tolist() == [len(depth)], (s, r)
        expected = np.array([*depth, np.nan, np.nan])[:2, None]
        assert found.depth == pytest.approx(expected, nan_ok=True)
        assert found.points == pytest.approx(expected[..., None] * AHEAD, nan_ok=True)
        assert (found.missed.item(), found.behind.item()) == (missed, behind), (s, r)
        assert found.closest == pytest.approx([s[2]])
        assert found.discriminant == pytest.approx([s[2] ** 2 - np.dot(s, s) + r * r])


def drawn(n: int, seed: int) -> tuple[Array, Array, Array]:
    """Bearings, sonars and ranges of which every case is frequent."""
    rng = np.random.default_rng(seed)
    b = rng.normal(size=(n, 3))
    return b / np.linalg.norm(b, axis=1, keepdims=True), 2 * rng.normal(size=(n, 3)), rng.uniform(0.1, 5, n)


def test_derivatives_against_central_differences() -> None:
    def at(b: Array, s: Array, r: Array) -> Array:
        return ray_range(b / np.linalg.norm(b, axis=1, keepdims=True), s, r).points[int(near)]

    for near in (False, True):
        b, s, r = drawn(2000, 2)
        found = ray_range(b, s, r)
        keep = (found.roots > near) & (found.discriminant > 0.05)
        b, s, r = b[keep], s[keep], r[keep]
        assert len(r) > 100
        p_b, p_r, p_s = ray_range(b, s, r).jacobians(near)
        h = 1e-6
        assert p_r[..., 0] == pytest.approx((at(b, s, r + h) - at(b, s, r - h)) / (2 * h), abs=1e-6)
        assert p_s == pytest.approx(difference(lambda s, b=b, r=r: at(b, s, r), s), abs=1e-6)
        for k, e in enumerate(np.eye(3)):
            across = e - b * b[:, [k]]  # a bearing moves across itself
            moved = (at(b + h * across, s, r) - at(b - h * across, s, r)) / (2 * h)
            assert np.matvec(p_b, across) == pytest.approx(moved, abs=1e-6)


def test_no_derivative_where_there_is_no_point_or_the_ray_touches() -> None:
    zero = np.zeros((2, 3, 2))
    for s, r, near in (([0.0, 3, 8], 2.0, False), ([0, 3, 8], 3.0, False), ([0, 3, 0], 5.0, True)):
        found = ray_range([AHEAD, AHEAD], [[0, 3, 8], s], [5.0, r])
        with pytest.raises(SingularGeometryError, match="roots"):
            found.covariance(zero, np.eye(2), 0.1, near=near)


def test_mistakes() -> None:
    b, s, r = [AHEAD, AHEAD], [0.0, 0, 0], [1.0, 2.0]
    for wrong in ((AHEAD, s, r), (b, [0, 0], r), (b, s, [1.0]), (b, s, 1.0), (b, [s, s, s], r), (np.eye(2), s, r)):
        with pytest.raises(GraphError, match=r"expected \(n, 3\), \(3,\) or \(n, 3\), \(n,\)"):
            ray_range(*wrong)
    for wrong, named in (
        (([AHEAD, np.nan * AHEAD], s, r), "b .* nan"),
        ((b, [0, np.inf, 0], r), "s .* inf"),
        ((b, s, [1, np.nan]), "r .* nan"),
        (([AHEAD, 2 * AHEAD], s, r), r"b\[1\] .* 2, expected 1"),
        ((b, s, [1.0, -2.0]), r"r\[1\] is -2 m"),
        ((b, s, ["far", "near"]), "r is not"),
    ):
        with pytest.raises(GraphError, match=named):
            ray_range(*wrong)
    assert ray_range(np.zeros((0, 3)), s, []).points.shape == (2, 0, 3)
