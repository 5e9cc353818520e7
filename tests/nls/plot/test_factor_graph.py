"""The factor graph drawn: one circle a variable, one square a measurement, where each of them is."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from factors import Between, Isotropic, Landmark, Prior, RangeAzimuth
from models import SE2, SE3, R
from models.errors import GraphError
from nls import FactorGraph, Values, kinds
from nls.plot import factor_graph
from nls.plot.style import HELD

x, l, b = kinds("x", "l", "b")
NOISE = Isotropic(0.1)


def toy() -> FactorGraph:
    walk = Between(x[[1, 2]], x[[2, 3]], [[2, 0, 0], [2, 0, 0]], NOISE)
    seen = Landmark(x[[1, 2, 3]], l[[1, 1, 2]], [[2, 2], [0, 2], [0, 2]], NOISE)
    return FactorGraph([Prior(x[1], [0, 0, 0], NOISE), walk, seen])


def circles(figure: Figure) -> dict[str, np.ndarray]:
    return {text.get_text(): np.array(text.get_position()) for text in figure.axes[0].texts}


def squares(figure: Figure) -> dict[str, np.ndarray]:
    lines = [line for line in figure.axes[0].lines if line.get_marker() == "s"]
    return {str(line.get_label()): np.column_stack(line.get_data()) for line in lines}


def test_poses_are_a_row_and_landmarks_stand_above_it() -> None:
    figure = factor_graph(toy())
    places = circles(figure)
    assert places.keys() == {"x1", "x2", "x3", "l1", "l2"}
    np.testing.assert_array_equal([places[f"x{k}"] for k in (1, 2, 3)], [[0, 0], [1, 0], [2, 0]])
    np.testing.assert_array_equal([places["l1"], places["l2"]], [[0.5, 1], [2, 1]])
    drawn = squares(figure)
    assert list(drawn) == ["Prior, 1", "Between, 2", "Landmark, 3"]
    np.testing.assert_allclose(drawn["Between, 2"], [[0.5, 0], [1.5, 0]])
    assert (drawn["Prior, 1"] - places["x1"])[0, 1] < 0
    lines = [line for line in figure.axes[0].lines if line.get_marker() == "None"]
    assert len(lines) == 1 + 2 * 2 + 2 * 3  # a line from every square to each of its variables


def test_with_values_variables_are_where_they_are() -> None:
    values = Values({x: (SE2, [[0, 0, 0], [2, 1, 0], [4, 0, 0]], [1, 2, 3]), l: (R(2), [[2, 2], [4, 2]], [1, 2])})
    graph = toy()
    graph.add(Between(x[1], x[2], [2, 0, 0], NOISE))
    graph.fix(x[3])
    figure = factor_graph(graph, values)
    np.testing.assert_array_equal(circles(figure)["x2"], [2, 1])
    same = squares(figure)["Between, 3"][[0, 2]]  # of the same two variables: on both sides of their line
    np.testing.assert_allclose(same.mean(axis=0), [1, 0.5], atol=0.1)
    assert np.linalg.norm(same[0] - same[1]) > 0.3
    faces = [tuple(c.get_facecolor()[0]) for c in figure.axes[0].collections if len(c.get_offsets())]
    assert [face == to_rgba(HELD) for face in faces] == [False, False, False, False, True]  # l1, l2, x1, x2, x3
    assert [text.get_text() for text in figure.legends[0].get_texts()][-1] == "held fixed"


def test_no_square_covers_a_circle_or_another_square() -> None:
    """Of measurements of three variables the middle may be that of another variable."""
    k = np.zeros(4, dtype=int)
    sonar = RangeAzimuth(x[[0, 0, 1, 1]], l[[0, 1, 0, 1]], np.ones((4, 2)), NOISE, offset=l[k + 7])
    figure = factor_graph(FactorGraph([sonar]))
    points = np.concatenate([*squares(figure).values(), np.array(list(circles(figure).values()))])
    apart = np.linalg.norm(points[:4, None] - points, axis=2) + np.eye(4, len(points))
    assert apart.min() > 0.25


def test_a_chart_of_space_has_north_up() -> None:
    poses = np.zeros((2, 7))
    poses[1, :2], poses[:, 6] = (3, 1), 1
    graph = FactorGraph([Between(x[0], x[1], SE3.between(poses[:1], poses[1:]), NOISE)])
    axes = factor_graph(graph, Values({x: (SE3, poses)})).axes[0]
    np.testing.assert_array_equal(axes.texts[1].get_position(), [1, 3])
    assert axes.get_xlabel() == "y [m]"


def test_refusals_name_the_variable() -> None:
    with pytest.raises(GraphError, match="no factors"):
        factor_graph(FactorGraph())
    many = np.arange(60)
    with pytest.raises(GraphError, match="61 variables, at most 60"):
        factor_graph(FactorGraph([Between(x[many], x[many + 1], np.zeros((60, 3)), NOISE)]))
    values = Values({x: (SE2, np.zeros((2, 3)), [1, 2]), l: (R(2), np.zeros((2, 2)), [1, 2])})
    with pytest.raises(GraphError, match="x3 is not in these values"):
        factor_graph(toy(), values)
    bias = FactorGraph([Prior(b[0], [0.0], NOISE)])
    with pytest.raises(GraphError, match="b0 has no position in the plane"):
        factor_graph(bias, Values({b: (R(1), [[0.0]])}))
    assert "b0" in circles(factor_graph(bias))
