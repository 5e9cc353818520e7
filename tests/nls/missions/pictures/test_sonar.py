"""Sonar pictures: every cell where its range and azimuth put it, arcs through landmarks, corners of the frustum."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection

import sim
from models import SE3
from models.errors import GraphError
from models.sensors import DIDSON_HIGH, DIDSON_LOW, cartesian, plane_projection, range_azimuth
from nls import kinds
from nls.missions.pictures.sonar import arcs, fan_image, polar_image
from nls.plot import frustum

x, l = kinds("x", "l")
SONAR = replace(DIDSON_LOW, bins=64, window=(2.0, 6.0))


@pytest.fixture(scope="module")
def mission() -> sim.Mission:
    return sim.hauv_floor(np.random.default_rng(1), passes=1)


@pytest.fixture
def image() -> np.ndarray:
    return np.random.default_rng(0).random((48, 64))


def test_polar_image_has_beams_across_and_ranges_upwards(image: np.ndarray) -> None:
    left, right = (figure := Figure()).subplots(1, 2)
    assert polar_image(image, SONAR, left) is fan_image(image, SONAR, right) is figure  # axes may be given
    assert [axes.get_ylabel() for axes in figure.axes[2:]] == 2 * ["dB below the strongest echo"]
    (shown,) = polar_image(image, SONAR).axes[0].images
    np.testing.assert_allclose(shown.get_array(), 20 * np.log10((image / image.max()).clip(0.01)).T)
    assert shown.get_extent() == pytest.approx([-14.4, 14.4, 2.0, 6.0])
    assert shown.origin == "lower"


def test_fan_image_puts_cells_where_they_are(image: np.ndarray) -> None:
    """The middle of the four corners of a cell is where a contact of that beam and bin lies, within half of a cell."""
    (mesh,) = fan_image(image, SONAR).axes[0].collections
    C = mesh.get_coordinates()
    r, azimuth = 2.0 + (np.arange(64) + 0.5) * 4 / 64, ((np.arange(48) + 0.5) / 48 - 0.5)[:, None] * SONAR.fan
    middle = (C[1:, 1:] + C[1:, :-1] + C[:-1, 1:] + C[:-1, :-1]) / 4
    np.testing.assert_allclose(middle, np.stack([r * np.sin(azimuth), r * np.cos(azimuth)], axis=-1), atol=1e-3)
    np.testing.assert_allclose(mesh.get_array().reshape(48, 64), 20 * np.log10((image / image.max()).clip(0.01)))
    (dark,) = fan_image(np.zeros((48, 64)), SONAR).axes[0].collections
    assert set(np.asarray(dark.get_array()).ravel().round(9)) == {-40.0}


def test_arcs_pass_through_their_landmarks() -> None:
    """Without noise, at the truth: landmarks lie on the contacts, and every arc comes within a millimeter of one."""
    mission, pose = sim.hauv_hull(np.random.default_rng(1), passes=1, noise_scale=0.0), 100
    axes = arcs(mission.contacts, mission.truth, x[pose], mission.sonar).axes[0]
    contact, landmark = (np.column_stack(line.get_data()) for line in axes.lines)
    np.testing.assert_allclose(landmark, contact, atol=1e-9)
    z = mission.contacts.z[mission.contacts.keys[0].numbers == pose]
    np.testing.assert_allclose(contact, np.column_stack([z[:, 0] * np.sin(z[:, 1]), z[:, 0] * np.cos(z[:, 1])]))
    segments = axes.collections[0].get_segments()
    assert 0 < len(segments) <= len(contact)
    for arc in segments:
        steps = np.diff(arc, axis=0)
        u = np.einsum("mkd,kd->mk", landmark[:, None] - arc[None, :-1], steps) / (steps**2).sum(axis=1).clip(1e-30)
        foot = arc[:-1] + u.clip(0, 1)[..., None] * steps
        assert np.linalg.norm(landmark[:, None] - foot, axis=2).min() < 1e-3


def test_an_arc_is_that_of_the_farthest_contact(mission: sim.Mission) -> None:
    of, target = (k.numbers for k in mission.contacts.keys)
    here = target[of == 40]
    segments = arcs(mission.contacts, mission.truth, x[40], mission.sonar).axes[0].collections[0].get_segments()
    S = SE3.compose(mission.truth[x], mission.offset[None])
    away = np.linalg.norm(S[of, :3] - S[40, :3], axis=1)
    expected = []
    for k in here:
        far = np.flatnonzero(target == k)[np.argmax(away[target == k])]
        if away[far] > 0:
            h = np.column_stack([np.tile(mission.contacts.z[far], (2, 1)), radians(7) * np.array([-1, 1])])
            ends = SE3.act(SE3.inverse(S[40][None]), SE3.act(S[[of[far]]], cartesian(h)[0]))
            expected.append(plane_projection(ends)[:, ::-1])
    np.testing.assert_allclose([arc[[0, -1]] for arc in segments], expected, atol=1e-9)


def test_an_inset_shows_the_longest_arc_with_its_contact(mission: sim.Mission) -> None:
    axes = arcs(mission.contacts, mission.truth, x[40], mission.sonar).axes[0]
    segments = axes.collections[0].get_segments()
    longest = max(segments, key=lambda arc: np.linalg.norm(np.diff(arc, axis=0), axis=1).sum())
    (inset,) = axes.child_axes
    (arc,) = inset.collections[0].get_segments()
    assert np.array_equal(arc, longest)
    measured, estimate = (np.column_stack(line.get_data()) for line in inset.lines)
    (which,) = np.flatnonzero((np.column_stack(axes.lines[0].get_data()) == measured).all(axis=1))
    here = mission.contacts.keys[1].numbers[mission.contacts.keys[0].numbers == 40]
    assert inset.get_title().startswith(f"l{here[which]}, seen from x")
    assert np.linalg.norm(longest - measured, axis=1).min() < 0.1  # both of the same landmark
    for points in (longest, measured, estimate):
        assert all(inset.viewLim.contains(*point) for point in points)
    given = Figure().add_subplot()
    arcs(mission.contacts, mission.truth, x[40], mission.sonar, given)
    assert not given.child_axes  # over an image


def test_mistakes_are_named(mission: sim.Mission, image: np.ndarray) -> None:
    for draw in (polar_image, fan_image):
        with pytest.raises(GraphError, match=r"shape \(64, 48\); DIDSON, low frequency makes \(48, 64\): beams, bins"):
            draw(image.T, SONAR)
    with pytest.raises(GraphError, match="x999 has no contact among"):
        arcs(mission.contacts, mission.truth, x[999], mission.sonar)


HIGH = replace(DIDSON_HIGH, window=(1.0, 6.0))
POSE = SE3.exp(np.array([1.0, 2.0, 3.0, 0.1, -0.3, 0.5]))
POINTS = SE3.act(POSE[None], np.array([[4.0, 0.5, 0.2], [3.0, -0.4, -0.1], [4.0, 3.0, 0.0]]))


def test_frustum_and_arcs() -> None:
    axes = frustum(HIGH, POSE, POINTS).axes[0]
    assert axes.zaxis.get_inverted()
    rims, arcs = (c for c in axes.collections if isinstance(c, Line3DCollection))
    local = [SE3.act(SE3.inverse(POSE[None]), np.array(rim)) for rim in rims._segments3d]
    r = np.linalg.norm(np.concatenate(local[:4]), axis=1)
    np.testing.assert_allclose(r, 6.0)
    far = np.concatenate(local[:4])
    assert np.isclose(np.ptp(range_azimuth(far)[0][:, 1]), HIGH.fan)
    assert np.isclose(2 * np.arcsin(far[:, 2].max() / 6.0), HIGH.aperture)
    for arc, point in zip(arcs._segments3d, POINTS[:2], strict=True):  # the third is beside the fan
        both = SE3.act(SE3.inverse(POSE[None]), np.vstack([arc, point]))
        z, _ = range_azimuth(both)
        np.testing.assert_allclose(z, np.tile(z[-1], (len(z), 1)), atol=1e-12)
        assert np.linalg.norm(np.array(arc) - point, axis=1).min() < 0.03  # and passes through the point
    drawn = {line.get_label(): np.stack(line.get_data_3d(), axis=1) for line in axes.lines}
    np.testing.assert_allclose(drawn["out of view"], POINTS[2:])
    np.testing.assert_allclose(drawn["sonar"], POSE[None, :3])
