"""Harbors: points lie on what is there, dead reckoning errs as stated, and a small one closes."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import numpy.typing as npt
import pytest

import sim
from models import SE2
from models.algebra import wrap
from models.errors import GraphError
from nls.missions.folder.table import csv_text
from nls.missions.scans import close, dead_reckoning
from nls.missions.scans.scans import in_world
from sim.files import harbor_files

Array = npt.NDArray[np.float64]
GEOMETRIES = ("marina", "quay", "rocks")


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
