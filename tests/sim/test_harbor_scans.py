"""The chain from an image to points has the rates that its options state."""

from __future__ import annotations

import numpy as np
import pytest

from sim import harbor_scans
from sim.harbor_scans import SONAR, drawn, imaged
from sim.harbor_scenes import GEOMETRIES, way
from sim.scene import Scene

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
