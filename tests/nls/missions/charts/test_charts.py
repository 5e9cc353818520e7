"""Charts: poses in the order of time, ellipses along the way, the bottom below; the grid of depths; PLY."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from factors import BearingRange, Isotropic, Landmark
from models import SE2, SE3, SO3, R
from models.sensors import point_from_direction_range
from nls import FactorGraph, GraphError, Values, kinds
from nls.missions import MissionReport
from nls.missions.charts import Points, chart_of, depths_text, grid_text, points_text
from sim.landmark_world import LandmarkWorld

x, l, r = kinds("x", "l", "r")


def test_the_bottom_below_the_vehicle() -> None:
    """Depth and height over the bottom are summed, between two poses on the line, and only within the track."""
    X = SE3.identity(3)
    X[:, :3] = [[20, 0, 4], [0, 0, 2], [10, 0, 3]]
    report = MissionReport("deep/dive", "mission", "3-D", "log", vertices_given=False)
    report.vertex_times["x"] = np.array([30.0, 10.0, 20.0])
    report.soundings = np.array([[9.0, 1.0], [10.0, 1.0], [15.0, 7.5], [30.0, 2.0], [31.0, 2.0]])
    chart = chart_of(Values({x: (SE3, X)}), None, report)
    assert (chart.name, chart.track.numbers.tolist(), chart.times.tolist()) == ("dive", [1, 2, 0], [10.0, 20.0, 30.0])
    assert chart.bottom == pytest.approx(np.array([[0, 0, 3], [5, 0, 10], [20, 0, 6]]))
    assert b"comment kind: 0 bottom\n" in points_text(chart)
    cells = set(depths_text(chart).decode().split("-9999.0\n", 1)[1].split())
    assert cells == {"3.0", "10.0", "6.0", "-9999.0"}
    assert not len(chart_of(Values({x: (SE3, X)}), None, MissionReport("m", "mission", "3-D", "log", False)).bottom)


def test_ellipses_are_at_equal_distances() -> None:
    X = SE3.identity(1000)
    X[:, 0] = np.where(np.arange(1000) < 500, 0.001, 1.0).cumsum()  # it waits, then goes
    chart = chart_of(Values({x: (SE3, X)}), None, MissionReport("m", "mission", "3-D", "log", False))
    at = chart.intervals
    assert (len(at), at[-1]) == (60 + (at[0] != 0), 999)
    assert np.diff(chart.way[at]).max() < 1.5 * 500 / 59


def test_what_is_held_or_free_has_no_ellipse() -> None:
    Sigma = np.stack([np.zeros((3, 3)), np.full((3, 3), np.nan), np.diag([4.0, 1.0, 9.0])])
    rows, outline = Points("pose", np.arange(3), np.ones((3, 3)), Sigma).ellipses(np.arange(3))
    assert rows.tolist() == [2]
    assert np.ptp(outline[0], axis=0) / 2 == pytest.approx(np.sqrt(5.991) * np.array([2.0, 1.0]), rel=0.01)


def test_medians_and_corners() -> None:
    rng = np.random.default_rng(0)
    east_north, depth = rng.uniform([-7.3, 500.2], [52.0, 520.0], (400, 2)), rng.uniform(5, 9, 400)
    east_north[:2] = [-7.3, 500.2], [51.9, 519.9]
    head, body = (lines := grid_text(east_north, depth).decode().splitlines())[:6], lines[6:]
    columns, rows, x, y, cell, empty = (float(line.split()[1]) for line in head)
    assert (cell, x, y) == (1.0, -8.0, 500.0)
    grid = np.array([line.split() for line in body], dtype=float)
    assert grid.shape == (rows, columns) == (20, 60)
    for row in range(20):
        for column in range(60):
            low = np.array([x + column, y + 19 - row])
            inside = ((east_north >= low) & (east_north < low + 1)).all(axis=1)
            expected = np.median(depth[inside]) if inside.any() else empty
            assert grid[row, column] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(("longest", "cell"), [(0.0, 0.01), (100.0, 1.0), (101.0, 2.0), (30_000.0, 500.0)])
def test_the_cell_is_a_round_number(longest: float, cell: float) -> None:
    text = grid_text(np.array([[0.0, 0.0], [longest, 0.0]]), np.array([1.0, 2.0])).decode()
    assert f"cellsize {cell!r}\n" in text


def test_points_of_the_plane_and_of_space(tmp_path: Path) -> None:
    values = Values(
        {x: (SE2, [[1, 2, 0.5], [3, 4, 0]], [5, 2**40]), l: (R(2), [[7, 8]], [3]), r: (SO3, SO3.identity())}
    )
    nls.save(tmp_path / "cloud.ply", nls.FactorGraph(), values)
    head, data = (tmp_path / "cloud.ply").read_bytes().split(b"end_header\n")
    rows = np.frombuffer(data, dtype=[("p", "<f8", 3), ("kind", "u1"), ("number", "<i4")])
    assert rows["p"].tolist() == [[1, 2, 0], [3, 4, 0], [7, 8, 0]]
    assert (rows["kind"].tolist(), rows["number"].tolist()) == ([0, 0, 1], [5, -1, 3])
    assert b"element vertex 3\n" in head
    assert b"comment kind: 0 x, 1 l\n" in head
    _, notes = nls.io.rendered("cloud.ply", nls.FactorGraph(), values)
    assert notes == ["a ply file holds positions: 1 variable without left out"]
    with pytest.raises(GraphError, match="a ply file holds poses and points"):
        nls.save(tmp_path / "none.ply", nls.FactorGraph(), Values({r: (SO3, SO3.identity())}))
    X = SE3.exp([[1.0, 2, 3, 0.1, 0, 0]])
    nls.save(tmp_path / "space.ply", nls.FactorGraph(), Values({x: (SE3, X)}))
    assert (tmp_path / "space.ply").read_bytes().endswith(X[0, :3].astype("<f8").tobytes() + b"\0\0\0\0\0")


def charted() -> LandmarkWorld:
    """The world, its landmarks seen as points."""
    world = sim.subsea(np.random.default_rng(3), laps=1)
    (sightings,) = (f for f in world.graph.factors if isinstance(f, BearingRange))
    points = Landmark(*sightings.keys, point_from_direction_range(sightings.z), Isotropic(0.1))
    return replace(world, graph=FactorGraph([*(f for f in world.graph.factors if f is not sightings), points]))
