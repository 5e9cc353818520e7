"""Pictures: what is drawn, and that nobody pays for them who does not ask."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from factors import ZPR, Between, Diagonal, Isotropic, Prior
from models import SE2, SE3, SO3, LieGroup, R
from models.algebra import Array
from models.errors import OptionError
from models.listing import number
from nls import FactorGraph, Marginals, Values
from nls.missions.scans import dead_reckoning
from nls.plot import before_after, convergence, ellipses, spy, trajectory
from nls.plot.style import REJECTED
from nls.robust.graduated import Rejected
from tests.nls.graphs import ODD, Sample, Seen, in_frame, l, mixed, pose_graph, x

ROOT = Path(__file__).parents[3]


def drawn(figure: Figure) -> None:
    """Render a picture."""
    stream = BytesIO()
    figure.savefig(stream, dpi=20)
    assert stream.getvalue().startswith(b"\x89PNG")


@pytest.mark.parametrize("group", [R(3), SE2], ids=str)
def test_trajectory_in_the_order_of_the_numbers(group: LieGroup) -> None:
    sample = pose_graph(group, numbers=ODD)
    figure = trajectory(sample.graph, sample.values)
    drawn(figure)
    axes = figure.axes[0]
    assert axes.name == ("3d" if group in (R(3), SE3) else "rectilinear")
    order = np.argsort(ODD)
    line = axes.get_lines()[0]
    X = np.stack(line.get_data_3d() if axes.name == "3d" else line.get_data(), axis=1)  # type: ignore[attr-defined]
    np.testing.assert_array_equal(X, group.position(sample.values[x])[order])


def test_only_edges_between_poses_that_are_not_neighbors_are_closures() -> None:
    sample = pose_graph(SE2)
    axes = trajectory(sample.graph, sample.values).axes[0]
    (closures,) = (c for c in axes.collections if isinstance(c, LineCollection))
    assert len(closures.get_segments()) == 5  # the chain and its duplicate edge are neighbors
    ends = {tuple(map(tuple, segment)) for segment in closures.get_segments()}
    t = sample.values[x][:, :2]
    assert (tuple(t[0]), tuple(t[7])) in ends


def test_landmarks_are_points() -> None:
    sample = mixed(0)
    sample.graph.add(Seen(x[40], l[5], in_frame(sample.truth[x[[40]]], sample.truth[l[[5]]]), Isotropic(1)))
    figure = trajectory(sample.graph, sample.values)
    (stars,) = (line for line in figure.axes[0].get_lines() if line.get_marker() == "*")
    assert len(stars.get_xdata()) == 4  # type: ignore[arg-type]


def test_drifts_have_no_place() -> None:
    """Variables d and m of dead reckoning are R(2), as landmarks are; steps and matches do not move them."""
    reckoned = np.column_stack([np.arange(40.0) + 100.0, np.zeros(40), np.zeros(40)])
    graph, values = dead_reckoning(reckoned)
    graph.add(Between(x[[0, 5]], x[[20, 30]], [[20.0, 0, 0], [25.0, 0, 0]], Isotropic(0.1)))
    axes = trajectory(graph, values, marginals=Marginals(graph, values)).axes[0]
    assert axes.lines[0].get_label() == "trajectory"
    assert min(float(np.min(line.get_xdata())) for line in axes.lines) == 100.0
    (closures,) = (c for c in axes.collections if isinstance(c, LineCollection))
    assert len(closures.get_segments()) == 2
    assert axes.figure.legends[0].get_texts()[0].get_text() == "loop closures"  # type: ignore[union-attr]
    labels = [str(c.get_label()) for c in axes.collections]
    assert [label for label in labels if "ellipse" in label] == ["95 % ellipse of every x"]


def test_without_places_nothing_is_drawn() -> None:
    """Rotations have none, nor has an empty graph; a picture there is all the same."""
    sample = pose_graph(SO3)
    assert trajectory(sample.graph, sample.values).axes[0].get_lines() == []
    drawn(trajectory(FactorGraph(), Values({x: (SE2, np.zeros((0, 3)))})))


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_before_after_and_convergence(group: LieGroup) -> None:
    sample = pose_graph(group, start=0.3)
    result = sample.graph.optimize(sample.values)
    figure = before_after(sample.graph, sample.values, result, title="a survey")
    drawn(figure)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[0] == f"before: chi2 = {number(result.chi2_initial)}"
    assert titles[1] == f"after: chi2 = {number(result.chi2_final)}"
    assert titles[2] == f"converged after {result.iterations} iterations"
    assert figure.get_suptitle() == "a survey"
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["loop closures", "trajectory"]  # once for both maps
    assert [axes.get_legend() for axes in figure.axes[:2]] == [None, None]
    worse = pose_graph(group, start=0.4).values
    risen = result.history[1]._replace(chi2=1e9)  # Gauss-Newton may go up
    history = (result.history[0], risen, *result.history[2:])
    curve = before_after(sample.graph, worse, replace(result, history=history)).axes[2]
    assert curve.get_ylim()[1] > 1e9
    start, steps, expected = curve.get_lines()
    np.testing.assert_array_equal(start.get_xydata(), [[-1, sample.graph.chi2(worse)], [0, result.chi2_initial]])
    np.testing.assert_array_equal(steps.get_ydata(), [it.chi2 for it in history])
    assert {*expected.get_ydata()} == {result.dof}  # type: ignore[misc]


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_what_was_rejected_is_dashed_and_red_on_both_maps(group: LieGroup) -> None:
    sample = pose_graph(group, start=0.3)
    result = sample.graph.optimize(sample.values)
    wrong = [Rejected(f"Between(x{i}, x{j})", 291.0, 0, 0, (x[i], x[j]), 0.0) for i, j in ((0, 5), (2, 7))]
    figure = before_after(sample.graph, sample.values, replace(result, history=result.history[:1]), rejected=wrong)
    drawn(figure)
    assert figure.axes[2].get_title() == "0 more iterations"
    for axes, values in zip(figure.axes[:2], (sample.values, result.values), strict=True):
        (line,) = (line for line in axes.get_lines() if line.get_color() == REJECTED)
        X = np.stack(line.get_data_3d() if axes.name == "3d" else line.get_data(), axis=1)  # type: ignore[attr-defined]
        t = group.position(values[x])
        np.testing.assert_array_equal(X[[0, 1, 3, 4]], t[[0, 5, 2, 7]])
        assert line.get_linestyle() == "--"
    assert figure.legends[0].get_texts()[-1].get_text() == "2 loop closures rejected, not in chi2"


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_before_and_after_have_one_scale_unless_the_optimum_would_be_too_small(group: LieGroup) -> None:
    sample = pose_graph(group)
    result = sample.graph.optimize(sample.values)
    plain = "before: chi2 = [0-9.,]+$"
    for factor, title in ((0.1, plain), (2.0, plain), (8.0, "\ndrawn 8 times ")):
        X = result.values[x].copy()
        X[:, : -1 if group is SE2 else 3] *= factor
        figure = before_after(sample.graph, Values({x: (group, X)}), result)
        figure.draw_without_rendering()
        left, right = ([axis.get_view_interval() for axis in axes._axis_map.values()] for axes in figure.axes[:2])
        assert re.search(title, figure.axes[0].get_title())
        assert np.allclose(left, right) == (factor < 8)


def test_a_flat_graph_in_space_has_one_scale_and_no_slit_for_a_box() -> None:
    """9 m, 2 m and 0 m: the box is at least 0.15 of its length wide, and few ticks are on its short sides."""
    i = np.arange(10)
    X = np.zeros((10, 7))
    X[:, 0], X[:, 1], X[:, 6] = i, i % 3, 1
    graph = FactorGraph([Between(x[i[:-1]], x[i[1:]], SE3.between(X[:-1], X[1:]), Isotropic(0.1))])
    (axes,) = trajectory(graph, Values({x: (SE3, X)})).axes
    limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])  # type: ignore[attr-defined]
    size = np.ptp(limits, axis=1)
    np.testing.assert_allclose(size, [1.04 * 9, 1.04 * 2, 0.15 * 9])
    box = np.asarray(axes._box_aspect)  # type: ignore[attr-defined]
    np.testing.assert_allclose(box / box[0], size / size[0])
    axis_of = (axes.xaxis, axes.yaxis, axes.zaxis)  # type: ignore[attr-defined]
    inside = [[low <= t <= high for t in a.get_majorticklocs()] for a, (low, high) in zip(axis_of, limits, strict=True)]
    ticks = [*map(sum, inside)]
    assert ticks[0] > 4 >= max(ticks[1:])


def test_a_graph_that_knows_where_down_is_has_z_down() -> None:
    """Right-handed: seen along the axis of z, from above, y is to the right of x."""
    sample = pose_graph(SE3)
    up = trajectory(sample.graph, sample.values).axes[0]
    sample.graph.add(ZPR(x[1], [0.0, 0.0, 0.0], Isotropic(1.0)))
    down = trajectory(sample.graph, sample.values).axes[0]
    inverted = [[axis.get_inverted() for axis in (a.xaxis, a.yaxis, a.zaxis)] for a in (up, down)]  # type: ignore[attr-defined]
    assert inverted == [[False, False, False], [False, True, True]]
    assert down.get_zlabel() == "z, down [m]"  # type: ignore[attr-defined]


def test_rounding_is_no_curve() -> None:
    """The axis of chi2 spans nearly a decade at least, and ends at a millionth of what is expected."""
    sample = pose_graph(SE2, start=0.3)
    near = sample.graph.optimize(sample.graph.optimize(sample.values).values)
    axes = convergence(near, before=near.chi2_initial * (1 + 1e-12)).axes[0]
    assert axes.get_yscale() == "log"
    assert axes.get_ylim()[1] > 9 * axes.get_ylim()[0]
    assert min(axes.get_lines()[0].get_xdata()) == 0  # type: ignore[type-var]
    assert f"{number(near.chi2_final)}" in [text.get_text() for text in axes.texts]


def test_convergence_to_zero_and_without_a_step() -> None:
    sample = pose_graph(R(2))
    sample.graph.fix(x[0:8])
    convergence(sample.graph.optimize(sample.values)).draw_without_rendering()
    graph = FactorGraph(sample.graph.factors[:1])
    exact = graph.optimize(graph.optimize(sample.values).values)
    figure = convergence(exact)
    figure.draw_without_rendering()
    assert exact.converged
    assert {*figure.axes[0].get_lines()[0].get_ydata()} == {1e-6}  # type: ignore[misc]


def test_spy_counts_every_number() -> None:
    sample = mixed(0)
    system = sample.graph.linearize(sample.values)
    figure = spy(system)
    drawn(figure)
    A, H, R_ = figure.axes
    assert A.get_title() == f"A: {system.A.shape[0]} x {system.A.shape[1]}, {system.A.nnz} numbers"
    assert H.get_title() == f"H = A'A: {system.H.nnz} numbers"
    assert len(A.get_lines()[0].get_xdata()) == system.A.nnz  # type: ignore[arg-type]
    assert len(H.get_lines()[0].get_xdata()) == system.H.nnz  # type: ignore[arg-type]
    found = re.fullmatch(r"R, reordered: (\d+) numbers, (\d+) of them fill-in", R_.get_title())
    assert found is not None
    nnz, fill = map(int, found.groups())
    upper = (system.H.nnz + system.A.shape[1]) // 2
    assert nnz == len(R_.get_lines()[0].get_xdata()) >= upper  # type: ignore[arg-type]
    assert fill == nnz - upper
    names = [label.get_text() for label in A.get_xticklabels()]
    assert names == [f"{key!r}" for key in sample.values]
    many = pose_graph(R(1), n=60)  # too many to be named: columns are counted
    figure = spy(many.graph.linearize(many.values))
    assert "x0" not in [label.get_text() for label in figure.axes[0].get_xticklabels()]


@pytest.mark.parametrize("case", ["free gauge", "untouched", "all fixed", "no factors"])
def test_spy_draws_any_system(case: str) -> None:
    """Where something is free H + D has numbers where R would have them."""
    sample = pose_graph(SE2, anchored=case != "free gauge")
    graph, values = sample.graph, sample.values
    if case == "untouched":
        values = Values({x: (SE2, np.vstack([values[x], np.zeros((2, 3))]))})
    if case == "all fixed":
        graph.fix(x[0:8])
    if case == "no factors":
        graph = FactorGraph()
    system = graph.linearize(values)
    figure = spy(system)
    drawn(figure)
    anchored = pose_graph(SE2)
    numbers, fill = re.findall(r"\d+", spy(anchored.graph.linearize(anchored.values)).axes[2].get_title())
    expected = {
        "free gauge": f"R, of H + D, as something is free: {numbers} numbers, {fill} of them fill-in",
        "untouched": f"R, of H + D, as something is free: {int(numbers) + 6} numbers, {fill} of them fill-in",
        "all fixed": "R, reordered: 0 numbers, 0 of them fill-in",
        "no factors": "R, of H + D, as something is free: 24 numbers, 0 of them fill-in",
    }
    assert figure.axes[2].get_title() == expected[case]
    assert len(figure.axes[1].get_lines()[0].get_xdata()) == np.count_nonzero(system.H.toarray())  # type: ignore[arg-type]


def test_pictures_need_no_pyplot() -> None:
    code = """
