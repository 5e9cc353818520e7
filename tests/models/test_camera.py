"""The camera: images and their derivatives by hand, rays back from every pixel, what has no image and what no ray."""

from __future__ import annotations

from collections.abc import Callable
from math import atan, pi, tan

import numpy as np
import numpy.typing as npt
import pytest

from models.errors import GraphError, OptionError, SingularGeometryError
from models.sensors import Camera, SingularAt

Array = npt.NDArray[np.float64]
same = np.testing.assert_allclose
WIDE = (-0.28, 0.07, 0.0005, -0.0003)  # k1 k2 p1 p2: about that of a wide-angle camera behind a flat port
LENSES = [(), (-0.05,), WIDE, (0.1, -0.02, 0.001, 0.002, 0.005), (0.3, 0.1), (-0.3, 0.1, 1e-3, -2e-3, -0.01)]
every_lens = pytest.mark.parametrize("distortion", LENSES, ids=str)


def camera_with(distortion: tuple[float, ...]) -> Camera:
    return Camera((600.0, 610.0), (630.0, 485.0), distortion, (1280, 960))


def pixels(camera: Camera, across: int = 65, down: int = 49) -> Array:
    """A grid over the whole image, its edges and corners included."""
    assert camera.size is not None
    u, v = np.meshgrid(np.linspace(0, camera.size[0], across), np.linspace(0, camera.size[1], down))
    return np.column_stack([u.ravel(), v.ravel()])


def scattered(n: int, seed: int, wide: float = 0.8) -> Array:
    """Points in front, at different depths."""
    rng = np.random.default_rng(seed)
    m = rng.uniform(-wide, wide, size=(n, 2))
    return np.column_stack([m, np.ones(n)]) * rng.uniform(0.5, 20.0, size=(n, 1))


def difference(f: Callable[[Array], Array], x: Array, step: float) -> Array:
    """Central differences (n, size, k) of f at x (n, k)."""
    columns = [(f(x + step * e) - f(x - step * e)) / (2 * step) for e in np.eye(x.shape[1])]
    return np.stack(columns, axis=-1)


def test_images_by_hand() -> None:
    p = np.array([[1.0, -2.0, 4.0], [0.0, 0.0, 0.5]])
    h, J = Camera().project(p)
    same(h, [[0.25, -0.5], [0.0, 0.0]])
    same(J, [[[1 / 4, 0, -1 / 16], [0, 1 / 4, 2 / 16]], [[2, 0, 0], [0, 2, 0]]])
    same(Camera((600.0, 500.0), (640.0, 480.0)).project(p)[0], [[790.0, 230.0], [640.0, 480.0]])


def test_every_coefficient_of_the_distortion_by_hand() -> None:
    """At (x, y) = (1/2, 1): r^2 = 5/4. One coefficient at a time, in the order k1 k2 p1 p2 k3."""
    p = np.array([[1.0, 2.0, 2.0]])
    moved = [
        (0.5 * 1.25, 1.25),
        (0.5 * 1.25**2, 1.25**2),
        (2 * 0.5, 1.25 + 2),
        (1.25 + 2 * 0.25, 2 * 0.5),
        (0.5 * 1.25**3, 1.25**3),
    ]
    for k, (dx, dy) in enumerate(moved):
        distortion = (*[0.0] * k, 0.01)
        same(Camera(distortion=distortion).project(p)[0], [[0.5 + 0.01 * dx, 1 + 0.01 * dy]], rtol=1e-15)
        assert Camera(distortion=distortion) != Camera()


@every_lens
@pytest.mark.parametrize("n", [1, 40])
def test_derivative_of_the_image(distortion: tuple[float, ...], n: int) -> None:
    camera, p = camera_with(distortion), scattered(n, 1)
    h, J = camera.project(p)
    assert (h.shape, J.shape) == ((n, 2), (n, 2, 3))
    same(J, difference(lambda q: camera.project(q)[0], p, 1e-6), rtol=1e-6, atol=1e-5)
    same(np.matvec(J, p), 0.0, atol=1e-10)  # along the ray nothing changes


