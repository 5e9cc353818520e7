"""Range, azimuth, elevation, the fan image, imaging sonars as data: numbers by hand, derivatives, what is refused."""

from __future__ import annotations

from dataclasses import replace
from math import atan, cos, pi, radians, sin, sqrt

import numpy as np
import numpy.typing as npt
import pytest

from models import SE3, euler
from models.errors import OptionError
from models.sensors import (
    ARIS_3000,
    BLUEVIEW_M900,
    DIDSON_HIGH,
    DIDSON_LOW,
    OCULUS_M750D,
    ImagingSonar,
    SingularAt,
    cartesian,
    elevation,
    plane_projection,
    range_azimuth,
    spherical,
)

Array = npt.NDArray[np.float64]
same = np.testing.assert_allclose
PRESETS = [DIDSON_HIGH, DIDSON_LOW, ARIS_3000, OCULUS_M750D, BLUEVIEW_M900]


def points(n: int = 200, seed: int = 0) -> Array:
    """All around the sonar."""
    return np.random.default_rng(seed).normal(scale=3.0, size=(n, 3))


def derivative(f: object, X: Array, step: float = 1e-6) -> Array:
    columns = [(f(X + d) - f(X - d)) / (2 * step) for d in step * np.eye(X.shape[1])]  # type: ignore[operator]
    return np.stack(columns, axis=-1)


def test_points_by_hand() -> None:
    """Ahead and below at 3-4-5; to starboard; behind, where atan(y / x) would say ahead; up."""
    p = np.array([[4.0, 0.0, 3.0], [0.0, 2.0, 0.0], [-1.0, -1.0, 0.0], [1.0, 0.0, -1.0]])
    h = [[5.0, 0.0, atan(3 / 4)], [2.0, pi / 2, 0.0], [sqrt(2), -3 * pi / 4, 0.0], [sqrt(2), 0.0, -pi / 4]]
    same(spherical(p)[0], h, atol=1e-15)
    same(range_azimuth(p)[0], np.array(h)[:, :2], atol=1e-15)
    same(elevation(p)[0], np.array(h)[:, 2:], atol=1e-15)
    same(cartesian(np.array(h))[0], p, atol=1e-15)


def test_z_is_the_range_times_the_sine_of_the_elevation() -> None:
    """Of the elevation, not of the azimuth: only then has the point the length r."""
    h = np.random.default_rng(1).uniform([1.0, -3.0, -1.5], [9.0, 3.0, 1.5], size=(100, 3))
    p, _ = cartesian(h)
    same(p[:, 2], h[:, 0] * np.sin(h[:, 2]))
    same(np.linalg.norm(p, axis=1), h[:, 0])
    same(spherical(p)[0], h, atol=1e-12)


def test_derivatives() -> None:
    p = points()
    p = p[np.hypot(p[:, 0], p[:, 1]) > 0.3]
    h, J = spherical(p)
    same(J, derivative(lambda q: spherical(q)[0], p), atol=2e-8)
    same(range_azimuth(p)[1], J[:, :2])
    same(elevation(p)[1], J[:, 2:])
    q, dq = cartesian(h)
    same(q, p, atol=1e-12)
    same(dq, derivative(lambda a: cartesian(a)[0], h), atol=2e-8)
    same(J @ dq, np.broadcast_to(np.eye(3), J.shape), atol=1e-11)
    same(np.linalg.det(dq), h[:, 0] ** 2 * np.cos(h[:, 2]), rtol=1e-9)


def test_the_row_of_the_azimuth_is_divided_by_the_square_of_the_distance_from_the_axis() -> None:
    x, y, z = 3.0, 4.0, 2.0
    same(range_azimuth(np.array([[x, y, z]]))[1][0, 1], np.array([-y, x, 0.0]) / 25.0)


def test_one_view_says_nothing_along_the_arc() -> None:
    """The tangent of the arc is in the null space of the measurement, and of nothing less: two numbers are measured."""
    p = points(seed=2)
    h, _ = spherical(p)
    along = cartesian(h)[1][:, :, 2]
    _, J = range_azimuth(p)
    same((J @ along[..., None])[..., 0], 0.0, atol=1e-12)
    same(np.linalg.norm(along, axis=1), h[:, 0], rtol=1e-9)
    assert (np.linalg.matrix_rank(J) == 2).all()


def test_the_fan_image() -> None:
    """r (cos az, sin az): longer than (x, y) by 1 / cos el; the whole arc is one pixel, up to its ends."""
    p = points(seed=3)
    h, _ = spherical(p)
    image = plane_projection(p)
    same(image, p[:, :2] / np.cos(h[:, 2:]), rtol=1e-9)
    same(np.linalg.norm(image, axis=1), h[:, 0])
    arc, _ = cartesian(
        np.column_stack([np.full(7, 5.0), np.full(7, 0.2), np.linspace(-pi / 2 + 1e-6, pi / 2 - 1e-6, 7)])
    )
    same(plane_projection(arc), np.tile([5 * cos(0.2), 5 * sin(0.2)], (7, 1)), atol=1e-9)