import sys
from models import SE2
from nls.plot import before_after, spy
from tests.nls.graphs import pose_graph
sample = pose_graph(SE2)
result = sample.graph.optimize(sample.values)
before_after(sample.graph, sample.values, result)
spy(sample.graph.linearize(sample.values)).savefig("/dev/null", format="png", dpi=20)
print("matplotlib.pyplot" in sys.modules, "matplotlib" in sys.modules)
"""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, check=True)
    assert done.stdout == b"False True\n"


# ---- ellipses of positions: their size, their axes, and which are drawn


def marginals_of(sample: Sample) -> Marginals:
    return Marginals(sample.graph, sample.values)


def outlines(axes: Axes) -> list[Array]:
    polygons = (c for c in axes.collections if isinstance(c, PolyCollection))
    return [np.asarray(path.vertices) for polygon in polygons for path in polygon.get_paths()]


def test_half_axes_by_hand() -> None:
    """Body sigmas 0.3 along and 0.1 across, heading 90 deg: 0.3 along y; 95 % is 2.4477 sigma in two dimensions."""
    graph = FactorGraph([Prior(x[0], [5.0, -2.0, np.pi / 2], Diagonal([0.3, 0.1, 0.01]))])
    marginals = Marginals(graph, Values({x: (SE2, [5.0, -2.0, np.pi / 2])}))
    (outline,) = outlines(ellipses(marginals).axes[0])
    drawn(ellipses(marginals))
    np.testing.assert_allclose(np.ptp(outline, axis=0) / 2, 2.4477 * np.array([0.1, 0.3]), rtol=0.01)
    np.testing.assert_allclose((outline.max(axis=0) + outline.min(axis=0)) / 2, [5.0, -2.0], atol=0.01)
    (half,) = outlines(ellipses(marginals, probability=0.5, scale=10).axes[0])
    np.testing.assert_allclose(np.ptp(half, axis=0) / 2, 11.774 * np.array([0.1, 0.3]), rtol=0.01)


def test_every_corner_is_at_the_same_distance_in_sigmas() -> None:
    sample = mixed(0)
    marginals = marginals_of(sample)
    figure = ellipses(marginals, probability=0.9)
    found = outlines(figure.axes[0])
    expected = []
    for kind in (l, x):
        t, Sigma = sample.values[kind][:, :2], marginals.all(kind, view="position")
        expected += [(t[k], Sigma[k]) for k in np.argsort(sample.values.stack(kind.name).numbers)]
    assert len(found) == len(expected) == 10
    for outline, (t, Sigma) in zip(found, expected, strict=True):
        away = np.einsum("ni,ij,nj->n", outline - t, np.linalg.inv(Sigma), outline - t)
        np.testing.assert_allclose(away, -2 * np.log(0.1), rtol=1e-8)


def test_which_are_drawn() -> None:
    sample = pose_graph(SE2, anchored=False)
    axes = ellipses(marginals_of(sample), every=3).axes[0]
    assert len(outlines(axes)) == 3  # x1, x4, x7: x0 is held and has none
    t = sample.values[x][:, :2]
    centers = [(o.max(axis=0) + o.min(axis=0)) / 2 for o in outlines(axes)]
    np.testing.assert_allclose(centers, t[[1, 4, 7]], atol=1e-2)
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["95 % ellipse of every 3rd x"]
    many = pose_graph(SE2, n=300)
    marginals = marginals_of(many)
    axes = ellipses(marginals).axes[0]
    assert len(outlines(axes)) == 100
    texts = [text.get_text() for text in ellipses(marginals, scale=2, every=22).axes[0].get_legend().texts]
    assert texts == ["95 % ellipse of every 22nd x, 2 times as large"]


def test_in_space_they_lie_level() -> None:
    sample = pose_graph(SE3)
    marginals = marginals_of(sample)
    figure = trajectory(sample.graph, sample.values, marginals=marginals, every=2)
    drawn(figure)
    (lines,) = (c for c in figure.axes[0].collections if "ellipse" in str(c.get_label()))
    segments = np.asarray(lines._segments3d)
    t = sample.values[x][::2, :3]
    assert segments.shape[0] == 4
    np.testing.assert_allclose(segments[:, :, 2], np.broadcast_to(t[:, 2:], segments.shape[:2]), atol=1e-12)
    Sigma = marginals.covariance(x[4], view="position")[:2, :2]
    away = segments[2, :, :2] - t[2, :2]
    np.testing.assert_allclose(np.sum(away @ np.linalg.inv(Sigma) * away, axis=1), -2 * np.log(0.05), rtol=1e-8)
    flat = ellipses(marginals)
    assert flat.axes[0].name == "rectilinear"
    assert len(outlines(flat.axes[0])) == 8


def test_with_the_trajectory() -> None:
    sample = pose_graph(SE2)
    without, figure = (trajectory(sample.graph, sample.values, marginals=m) for m in (None, marginals_of(sample)))
    assert not outlines(without.axes[0])
    assert len(outlines(figure.axes[0])) == 8
    texts = [text.get_text() for text in figure.legends[0].texts]
    assert texts == ["loop closures", "trajectory", "95 % ellipse of every x"]


def test_nothing_to_draw_and_wrong_options() -> None:
    sample = pose_graph(SO3)
    figure = ellipses(marginals_of(sample))
    assert not outlines(figure.axes[0])
    assert figure.axes[0].get_legend() is None
    drawn(figure)
    marginals = marginals_of(pose_graph(SE2))
    options: dict[str, int] = {"probability": 95, "every": 0, "scale": 0}
    for name, value in options.items():
        with pytest.raises(OptionError, match=f"{name}: {value} is not possible"):
            ellipses(marginals, **{name: value})  # type: ignore[arg-type]