@every_lens
def test_there_and_back_over_the_whole_image(distortion: tuple[float, ...]) -> None:
    camera = camera_with(distortion)
    z = pixels(camera)
    b, J = camera.ray(z)
    same(np.linalg.norm(b, axis=1), 1.0, rtol=1e-14)
    assert (b[:, 2] > 0).all()
    for depth in (0.1, 50.0):
        same(camera.project(depth * b)[0], z, atol=1e-8)
    same(J, difference(lambda y: camera.ray(y)[0], z, 1e-3), atol=1e-10)
    same(np.matvec(J.mT, b), 0.0, atol=1e-15)  # a unit vector turns
    p = scattered(50, 2)
    same(camera.ray(camera.project(p)[0])[0], p / np.linalg.norm(p, axis=1, keepdims=True), atol=1e-11)


def test_the_ray_of_a_pinhole_by_hand() -> None:
    b, J = Camera((100.0, 200.0), (50.0, 60.0)).ray([[50.0, 60.0], [150.0, 60.0]])
    same(b, [[0, 0, 1], [np.sqrt(0.5), 0, np.sqrt(0.5)]], atol=1e-15)
    same(J[0], [[0.01, 0], [0, 0.005], [0, 0]], atol=1e-16)


@pytest.mark.parametrize(
    ("distortion", "reach"),
    [
        ((), np.inf),
        ((0.3,), np.inf),
        ((-0.2,), np.sqrt(1 / 0.6)),  # 1 + 3 k1 s = 0
        ((0.0, -0.1), 2**0.25),  # 1 + 5 k2 s^2 = 0
        ((0.0, 0.0, 0.0, 0.0, -1 / 7), 1.0),  # 1 + 7 k3 s^3 = 0
        ((0.0, 0.0, 0.03, 0.04), 1 / 0.3),  # 1 - 6 |q| sqrt(s) = 0
    ],
)
def test_reach(distortion: tuple[float, ...], reach: float) -> None:
    assert Camera(distortion=distortion).reach == pytest.approx(reach, rel=1e-12)


@pytest.mark.parametrize("distortion", [(-0.2,), (-0.3, 0.1, 1e-3, -2e-3, -0.01), (0.05, -0.1, 0.02, 0.01)], ids=str)
def test_within_reach_no_two_points_share_an_image(distortion: tuple[float, ...]) -> None:
    """The derivative of the distortion is positive definite there, and at its end somewhere singular or not far off."""
    camera = Camera(distortion=distortion)
    angle, part = (a.ravel() for a in np.meshgrid(np.linspace(0, 2 * pi, 181), np.linspace(0.0, 0.999, 100)))
    m = camera.reach * part * np.array([np.cos(angle), np.sin(angle)])
    D = camera.project(np.column_stack([*m, np.ones(len(part))]))[1][:, :, :2]
    same(D, D.mT, atol=1e-12)
    least = np.linalg.eigvalsh(D)[:, 0]
    assert least.min() > 0
    assert least[part > 0.99].min() < 0.05


@pytest.mark.parametrize("distortion", [(-0.2,), (-0.2, 0.0, 0.01, -0.005)], ids=str)
def test_a_pixel_beyond_the_fold_has_no_ray(distortion: tuple[float, ...]) -> None:
    """The image of a barrel distortion ends where it folds: along x at m = reach, for the first at 2/3 of it."""
    camera = camera_with(distortion)
    z = pixels(camera)
    edge = camera.project(np.array([[0.999 * camera.reach * np.cos(a), 0.999 * camera.reach * np.sin(a), 1.0] for a in
                                    np.linspace(0, 2 * pi, 361)]))[0]  # fmt: skip
    radius = np.linalg.norm((edge - camera.center) / camera.focal, axis=1)
    r = np.linalg.norm((z - camera.center) / camera.focal, axis=1)
    inside, outside = r < radius.min(), r > 1.01 * radius.max()
    assert min(inside.sum(), outside.sum()) > 100
    same(camera.project(camera.ray(z[inside])[0])[0], z[inside], atol=1e-8)
    first = int(np.argmax(outside))
    some = np.concatenate([z[inside][:3], z[[first]], z[outside][-1:]])
    limit = np.degrees(np.arctan(camera.reach))
    message = rf"pixel \({z[first, 0]:g}, {z[first, 1]:g}\) has no ray in the distortion .* up to {limit:.3g} deg"
    with pytest.raises(SingularAt, match=message) as caught:
        camera.ray(some)
    assert caught.value.index == 3
    for k in np.flatnonzero(outside)[::97]:
        with pytest.raises(SingularGeometryError, match="has no ray"):
            camera.ray(z[[k]])