def test_how_much_shorter_the_planar_reading_is() -> None:
    """At an elevation of 7 deg, 5 m away: 0.75 %, 3.7 cm, four range bins of a window of 5 m."""
    (p,), _ = cartesian(np.array([[5.0, 0.0, radians(7)]]))
    short = 5.0 - np.hypot(p[0], p[1])
    assert short == pytest.approx(0.0373, abs=1e-4)
    assert short / (5.0 / 512) == pytest.approx(3.8, abs=0.1)
    assert 5.0 * radians(14) == pytest.approx(1.22, abs=0.01)  # the length of the arc of a DIDSON


@pytest.mark.parametrize("sense", [spherical, range_azimuth, elevation, plane_projection], ids=lambda f: f.__name__)
@pytest.mark.parametrize("bad", [[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [1e-12, 0.0, -3.0]])
def test_no_azimuth_on_the_axis(sense: object, bad: list[float]) -> None:
    with pytest.raises(SingularAt, match=r"z axis of the sensor|\(zero range\)") as caught:
        sense(np.array([[1.0, 2.0, 3.0], bad, bad]))  # type: ignore[operator]
    assert caught.value.index == 1


def test_the_noise_of_a_didson() -> None:
    """0.3 deg / sqrt(12) = 1.51 mrad; 5 m / 512 / sqrt(12) = 2.8 mm; cells of 8 cm and 0.24 cm for 40 and 1.25 m."""
    didson = replace(DIDSON_HIGH, window=(1.0, 6.0))
    assert didson.sigma_azimuth == pytest.approx(radians(0.3) / sqrt(12))
    assert didson.sigma_azimuth == pytest.approx(1.51e-3, abs=5e-6)
    assert didson.sigma_range == pytest.approx(2.82e-3, abs=5e-6)
    same(didson.noise_sigmas, [didson.sigma_range, didson.sigma_azimuth])
    worse = replace(didson, quality=4.0)
    same(worse.noise_sigmas, 4 * didson.noise_sigmas)
    assert replace(DIDSON_LOW, window=(1.0, 41.0)).sigma_range * sqrt(12) == pytest.approx(0.08, abs=2e-3)
    assert replace(DIDSON_HIGH, window=(1.0, 2.25)).sigma_range * sqrt(12) == pytest.approx(0.0024, abs=1e-4)
    assert DIDSON_LOW.fan / DIDSON_LOW.beams == pytest.approx(radians(0.6))


@pytest.mark.parametrize("sonar", PRESETS, ids=lambda s: s.name)
def test_presets_see_what_is_in_their_frustum(sonar: ImagingSonar) -> None:
    near, far = sonar.window
    r, az, el = (near + far) / 2, sonar.fan / 2, sonar.aperture / 2
    inside = np.array([[r, 0, 0], [near + 1e-9, 0, 0], [far - 1e-9, 0, 0], [r, az - 1e-9, 0], [r, 1e-9 - az, 0]])
    inside = np.concatenate([inside, [[r, 0, el - 1e-9], [r, 0, 1e-9 - el], [r, az - 1e-9, el - 1e-9]]])
    outside = np.array([[near - 1e-6, 0, 0], [far + 1e-6, 0, 0], [r, az + 1e-6, 0], [r, -az - 1e-6, 0]])
    outside = np.concatenate([outside, [[r, 0, el + 1e-6], [r, 0, -el - 1e-6], [r, pi - 1e-9, 0]]])
    assert sonar.sees(cartesian(inside)[0]).all()
    assert not sonar.sees(cartesian(outside)[0]).any()
    assert not sonar.sees(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, r]])).any()  # no azimuth, and no error either


def test_a_point_at_an_azimuth_beyond_90_deg_is_behind() -> None:
    """The mirror image of a point in sight: same y / x, other side."""
    (p,), _ = cartesian(np.array([[5.0, 0.1, 0.05]]))
    assert DIDSON_HIGH.sees(np.array([p, -p, [-p[0], p[1], p[2]]])).tolist() == [True, False, False]


