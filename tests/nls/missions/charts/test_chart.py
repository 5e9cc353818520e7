"""What a chart is made of: poses in the order of time, ellipses along the way, the bottom below the vehicle."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE3
from nls import Values, kinds
from nls.missions import MissionReport
from nls.missions.charts import Points, chart_of, depths_text, points_text

x, l = kinds("x", "l")


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
