"""Pictures of a solved mission: what is drawn is where the numbers say it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection

import nls
from factors import Isotropic, Prior
from models import SE3
from nls.io.mission import MissionReport, elevations, track_of
from nls.plot.mission import landmark_map, track
from tests.nls.mission_files import folder

x, l = nls.kinds("x", "l")
Solved = tuple[nls.FactorGraph, nls.Values, nls.Values, MissionReport]


@pytest.fixture
def solved(tmp_path: Path) -> Solved:
    """Graph, dead reckoning, solution and report of the tiny mission."""
    graph, values, report = nls.load(folder(tmp_path / "m"))
    assert isinstance(report, MissionReport)
    return graph, values, graph.optimize(values).values, report


def test_the_track_from_above(solved: Solved) -> None:
    graph, dead, values, report = solved
    errors = {
        name: track_of(each, report.truth, report, "truth")
        for name, each in (("dead reckoning", dead), ("solution", values))
    }
    above, along = track(values, dead, report.truth, nls.Marginals(graph, values), errors).axes
    drawn = {str(line.get_label()): line.get_xydata() for line in above.lines}
    for name, each in (("dead reckoning", dead), ("truth", report.truth), ("solution", values)):
        assert np.array_equal(drawn[name], SE3.position(each[x])[:, :2])
    assert above.yaxis_inverted()  # seen from above: east to the right of north
    (outlines,) = [each for each in above.collections if isinstance(each, PolyCollection)]
    assert len(outlines.get_paths()) == 4  # of poses, not of landmarks
    legend = above.get_legend()
    assert legend is not None
    assert "ellipse of every x" in legend.get_texts()[-1].get_text()
    for line, name in zip(along.lines, errors, strict=True):
        assert np.array_equal(line.get_xydata(), np.column_stack([errors[name].along, errors[name].error]))
    assert [line.get_label() for line in along.lines] == [f"{name}, against the truth" for name in errors]
    alone = track(values, dead)
    assert [line.get_label() for line in alone.axes[0].lines] == ["dead reckoning", "solution"]
    assert len(alone.axes) == 1


def test_ellipses_are_drawn_large_enough_to_be_seen(solved: Solved) -> None:
    graph, dead, values, _ = solved
    tight = nls.FactorGraph([*graph.factors, Prior(x[0:4], values[x], Isotropic(1e-4))])
    axes = track(values, dead, marginals=nls.Marginals(tight, values)).axes[0]
    legend = axes.get_legend()
    assert legend is not None
    assert legend.get_texts()[-1].get_text().endswith("times as large")


def test_landmarks_and_the_arcs_they_may_be_on(solved: Solved) -> None:
    graph, _, values, report = solved
    found = elevations(graph, values, sigmas=True)
    above, beside, _ = landmark_map(values, found, report.truth).axes
    for axes, rows in ((above, [0, 1]), (beside, [0, 2])):
        (lines,) = [each for each in axes.collections if isinstance(each, LineCollection)]
        segments = np.array(lines.get_segments())
        assert segments.mean(axis=1) == pytest.approx(values[l][:, rows])
        half = (found.range * found.sigma)[:, None] * found.along[:, rows]
        assert segments[:, 1] - segments[:, 0] == pytest.approx(2 * half)
        assert axes.yaxis_inverted()
        (dots,) = [each for each in axes.collections if not isinstance(each, LineCollection)]
        assert np.asarray(dots.get_array()) == pytest.approx(np.degrees(found.sigma))
        assert np.array_equal(axes.lines[0].get_xydata(), report.truth[l][:, rows])

    unknown = landmark_map(values, elevations(graph, values))
    assert len(unknown.axes) == 2  # no scale of colors
    assert not [each for each in unknown.axes[0].collections if isinstance(each, LineCollection)]