@pytest.mark.parametrize("sonar", PRESETS, ids=lambda s: s.name)
def test_cells_and_their_centers(sonar: ImagingSonar) -> None:
    rng = np.random.default_rng(5)
    (near, far), half = sonar.window, sonar.fan / 2
    z = np.column_stack([rng.uniform(near, far, 200_000), rng.uniform(-half, half, 200_000)])
    assert set(sonar.beam(z[:, 1])) == set(range(sonar.beams))
    assert set(sonar.bin(z[:, 0])) == set(range(sonar.bins))
    q = sonar.quantized(z)
    off = np.abs(q - z).max(axis=0) / [(far - near) / sonar.bins, sonar.fan / sonar.beams]
    assert (off <= 0.5 + 1e-9).all()
    assert (off > 0.499).all()
    same(np.std(q - z, axis=0), sonar.noise_sigmas, rtol=0.01)
    same(sonar.quantized(q), q, rtol=1e-12)
    assert sonar.beam([-half * 1.001, half * 1.001]).tolist() == [-1, sonar.beams]
    assert sonar.bin([near - 1e-6, far + 1e-6]).tolist() == [-1, sonar.bins]
    assert sonar.beam(-half + 1e-9) == 0
    assert sonar.beam(half - 1e-9) == sonar.beams - 1


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


def test_what_is_not_finite_is_not_in_sight() -> None:
    p = np.array([[np.nan, 0.0, 0.0], [np.inf, 0.0, 0.0], [3.0, -np.inf, np.nan], [3.0, 0.0, 0.0]])
    assert DIDSON_HIGH.sees(p).tolist() == [False, False, False, True]
    assert DIDSON_HIGH.bin([np.nan, -np.inf, np.inf]).tolist() == [-1, -1, DIDSON_HIGH.bins]


@pytest.mark.parametrize("bad", [[0.5, 0.0], [12.0, 0.0], [5.0, 0.3], [5.0, -0.3], [np.nan, 0.0], [5.0, np.nan]])
def test_what_is_outside_has_no_cell(bad: list[float]) -> None:
    with pytest.raises(
        OptionError, match=r"frequency: z\[1\]: \[.*a range from 1 to 11 m and an azimuth within 0.2513 rad"
    ):
        DIDSON_HIGH.quantized(np.array([[5.0, 0.1], bad, bad]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"beams": 0}, "beams: 0 is not possible; expected a whole number of at least 1"),
        ({"beams": 1.5}, "beams: 1.5 is not"),
        ({"beams": True}, "beams: True is not"),
        ({"bins": float("inf")}, "bins: inf is not"),
        ({"bins": -1}, "bins: -1 is not"),
        ({"fan": 28.8}, r"fan: 28.8 is not possible; expected an angle in \(0, 2 pi\], rad"),
        ({"aperture": 14.0}, r"aperture: 14.0 is not possible; expected an angle in \(0, pi\), rad"),
        ({"window": (6.0, 1.0)}, r"window: \(6.0, 1.0\) is not possible; expected nearest and farthest"),
        ({"window": (0.0, 1.0)}, "0 < nearest < farthest"),
        ({"window": (1.0, float("nan"))}, "window"),
        ({"window": None}, "window: None is not possible; expected nearest and farthest"),
        ({"window": (1, 2, 3)}, r"window: \(1, 2, 3\) is not"),
        ({"window": ("a", "b")}, r"window: \('a', 'b'\) is not"),
        ({"fan": "wide"}, "fan: 'wide' is not"),
        ({"aperture": None}, "aperture: None is not"),
        ({"quality": 0.0}, "quality: 0.0 is not possible; expected a number above 0"),
        ({"quality": np.array([1.0, 2.0])}, "quality: array"),
    ],
)
def test_no_such_sonar(change: dict[str, object], message: str) -> None:
    with pytest.raises(OptionError, match=f"ImagingSonar DIDSON, high frequency: .*{message}"):
        replace(DIDSON_HIGH, **change)  # type: ignore[arg-type]


def test_polar_noise_is_not_noise_in_x_and_y() -> None:
    """The mean of contacts in x and y is nearer than the target by exp(-sigma^2 / 2); that of (r, az) is not."""
    rng, sigma = np.random.default_rng(6), radians(10)
    z = np.column_stack([np.full(100_000, 5.0), rng.normal(0.3, sigma, 100_000)])
    image = plane_projection(cartesian(np.column_stack([z, np.zeros(len(z))]))[0])
    assert np.linalg.norm(image.mean(axis=0)) == pytest.approx(5.0 * np.exp(-(sigma**2) / 2), abs=2e-3)
    assert np.linalg.norm(image.mean(axis=0)) < 4.93
    same(z.mean(axis=0), [5.0, 0.3], atol=3e-3)


def test_the_side_of_a_positive_elevation_is_below() -> None:
    """A level vehicle, z down, sonar as it is: what is deeper than the sonar has a positive elevation."""
    X = euler.to_se3(np.array([[0.0, 0.0, 1.0, 7.0, 8.0, 10.0]]))
    below = SE3.position(X) + np.array([[np.cos(1.0), np.sin(1.0), 0.1]])
    h, _ = spherical(SE3.act(SE3.inverse(X), below))
    assert h[0, 2] > 0
    same(h[0, :2], [np.sqrt(1.01), 0.0], atol=1e-12)
