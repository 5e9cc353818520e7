"""Rays in a scene: ranges and incidences by hand, shadows, and the sign of the azimuth."""

from __future__ import annotations

import numpy as np
import pytest

import sim.scene
from models.errors import GraphError, OptionError
from sim.scene import Scene

QUAY = [[[5.0, -10.0], [5.0, 10.0]]]
WINDOW = (0.5, 20.0)


def test_ranges_by_hand() -> None:
    """A wall at x = 5 seen from (1, 2) with yaw 90 deg (ahead is east, +y): 60 deg to port is 30 deg off its normal."""
    scene = Scene(walls=QUAY, piles=[[1.0, 6.0, 1.0]])
    hits = scene.hits([[1.0, 2.0, np.pi / 2]], np.radians([-90, -60, 0, 90]))
    np.testing.assert_allclose(hits.range, [[4.0, 4.0 / np.cos(np.pi / 6), 3.0, np.inf]], atol=1e-12)
    np.testing.assert_allclose(hits.cosine, [[1.0, np.cos(np.pi / 6), 1.0, 0.0]], atol=1e-12)
    assert hits.surface.tolist() == [[0, 0, 1, -1]]


def test_azimuth_is_positive_to_starboard() -> None:
    """East is to starboard of a sonar that looks north."""
    scene = Scene(piles=[[10.0, 3.0, 0.5]])
    ranges = scene.first_hits(np.zeros((1, 3)), [np.arctan2(3, 10), -np.arctan2(3, 10)], WINDOW)
    np.testing.assert_allclose(ranges, [[np.hypot(10, 3) - 0.5, np.inf]])


def test_a_pile_off_the_ray_is_met_where_its_circle_is() -> None:
    scene = Scene(piles=[[4.0, 0.3, 0.5]])
    hits = scene.hits(np.zeros((1, 3)), [0.0])
    assert hits.range[0, 0] == pytest.approx(4 - 0.4)
    assert hits.cosine[0, 0] == pytest.approx(0.8)


def test_near_surfaces_hide_and_far_ones_are_not_met() -> None:
    scene = Scene(walls=[*QUAY, [[0.2, -1.0], [0.2, 1.0]]])
    poses = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-20.0, 0.0, 0.0]]
    np.testing.assert_allclose(scene.first_hits(poses, [0.0], WINDOW), [[np.inf], [4.0], [np.inf]])
    inside = Scene(walls=QUAY, piles=[[0.0, 0.0, 1.0]])
    assert inside.hits(np.zeros((1, 3)), [0.0]).range == 0
    assert np.isinf(inside.first_hits(np.zeros((1, 3)), [0.0], WINDOW)).all()


def test_no_ray_slips_through_a_corner() -> None:
    """Rays from all over to the common end of two walls. With walls of exact length, one in some hundred is lost."""
    corner = np.array([1.1, 0.7])
    scene = Scene(walls=[[corner, [3.3, 5.9]], [[4.7, -2.9], corner]])
    origins = corner - np.random.default_rng(0).uniform(1, 9, (20_000, 2)) * np.array([1, 0.1])
    azimuths = np.arctan2(*(corner - origins)[:, ::-1].T)[:, None]
    assert np.isfinite(scene.hits(np.c_[origins, np.zeros(len(origins))], azimuths).range).all()


def test_rocks_before_a_surface_are_visible() -> None:
    scene = Scene(walls=QUAY, rocks=[[4.9, 1.0], [5.1, 1.0], [-3.0, 0.0]])
    np.testing.assert_allclose(scene.visible_rocks([1.0, 1.0, np.pi / 2]), [[0, -3.9, 0], [-1, 4, 0]], atol=1e-12)


def test_portions_of_rays_and_rows_of_azimuths_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    scene = Scene(rng.uniform(-20, 20, (7, 2, 2)), np.c_[rng.uniform(-20, 20, (5, 2)), rng.uniform(0.2, 1, 5)])
    poses, azimuths = rng.uniform(-5, 5, (6, 3)), np.linspace(-2, 2, 33)
    whole = scene.first_hits(poses, azimuths, WINDOW)
    assert 0.2 < np.isfinite(whole).mean() < 1
    monkeypatch.setattr(sim.scene, "PAIRS", 100)
    np.testing.assert_array_equal(scene.first_hits(poses, np.tile(azimuths, (6, 1)), WINDOW), whole)
    one_by_one = [[scene.first_hits(pose[None], [a], WINDOW)[0, 0] for a in azimuths] for pose in poses]
    np.testing.assert_array_equal(one_by_one, whole)


def test_an_empty_scene_has_no_surface() -> None:
    hits = Scene().hits(np.zeros((2, 3)), np.zeros(4))
    assert np.isinf(hits.range).all()
    assert (hits.surface == -1).all()


def test_mistakes_are_named() -> None:
    for surfaces, match in (
        ({"walls": QUAY[0]}, r"walls of shape \(2, 2\), expected \(n, 2, 2\)"),
        ({"walls": [*QUAY, [[1, 1], [1, 1]]]}, r"walls\[1\] has length 0"),
        ({"piles": [[1, 1, 0]]}, r"piles\[0\] has the radius 0 m"),
        ({"rocks": [[0, 0], [np.nan, 0]]}, r"rocks\[1\] is \[nan, 0.0\]"),
    ):
        with pytest.raises(GraphError, match=match):
            Scene(**surfaces)  # type: ignore[arg-type]
    with pytest.raises(GraphError, match=r"azimuths of shape \(3, 2\), expected \(b,\) or \(1, b\)"):
        Scene().hits(np.zeros((1, 3)), np.zeros((3, 2)))
    with pytest.raises(OptionError, match="window"):
        Scene().first_hits(np.zeros((1, 3)), [0.0], (5.0, 1.0))
