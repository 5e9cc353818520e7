"""The picture of a simulated rig: what is drawn is where the numbers say."""

from __future__ import annotations

import re

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

import nls
import sim
from models import SE2, SE3, LieGroup, R
from models.algebra import Array
from models.sensors import Camera
from nls import Values
from sim.pictures import rig_before_after
from tests.factors.evaluated import refused
from tests.nls.graphs import pose_graph

x, l = nls.kinds("x", "l")
same = np.testing.assert_allclose
CAMERA = Camera((600.0, 600.0), (640.0, 480.0), size=(1280, 960))
CHANGES = {"cameras [cm]": (3.0, 1.0), "points [cm]": (6.0, 1.5)}


def scene(points: int = 40) -> tuple[Values, Values, Values]:
    """Truth; a start that is moved as a whole and has 10 cm of noise in the points; the same with 1 cm."""
    rng = np.random.default_rng(1)
    X = SE3.exp(np.column_stack([np.linspace(0, 3, 5), np.zeros((5, 5))]))
    L = rng.uniform([-4, -3, 5], [4, 3, 11], size=(points, 3))
    truth = Values({x: (SE3, X), l: (R(3), L)})
    M = SE3.exp(np.array([[5.0, 2, 1, 0.3, -0.2, 1.0]]))
    noise = rng.normal(size=L.shape)
    made = [{x: SE3.compose(M, X), l: SE3.act(M, L + size * noise)} for size in (0.1, 0.01)]
    return truth, truth.replaced(made[0]), truth.replaced(made[1])


def drawn(axes: Axes) -> list[Array]:
    """Ends (n, 2, 2) of the lines of errors: cameras, points; the frusta come first."""
    lines = [c for c in axes.collections if isinstance(c, LineCollection)]
    return [np.array(c.get_segments()) for c in lines[1:]]


def test_errors_are_drawn_where_they_are_and_as_long_as_it_is_said() -> None:
    truth, before, after = scene()
    raw, optimized, numbers, bar = rig_before_after(truth, before, after, CAMERA, CHANGES).axes
    assert (raw.get_title(), optimized.get_title()) == ("raw", "optimized")
    times = float(re.search(r"drawn (\d+) times as long; dots: the truth$", bar.get_xlabel())[1])
    assert times > 1
    lengths = []
    for axes in (raw, optimized):
        cameras, points = drawn(axes)
        same(cameras[:, 0], truth[x][:, [0, 2]], atol=1e-12)
        same(points[:, 0], truth[l][:, [0, 2]], atol=1e-12)
        lengths.append(np.linalg.norm(points[:, 1] - points[:, 0], axis=1) / times)
    expected = np.linalg.norm(np.random.default_rng(1).normal(size=(40, 3)), axis=1).mean()
    same(lengths[0].mean(), 0.1 * expected, rtol=0.4)  # the motion of everything is gone, noise is left
    same(lengths[0], 10 * lengths[1], rtol=0.3)
    assert (raw.get_xlim(), raw.get_ylim()) == (optimized.get_xlim(), optimized.get_ylim())
    assert {"cameras [cm]", "points [cm]", "3", "1", "6", "1.5"} <= {t.get_text() for t in numbers.texts}
    frusta = np.array(next(c for c in raw.collections if isinstance(c, LineCollection)).get_segments())
    assert len(frusta) == 5
    deep = frusta[0][:, 1].max()
    for outline, X in zip(frusta, truth[x], strict=True):  # they look where the cameras look
        same(outline[0], X[[0, 2]], atol=1e-12)
        same(np.ptp(outline[:, 1]), deep)
        same([outline[:, 0].min() - X[0], outline[:, 0].max() - X[0]], np.array([-1, 1]) * deep * 640 / 600, rtol=1e-9)


def test_of_many_points_a_part_is_drawn_and_it_is_said() -> None:
    axes = rig_before_after(*scene(2500), CAMERA, CHANGES).axes
    assert len(drawn(axes[0])[1]) == 834
    assert axes[3].get_xlabel().endswith("dots: the truth of 834 of 2500 points")


def test_without_errors_it_is_drawn_all_the_same() -> None:
    truth, _, _ = scene()
    for camera in (Camera(), CAMERA):  # normalized, pixels
        figure = rig_before_after(truth, truth, truth, camera, {"points [cm]": (0.0, 0.0)})
        figure.draw_without_rendering()
        ends = np.concatenate(drawn(figure.axes[0]))
        same(ends[:, 1], ends[:, 0], atol=1e-9)


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_each_estimate_is_drawn_over_the_truth_with_its_error(group: LieGroup) -> None:
    sample = pose_graph(group)
    X = sample.truth[x].copy()
    X[:, :2] += [3.0, 4.0]
    figure = sim.against_truth(sample.graph, sample.truth, {"moved": Values({x: (group, X)}), "true": sample.truth})
    figure.draw_without_rendering()
    assert [axes.get_title() for axes in figure.axes] == ["moved: 5 m off", "true: 0 m off"]
    for axes, positions in zip(figure.axes, (X, sample.truth[x]), strict=True):
        truth, estimate, _ = axes.get_lines()
        np.testing.assert_array_equal(truth.get_xydata(), sample.truth[x][:, :2])
        np.testing.assert_array_equal(estimate.get_xydata(), positions[:, :2])


def test_any_number_of_estimates_is_drawn_and_a_truth_without_poses_refused() -> None:
    sample = pose_graph(SE2)
    figure = sim.against_truth(sample.graph, sample.truth, {f"{k}": sample.truth for k in range(9)})
    assert [axes.get_title() for axes in figure.axes] == [f"{k}: 0 m off" for k in range(9)]
    points = Values({l: (R(2), [[0.0, 0.0]])})
    refused(
        lambda: sim.against_truth(sample.graph, points, {"a": points}), nls.OptionError, "expected values with poses"
    )