@pytest.mark.parametrize("camera", [Camera(), camera_with(WIDE)])
def test_a_pixel_that_is_no_number_has_no_ray(camera: Camera) -> None:
    with pytest.raises(SingularAt, match=r"pixel \(nan, 3\) has no ray at all"):
        camera.ray([[1.0, 2.0], [np.nan, 3.0]])


@pytest.mark.parametrize("p", [[0.5, 0.1, -2.0], [0.5, 0.1, 0.0], [1.0, 1.0, 1e-10], [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
@every_lens
def test_behind_the_camera_there_is_no_image(p: list[float], distortion: tuple[float, ...]) -> None:
    camera = camera_with(distortion)
    with pytest.raises(SingularAt, match=r"the point is behind the camera \(Z <= 0\) and has no image") as caught:
        camera.project(np.array([[0.0, 0.0, 1.0], p, p]))
    assert caught.value.index == 1
    same(camera.sees(np.array([[0.0, 0.0, 1.0], p])), [True, False])


def test_sees() -> None:
    camera = camera_with(())
    b = camera.ray([[0.0, 0.0], [1280.0, 960.0], [640.0, 480.0]])[0]
    same(camera.sees(9 * 0.999999 * b + [[1e-6, 1e-6, 0], [-1e-6, -1e-6, 0], [0, 0, 0]]), True)
    outside = camera.ray([[-0.1, 5.0], [5.0, -0.1], [1280.1, 5.0], [5.0, 960.1]])[0]
    same(camera.sees(outside), False)
    same(Camera(camera.focal, camera.center).sees(outside), True)  # no edges
    same(camera.sees(np.array([[np.nan, 0, 1], [0, np.inf, 1], [0, 0, np.nan], [0.0, 0.0, np.inf]])), False)
    assert camera.sees(np.zeros((0, 3))).shape == (0,)


def test_what_folds_back_into_the_image_is_not_seen() -> None:
    """At 70 deg from the axis this polynomial gives a pixel in the image, which belongs to another ray."""
    camera = camera_with((-0.12,))
    p = np.array([[tan(70 * pi / 180), 0.0, 1.0]])
    assert atan(camera.reach) < 70 * pi / 180
    assert (camera.project(p)[0] > 0).all()
    assert (camera.project(p)[0] < camera.size).all()
    same(camera.sees(p), False)
    same(camera.sees(camera.ray(camera.project(p)[0])[0]), True)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"focal": (600.0, 0.0)}, "focal lengths .fx, fy. above 0"),
        ({"focal": (600.0, -1.0)}, "focal"),
        ({"focal": 600.0}, "focal"),
        ({"focal": (600.0, np.nan)}, "focal"),
        ({"center": (640.0,)}, "principal point"),
        ({"center": (640.0, np.inf)}, "principal point"),
        ({"center": "ab"}, "principal point"),
        ({"distortion": (0.0,) * 6}, "up to five numbers, k1 k2 p1 p2 k3"),
        ({"distortion": 0.1}, "up to five numbers"),
        ({"distortion": (np.nan,)}, "up to five numbers"),
        ({"size": (1280.0, 960.0)}, "whole numbers .width, height. of at least 1"),
        ({"size": (0, 960)}, "whole numbers"),
        ({"size": (1280, 960, 3)}, "whole numbers"),
    ],
)
def test_cameras_that_are_none(options: dict[str, object], said: str) -> None:
    with pytest.raises(OptionError, match=rf"Camera: {next(iter(options))}: .* is not possible; expected .*{said}"):
        Camera(**options)  # type: ignore[arg-type]


def test_a_list_is_a_tuple_and_one_pixel_is_none() -> None:
    camera = Camera([600.0, 600.0], [640.0, 480.0], [-0.1], [1280, 960])  # type: ignore[arg-type]
    assert camera == Camera((600.0, 600.0), (640.0, 480.0), (-0.1,), (1280, 960))
    assert len({camera}) == 1
    for wrong in ([640.0, 480.0], [[640.0, 480.0, 1.0]]):
        with pytest.raises(GraphError, match=r"expected \(n, 2\)"):
            camera.ray(wrong)
