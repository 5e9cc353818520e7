"""Pictures of a solved mission and of a map from scans: what is drawn is where the numbers say."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.tri import TriContourSet
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

import nls
from factors import Diagonal, Isotropic, Prior
from models import SE2, SE3, R
from models.geodesy import LocalPlane
from models.listing import number
from nls.missions import MissionReport, elevations, track_of
from nls.missions.charts.chart import Chart, Points
from nls.missions.pictures.chart import depth_chart
from nls.missions.pictures.mission import landmark_map, plan, plan_before_after, track
from nls.missions.pictures.scan_map import scan_map
from nls.missions.scans import close
from nls.missions.scans.folder import Truth, read_scan_mission
from nls.missions.scans.scans import in_world
from nls.plot.style import CLOSURE, REJECTED
from nls.robust.graduated import Rejected
from tests.nls.missions.folder.mission_files import folder
from tests.nls.missions.scans import room_files

x, l, b = nls.kinds("x", "l", "b")
Solved = tuple[nls.FactorGraph, nls.Values, nls.Values, MissionReport]


VIEWS = ([1, 0], [1, 2])  # from above, east and north; from the side, east and down


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Solved:
    """Graph, dead reckoning, solution and report of the tiny mission."""
    graph, values, report = nls.load(folder(tmp_path_factory.mktemp("tiny")))
    return graph, values, graph.optimize(values).values, report


def test_the_track_from_above(solved: Solved) -> None:
    graph, dead, values, report = solved
    estimates, marginals = {"dead reckoning": dead, "solution": values}, nls.Marginals(graph, values)
    errors = {name: track_of(each, report.truth, report, "truth") for name, each in estimates.items()}
    above, along = track(values, dead, report.truth, marginals, errors).axes
    drawn = {str(line.get_label()): line.get_xydata() for line in above.lines}
    for name, each in (estimates | {"truth": report.truth}).items():
        assert np.array_equal(drawn[name], SE3.position(each[x])[:, [1, 0]])  # a chart: north up, east to the right
    assert not above.yaxis_inverted()
    assert (above.get_xlabel(), above.get_ylabel()) == ("y, east [m]", "x, north [m]")
    (outlines,) = [each for each in above.collections if isinstance(each, PolyCollection)]
    assert len(outlines.get_paths()) == 4  # of poses, not of landmarks
    assert "ellipse of every x" in legend_of(above)[-1]
    title = above.figure.get_suptitle()
    assert title.startswith(f"After {errors['solution'].distance:.3g} m: dead reckoning ")
    assert title.endswith(f", solution {errors['solution'].end:.2g} m from the truth")
    *judged, expected = along.lines
    for line, name in zip(judged, errors, strict=True):
        assert np.array_equal(line.get_xydata(), np.column_stack([errors[name].along, errors[name].error]))
    assert [line.get_label() for line in judged] == [f"{name}, against the truth" for name in errors]
    sigma = np.sqrt([np.trace(marginals.covariance(x[k], frame="world")[:3, :3]) for k in range(4)])
    np.testing.assert_allclose(np.asarray(expected.get_ydata()), sigma, rtol=1e-6)
    assert expected.get_label() == "solution, by its covariance"
    without = track(values, dead, None, marginals)  # no truth: the error to be expected
    (expected,) = without.axes[1].lines
    np.testing.assert_allclose(np.asarray(expected.get_ydata()), sigma, rtol=1e-6)
    way = np.linalg.norm(np.diff(SE3.position(values[x]), axis=0), axis=1).sum()
    assert expected.get_xdata()[-1] == pytest.approx(way)
    assert without.get_suptitle() == f"After {way:.3g} m: the solution is expected to be {sigma[-1]:.2g} m off"
    alone = track(values, dead)
    assert [line.get_label() for line in alone.axes[0].lines] == ["dead reckoning", "solution"]
    assert len(alone.axes) == 1


def legend_of(axes: Axes) -> list[str]:
    (legend,) = axes.figure.legends
    return [text.get_text() for text in legend.get_texts()]


def lines_of(axes: Axes) -> np.ndarray:
    """Ends (n, 2, 2) of the lines that are drawn as one."""
    (lines,) = [each for each in axes.collections if isinstance(each, LineCollection)]
    return np.asarray(lines.get_segments())


def test_ellipses_are_turned_with_the_map(solved: Solved) -> None:
    graph, dead, values, _ = solved
    loose = nls.FactorGraph([*graph.factors[:2], Prior(x[0], values[x[0]], Diagonal([3.0, 1, 1, 1, 1, 1]))])
    marginals = nls.Marginals(loose, nls.Values({x: (SE3, values[x])}))
    (outlines,) = track(values, dead, marginals=marginals).axes[0].collections
    east, north = np.ptp(outlines.get_paths()[0].vertices, axis=0)
    Sigma = marginals.covariance(x[0], view="position")
    assert north / east == pytest.approx(np.sqrt(Sigma[0, 0] / Sigma[1, 1]), rel=1e-2)
    assert north > 1.2 * east


def test_hidden_lines_and_small_ellipses_are_said(solved: Solved) -> None:
    graph, dead, values, _ = solved
    assert legend_of(track(values, dead).axes[0])[0] == "dead reckoning"
    near = values.copy()
    near[x[1]] = SE3.retract(near[x[1]], np.array([1e-4, 0, 0, 0, 0, 0]))
    assert legend_of(track(values, near).axes[0])[0] == "dead reckoning (hidden under the solution)"
    tight = nls.FactorGraph([*graph.factors, Prior(x[0:4], values[x], Isotropic(1e-4))])
    axes = track(values, dead, marginals=nls.Marginals(tight, values)).axes[0]
    assert legend_of(axes)[-1].endswith("times as large")


def test_landmarks_and_the_arcs_they_may_be_on(solved: Solved) -> None:
    graph, _, values, report = solved
    found = elevations(graph, values, sigmas=True)
    above, beside, bar = landmark_map(values, found, report.truth, aperture=0.2443).axes
    assert bar.get_ylim() == pytest.approx((0.0, np.degrees(0.2443 / np.sqrt(12))))  # by the aperture, not by the data
    assert all(float(label.get_text()) >= 0 for label in bar.get_yticklabels())  # plain numbers
    assert beside.yaxis_inverted()
    assert not above.yaxis_inverted()
    for axes, rows in zip((above, beside), VIEWS, strict=True):
        segments = lines_of(axes)
        assert segments.mean(axis=1) == pytest.approx(values[l][:, rows])
        half = (found.range * found.sigma)[:, None] * found.along[:, rows]
        assert segments[:, 1] - segments[:, 0] == pytest.approx(2 * half)
        (dots,) = [each for each in axes.collections if not isinstance(each, LineCollection)]
        assert np.asarray(dots.get_array()) == pytest.approx(np.degrees(found.sigma))
        assert np.array_equal(axes.lines[0].get_xydata(), report.truth[l][:, rows])
        drawn = np.concatenate([segments.reshape(-1, 2), report.truth[l][:, rows], SE3.position(values[x])[:, rows]])
        assert_within(drawn, axes)

    most = landmark_map(values, found).axes[2].get_ylim()[1]
    assert most == pytest.approx(np.degrees(found.sigma.max()))
    unknown = landmark_map(values, elevations(graph, values))
    assert len(unknown.axes) == 2  # no scale of colors
    assert not [each for each in unknown.axes[0].collections if isinstance(each, LineCollection)]


def test_a_mission_as_it_was_read(solved: Solved) -> None:
    """North is up, east to the right, and what is deeper is drawn lower; every contact has its line."""
    graph, dead, _, _ = solved
    above, beside = plan(graph, dead).axes
    assert beside.yaxis_inverted()
    assert not above.yaxis_inverted()
    path, points = SE3.position(dead[x]), dead[l]
    for ax, rows in zip((above, beside), VIEWS, strict=True):
        landmarks, track_line, first = (np.asarray(line.get_xydata()) for line in ax.lines)
        assert np.array_equal(landmarks, points[:, rows])
        assert np.array_equal(track_line, path[:, rows])
        assert np.array_equal(first, path[:1, rows])
        drawn = {tuple(np.round(segment.reshape(-1), 9)) for segment in lines_of(ax)}
        (contacts,) = [factor for factor in graph.factors if factor.name == "RangeAzimuth"]
        pose, landmark = contacts.keys[:2]
        ends = np.column_stack([SE3.position(dead[pose])[:, rows], dead[landmark][:, rows]])
        assert {tuple(np.round(end, 9)) for end in ends} <= drawn
        assert ax.get_aspect() == 1.0
    assert legend_of(above) == [f"{len(points)} landmarks", f"track, {len(path)} poses", "first pose", "lines of sight"]


@pytest.mark.parametrize("factor", [1.0, 100.0])
def test_a_mission_before_and_after(solved: Solved, factor: float) -> None:
    """Dead reckoning lies beside the map of `plan`; where it is far wider, it leaves the map."""
    graph, dead, _, _ = solved
    result, poses = graph.optimize(dead), dead[x].copy()
    poses[:, :3] *= factor
    before = dead.replaced({x: poses})
    contacts = next(factor for factor in graph.factors if factor.name == "RangeAzimuth")
    wrong = Rejected("a contact", 9.0, 0, 0, (contacts.keys[0][[0]], contacts.keys[1][[0]]), 0.0)
    figure = plan_before_after(graph, before, result, "a mission", [wrong])
    assert figure.get_suptitle() == "a mission"
    *panels, curve = figure.axes
    names = ["dead reckoning", "1 measurement rejected, not in chi2"]
    for ax, rows, alone in zip(panels, VIEWS, plan(graph, result.values).axes, strict=True):
        reckoned, red, *solution = ax.lines
        assert [line.get_label() for line in (reckoned, red)] == names
        assert np.array_equal(reckoned.get_xydata(), SE3.position(before[x])[:, rows])
        ends = [SE3.position(result.values[wrong.keys[0]])[0], result.values[wrong.keys[1]][0]]
        assert np.array_equal(np.asarray(red.get_xydata())[:2], np.array(ends)[:, rows])
        for line, expected in zip(solution, alone.lines, strict=True):
            assert np.array_equal(line.get_xydata(), expected.get_xydata())
        assert np.array_equal(lines_of(ax), np.stack([before[l], result.values[l]], axis=1)[:, :, rows])
        assert_within(np.concatenate([np.asarray(line.get_xydata()) for line in solution]), ax)
        size = np.ptp(limits(ax), axis=0) / np.ptp(limits(alone), axis=0)
        assert size.max() < (1.2 if factor == 1 else 3.01)
    chi2 = f"chi2 = {number(graph.chi2(before))} before, {number(result.chi2_final)} after"
    assert panels[0].get_title() == chi2
    assert curve.get_xlabel() == "iteration"
    assert legend_of(panels[0]) == ["landmarks moved", *names, *legend_of(plan(graph, dead).axes[0])[:-1]]


def limits(ax: Axes) -> np.ndarray:
    """The lower left and the upper right corner (2, 2) of a panel, in its units."""
    return np.sort([ax.get_xlim(), ax.get_ylim()], axis=1).T


def assert_within(points: np.ndarray, ax: Axes) -> None:
    """Nothing is cut off."""
    low, high = limits(ax)
    assert ((low < points) & (points < high)).all()


def test_beacons_and_a_mission_without_landmarks(solved: Solved) -> None:
    graph, dead, _, _ = solved
    beacons = np.array([[30.0, -20.0, 5.0], [40.0, 10.0, 6.0]])
    alone = nls.FactorGraph(graph.factors[:2])
    figure = plan(alone, nls.Values.of([dead.stack(x), *nls.Values({b: (R(3), beacons)}).stacks.values()]))
    for ax, rows in zip(figure.axes, VIEWS, strict=True):
        (drawn,) = [line for line in ax.lines if line.get_label() == "2 beacons"]
        assert np.array_equal(drawn.get_xydata(), beacons[:, rows])
        assert_within(beacons[:, rows], ax)
    assert "lines of sight" not in legend_of(figure.axes[0])


def test_what_is_drawn(tmp_path: Path) -> None:
    graph, values, scans, report = read_scan_mission(room_files.write(tmp_path / "m", room_files.room()))
    closing = close(graph, values, scans, rounds=1)
    matches = closing.matches
    matches.kept[np.flatnonzero(matches.kept)[:2]] = False
    elsewhere = SE2.compose(np.repeat([[30.0, -20.0, 2.0]], 90, axis=0), report.truth.poses)
    figure = scan_map(closing.values[x], scans, values[x], matches, Truth(report.truth.rows, elsewhere))
    (axes,) = figure.axes
    lines = {str(line.get_label()): line for line in axes.lines}
    assert [*lines] == ["truth, aligned", "dead reckoning", "solution", "start"]
    assert lines["dead reckoning"].get_linestyle() == "--"
    truth = np.column_stack(lines["truth, aligned"].get_data())
    solution = np.column_stack(lines["solution"].get_data())
    assert 0 < np.linalg.norm(truth - solution, axis=1).max() < 1
    np.testing.assert_allclose(np.diff(truth, axis=0)[:3], np.diff(room_files.track(2)[:4, :2], axis=0), atol=0.05)
    closures = {c.get_label(): c for c in axes.collections if str(c.get_label()).endswith(("kept", "rejected"))}
    rejected = int((matches.accepted & ~matches.kept).sum())
    kept = int(matches.kept.sum())
    assert {*closures} == {f"{rejected} closures rejected", f"{kept} closures kept"}
    for label, color, count in (
        (f"{kept} closures kept", CLOSURE, kept),
        (f"{rejected} closures rejected", REJECTED, rejected),
    ):
        lines_of = closures[label]
        assert len(lines_of.get_paths()) == count
        assert tuple(round(255 * c) for c in lines_of.get_edgecolor()[0][:3]) == tuple(bytes.fromhex(color[1:]))
    assert axes.get_aspect() == 1
    (cells,) = axes.images  # dark where points are, in the world
    shade, (left, right, bottom, top) = np.asarray(cells.get_array()), cells.get_extent()
    points = in_world(closing.values[x], scans)
    rows = ((points - [left, bottom]) / [right - left, top - bottom] * shade.shape[::-1]).astype(int)[:, ::-1]
    inside = ((rows >= 0) & (rows < shade.shape)).all(axis=1)
    assert inside.mean() > 0.9
    assert {*map(tuple, rows[inside])} == {*zip(*(i.tolist() for i in np.nonzero(shade)), strict=True)}
    alone = scan_map(values[x], scans).axes[0]
    assert "90 keyframes" in alone.get_title()
    assert [line.get_label() for line in alone.lines] == ["dead reckoning", "start"]


def test_a_chart_has_contours_of_depth_and_a_graticule() -> None:
    """A slope of 0.1 to the north: the contour of a depth lies where the slope has it, and every degree, too."""
    north, east = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 200, 41), np.linspace(0, 300, 61)))
    bottom, plane = np.column_stack([north, east, 20 + 0.1 * north]), LocalPlane(54.1, 10.2)
    ends = np.array([[0.0, 0.0, 5.0], [200.0, 300.0, 5.0]])
    chart = Chart("m", Points("pose", np.arange(2), ends, np.full((2, 3, 3), np.nan)), None, (), plane, bottom)
    axes, bar = depth_chart(chart).axes
    assert bar.yaxis_inverted()
    _, contours = (each for each in axes.collections if isinstance(each, TriContourSet))
    for level, path in zip(contours.levels[1:-1], contours.get_paths()[1:-1], strict=True):
        assert path.vertices[:, 1] == pytest.approx((level - 20) / 0.1, abs=10.0)  # a cell
    for k, axis in enumerate((axes.yaxis, axes.xaxis)):
        for tick, label in zip(axis.get_ticklocs(), axis.get_ticklabels(), strict=True):
            degrees, minutes = re.findall(r"[0-9.]+", label.get_text())
            at = np.array([54.1, 10.2])
            at[k] = float(degrees) + float(minutes) / 60
            assert plane.local(*at)[k] == pytest.approx(tick, abs=0.1)
    flat = depth_chart(replace(chart, plane=None, bottom=bottom[:1])).axes  # nothing to draw contours of
    assert [axes.get_xlabel() for axes in flat] == ["y, east [m]"]
    (scale,) = (artist for artist in flat[0].artists if isinstance(artist, AnchoredSizeBar))
    assert scale.loc == AnchoredSizeBar.codes["lower right"]  # the track begins in the lower left
