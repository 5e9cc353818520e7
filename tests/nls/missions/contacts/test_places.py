"""Where targets may be: arcs that reproduce what was measured, spreads against samples, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Bearing, Covariance, Diagonal, Isotropic, Landmark, RangeAzimuth
from models import SE2, SE3, R, euler
from models.errors import GraphError, OptionError
from nls import Values, kinds
from nls.missions.contacts.places import POINTS, Pings
from tests.nls.missions.contacts.scenes import floor, in_plane

x, l, o = kinds("x", "l", "o")
OFFSET = euler.to_se3([0.1, -0.6, 0.2, 0.3, 0.0, 0.1])
APERTURE = 0.3


def contacts() -> tuple[RangeAzimuth, Values]:
    """Five contacts of three poses, neither dense nor in order, with correlated noise."""
    rng = np.random.default_rng(2)
    pose = x[[7, -2, 7, 40, -2]]
    z = np.column_stack([rng.uniform(1, 6, 5), rng.uniform(-0.3, 0.3, 5)])
    values = Values({x: (SE3, euler.to_se3(0.3 * rng.normal(size=(4, 6))), [40, 7, 3, -2])})
    return RangeAzimuth(pose, l[[9, 9, 9, 9, 9]], z, Covariance([[4e-4, 6e-5], [6e-5, 1e-4]]), OFFSET), values


def test_pings_are_the_poses_in_the_order_of_their_numbers() -> None:
    sightings, values = contacts()
    pings = Pings.of(sightings, values, l, APERTURE)
    assert (pings.poses.numbers.tolist(), pings.ping.tolist()) == ([-2, 7, 40], [1, 0, 1, 2, 0])
    assert pings.row.tolist() == [3, 1, 0]
    S = SE3.compose(values[x[[7, -2, 7, 40, -2]]], OFFSET)
    np.testing.assert_allclose(pings.sensors(values), S)


def test_every_point_of_an_arc_would_be_measured_so() -> None:
    """Within the aperture from edge to edge, evenly; the middle at elevation 0."""
    sightings, values = contacts()
    pings = Pings.of(sightings, values, l, APERTURE)
    p = pings.points
    assert p.shape == (5, POINTS, 3)
    z = np.asarray(sightings.z)
    np.testing.assert_allclose(np.linalg.norm(p, axis=2), np.tile(z[:, :1], POINTS))
    np.testing.assert_allclose(np.arctan2(p[..., 1], p[..., 0]), np.tile(z[:, 1:], POINTS))
    elevation = np.arctan2(p[..., 2], np.hypot(p[..., 0], p[..., 1]))
    np.testing.assert_allclose(
        np.sort(elevation, axis=1), np.tile(np.linspace(-0.15, 0.15, POINTS), (5, 1)), atol=1e-12
    )
    np.testing.assert_allclose(pings.middle[:, 2], 0, atol=1e-12)
    np.testing.assert_allclose(pings.extent, 2 * z[:, 0] * np.sin(APERTURE / 4))
    points = SE3.act(pings.sensors(values), p[:, -1])
    residual = pings.model(np.arange(5)).linearize(values[sightings.keys[0]], points)[1]
    np.testing.assert_allclose(residual, 0, atol=1e-9)


def test_the_spread_of_points_against_samples() -> None:
    sightings, values = contacts()
    n, rng = 40_000, np.random.default_rng(0)
    pings = Pings.of(sightings, values, l, APERTURE)
    noise = rng.multivariate_normal(np.zeros(2), [[4e-4, 6e-5], [6e-5, 1e-4]], n)
    for k in (0, 3):
        sampled, C = np.cov(pings._located(sightings.z[k] + noise)[:, POINTS // 2].T), pings.covariances[k]
        np.testing.assert_allclose(sampled, C, atol=0.03 * np.trace(C))
        assert np.linalg.eigvalsh(C)[0] < 1e-6 * np.trace(C)  # nothing along the arc: its points stand for that


def test_a_sighting_that_locates_its_target_has_one_point() -> None:
    scene = in_plane()
    pings = scene.pings
    assert (pings.points.shape[1:], float(pings.extent.max()), pings.limit) == ((1, 2), 0.0, 0.0)
    points = SE2.act(pings.sensors(scene.at_the_truth()), pings.middle)
    assert np.linalg.norm(points - scene.truth[l[scene.true]], axis=1).max() < 0.8  # 4 sigma of the range
    bearing, far = scene.sightings.z[5]
    J = np.array([[-far * np.sin(bearing), np.cos(bearing)], [far * np.cos(bearing), np.sin(bearing)]])
    expected = J @ np.diag([np.radians(0.2) ** 2, 0.2**2]) @ J.T
    np.testing.assert_allclose(pings.covariances[5], expected, atol=1e-5 * np.trace(expected))


def test_the_aperture_counts_once_a_landmark_at_its_middle_sighting() -> None:
    scene = floor()
    measured = scene.pings.of_landmarks(scene.true)
    factor = scene.pings.aperture_factor(measured, times=2.0)
    assert np.array_equal(np.sort(factor.keys[1].numbers), np.unique(scene.true))
    for pose, landmark in zip(*(keys.numbers for keys in factor.keys), strict=True):
        views = np.sort(measured.keys[0].numbers[scene.true == landmark])
        assert pose == views[(len(views) - 1) // 2]
    assert scene.aperture is not None
    sigma = 2 * scene.aperture / np.sqrt(12)  # twice that of an even spread
    raised = scene.truth.replaced({"l": scene.truth[l] + np.array([0, 0, 0.1])})
    model, names = factor.bind(SE3, R(3)), factor.keys
    b = model.linearize(raised[names[0]], raised[names[1]])[1]
    S = SE3.compose(raised[names[0]], scene.sightings.offset)
    p = SE3.act(SE3.inverse(S), raised[names[1]])
    np.testing.assert_allclose(np.abs(b[:, 0]) * sigma, np.abs(np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1]))))


def test_what_cannot_be_associated_is_refused() -> None:
    sightings, values = contacts()
    pose, z, noise = sightings.keys[0], sightings.z, Isotropic(0.1)
    other = Values.of([*values.stacks.values()])
    other.add(l, R(3), np.zeros((1, 3)), [9])
    points = Values({x: (R(3), np.zeros((2, 3)))})
    cases = [
        (sightings.mounted(o[[0, 0, 0, 0, 0]]), values, "offset that is a variable"),
        (sightings, other, "kind 'l' has values already"),
        (Bearing(pose, l[[9, 9, 9, 9, 9]], np.ones((5, 2)), noise), values, "leaves more free than an elevation"),
        (sightings[[]], values, "expected sightings"),
        (sightings.z, values, "expected sightings"),
        (Landmark(x[0], l[0], np.ones(3), noise), points, r"x0 is in R\(3\), expected a pose"),
        (RangeAzimuth(x[5], l[0], z[:1], Diagonal([0.1, 0.1])), values, "x5"),
    ]
    for wrong, given, message in cases:
        with pytest.raises(GraphError, match=message):
            Pings.of(wrong, given, l, APERTURE)  # type: ignore[arg-type]
    for aperture in (None, 0.0, 3.2, "wide"):
        with pytest.raises(OptionError, match="aperture"):
            Pings.of(sightings, values, l, aperture)  # type: ignore[arg-type]
