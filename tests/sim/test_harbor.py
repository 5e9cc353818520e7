"""Harbors: rays in their scenes, images with the stated rates, dead reckoning that errs as stated."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import numpy.typing as npt
import pytest

import sim
import sim.scene
from models import SE2
from models.algebra import wrap
from models.errors import GraphError, OptionError
from nls.missions.folder.table import csv_text
from nls.missions.scans import close, dead_reckoning
from nls.missions.scans.scans import in_world
from sim import harbor_scans
from sim.files import harbor_files
from sim.harbor_scans import SONAR, drawn, imaged
from sim.harbor_scenes import GEOMETRIES, way
from sim.scene import Scene

Array = npt.NDArray[np.float64]


def made(geometry: str = "marina", seed: int = 0, **options: object) -> sim.Harbor:
    return sim.harbor(np.random.default_rng(seed), geometry, **{"keyframes": 80, **options})  # type: ignore[arg-type]


def distances(scene: sim.Scene, p: Array) -> Array:
    """Of points (n, 2) from the nearest wall, pile or rock, m."""
    a, e = scene.walls[:, 0], scene.walls[:, 1] - scene.walls[:, 0]
    share = np.clip(((p[:, None] - a) * e).sum(axis=2) / (e**2).sum(axis=1), 0, 1)
    walls = np.linalg.norm(p[:, None] - a - share[..., None] * e, axis=2)
    piles = np.abs(np.linalg.norm(p[:, None] - scene.piles[:, :2], axis=2) - scene.piles[:, 2])
    return np.concatenate([walls, piles, np.linalg.norm(p[:, None] - scene.rocks, axis=2)], axis=1).min(axis=1)


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_points_lie_on_surfaces_within_their_noise(geometry: str) -> None:
    world = made(geometry, false_alarms=1e-9)
    r = np.linalg.norm(world.scans.points, axis=1)
    away = distances(world.scene, in_world(world.truth, world.scans))
    assert len(r) > 1000
    assert (away < 4.5 * np.hypot(0.1, np.radians(0.34) * r)).all()


def test_false_alarms_have_their_rate() -> None:
    world = made("quay", false_alarms=1e-4)
    false = distances(world.scene, in_world(world.truth, world.scans)) > 2.0
    sonar = world.sonar
    expected = 1e-4 * sonar.beams * sonar.bins * len(world.truth)
    assert 0.9 * expected < false.sum() < expected  # a few lie on the quay, a few in one square


def test_dead_reckoning_errs_as_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    scans = made("quay").scans  # which dead reckoning does not need
    monkeypatch.setattr(import_module("sim.worlds.harbor"), "drawn", lambda *_: scans)
    shares, turns, headings = [], [], []
    for seed in range(60):
        world = made("quay", seed, keyframes=80)
        true, z = (SE2.between(X[:-1], X[1:]) for X in (world.truth, world.poses))
        e = wrap(world.poses[:, 2] - world.truth[:, 2])
        assert np.allclose(e[0], 0.0)
        assert np.allclose(world.poses[0], world.truth[0])
        shares.append(((z - true)[:, :2] / np.linalg.norm(z[:, :2], axis=1)[:, None]).mean(axis=0))
        turns.append(np.diff(e))
        headings.append(e[-1])
    drift = world.drift
    expected = np.hypot(drift.mean, drift.stretch / np.sqrt(8))
    assert np.std(shares) == pytest.approx(expected, rel=0.2)
    assert np.std(turns) == pytest.approx(drift.yaw, rel=0.05)
    assert np.std(headings) == pytest.approx(drift.heading, rel=0.3)


def test_files_have_azimuths_to_port_and_yaw_counterclockwise() -> None:
    world = made("rocks")
    files, _ = harbor_files(world)
    table = {
        name: np.loadtxt(files[name].decode().splitlines(), delimiter=",", skiprows=1)
        for name in ("keyframes.csv", "scans.csv", "truth.csv")
    }
    assert files["scans.csv"].startswith(csv_text(["keyframe", "range", "azimuth", "intensity"]).split(b"\n")[0])
    k, r, azimuth, _ = table["scans.csv"].T
    X = table["truth.csv"][k.astype(int), 1:]
    west = X[:, :2] + r[:, None] * np.column_stack([np.cos(X[:, 2] + azimuth), np.sin(X[:, 2] + azimuth)])
    assert west * [1.0, -1.0] == pytest.approx(in_world(world.truth, world.scans), abs=1e-9)
    assert table["keyframes.csv"][:, 2:] * [1.0, -1.0, -1.0] == pytest.approx(world.poses)


def test_a_small_harbor_closes() -> None:
    world = made("rocks", seed=1, keyframes=100)
    closing = close(*dead_reckoning(world.poses), world.scans, rounds=3)
    m = closing.matches
    e = world.errors(m.i, m.j, m.pose)[m.kept]
    assert m.kept.sum() > 20
    assert (np.hypot(e[:, 0], e[:, 1]) < 3.0).all()
    assert world.ate(closing.rounds[-1].poses) < 0.7 < 2.0 < world.ate(world.poses)


def test_a_keyframe_that_is_not_there() -> None:
    with pytest.raises(GraphError, match="0 to 79"):
        made().errors(np.array([0]), np.array([80]), np.zeros((1, 3)))


EMPTY = Scene(walls=np.zeros((0, 2, 2)), piles=np.zeros((0, 3)))
POSES = np.zeros((2, 3))
CELLS = SONAR.beams * SONAR.bins


@pytest.mark.parametrize("scans", [drawn, imaged])
@pytest.mark.parametrize("signal", [10.0, 20.0])
def test_false_alarms_in_open_water(scans: object, signal: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(harbor_scans, "THIN", 1e-3)  # no cell shares its square
    made = scans(np.random.default_rng(0), EMPTY, POSES, SONAR, signal, 1e-3)  # type: ignore[operator]
    assert len(made.points) / (len(POSES) * CELLS) == pytest.approx(1e-3, rel=0.15)


def test_false_alarms_behind_surfaces_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall all around, 20 m away: three fifths of the image are shadow."""
    monkeypatch.setattr(harbor_scans, "THIN", 1e-3)
    corners = 20.0 * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    basin = Scene(walls=np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))
    points = imaged(np.random.default_rng(0), basin, POSES, SONAR, 20.0, 1e-3).points
    range_ = np.hypot(*points.T)
    near, far = SONAR.window
    for low, high in ((near + 1.0, 18.0), (30.0, far - 1.0)):
        count = ((range_ > low) & (range_ < high)).sum()
        cells = len(POSES) * CELLS * (high - low) / (far - near)
        assert count / cells == pytest.approx(1e-3, rel=0.15)


@pytest.mark.parametrize("geometry", ["marina", "rocks"])
def test_a_long_way_is_drawn_in_blocks(geometry: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory does not grow with the keyframes, and the points do not depend on the blocks."""
    rng = np.random.default_rng(0)
    scene, poses = GEOMETRIES[geometry](rng, 50.0, 50.0), way(rng, 50, 50.0)
    at_once: list[int] = []
    hits = Scene.hits
    monkeypatch.setattr(Scene, "hits", lambda scene, p, az: (at_once.append(len(p)), hits(scene, p, az))[1])
    made = []
    for block in (7, 50):
        monkeypatch.setattr(harbor_scans, "BLOCK", block)
        made.append(drawn(np.random.default_rng(1), scene, poses, SONAR, 20.0, 1e-5))
        assert max(at_once) == block
    np.testing.assert_array_equal(made[0].points, made[1].points)
    np.testing.assert_array_equal(made[0].keyframe, made[1].keyframe)
    assert made[0].with_points.sum() > 40


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
