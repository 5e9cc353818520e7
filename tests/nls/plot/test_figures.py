"""Figures of a filter's belief and of a factor graph, animations, and the colors of all pictures."""

from __future__ import annotations

import re
from io import BytesIO
from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure
from PIL import Image

import sim
from factors import Between, Isotropic, Landmark, Prior, RangeAzimuth
from models import SE2, SE3, R
from models.errors import GraphError, OptionError
from nls import FactorGraph, Marginals, Values, kinds
from nls.filters import EKF, FastSLAM, Filter, steps
from nls.plot import animation, belief, correlations, factor_graph
from nls.plot.player import Animation, image
from nls.plot.style import BEFORE, CLOSURE, ECHO, ESTIMATE, HELD, LANDMARK, REJECTED, SERIES, TRUE

x, l, b = kinds("x", "l", "b")
LAST = 12  # steps
WORLD = sim.subsea(np.random.default_rng(3), laps=1)


def after(estimator: Filter) -> Filter:
    for k, step in enumerate(steps(WORLD.graph, WORLD.start)[: LAST + 1]):
        estimator.start(step, WORLD.start) if k == 0 else estimator.step(step)
    return estimator


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_errors_and_ellipses_are_magnified_about_the_truth(scale: float) -> None:
    ekf = after(EKF())
    axes = belief(ekf, x[LAST], WORLD.truth, scale=scale).axes[0]
    X, P = ekf.pose
    keys, L, P_l = ekf.landmarks
    pose, landmarks = (c for c in axes.collections if isinstance(c, PolyCollection))
    q, true = WORLD.truth[x[LAST]][:2], WORLD.truth[keys]
    c, s = np.cos(X[2]), np.sin(X[2])
    R = np.array([[c, -s], [s, c]])
    expected = [(pose.get_paths()[0], q + scale * (X[:2] - q), R @ P[:2, :2] @ R.T)]
    expected += list(zip(landmarks.get_paths(), true + scale * (L - true), P_l, strict=True))
    for path, center, Sigma in expected:
        e = (path.vertices[:48] - center) / scale
        np.testing.assert_allclose(np.vecdot(e @ np.linalg.inv(Sigma), e), 5.991, rtol=1e-3)
    assert axes.get_title() == ("x12" if scale == 1 else "x12: errors and ellipses × 3")


def test_particles_are_dots() -> None:
    particles = after(FastSLAM(20, rng=np.random.default_rng(0)))
    assert isinstance(particles, FastSLAM)
    axes = belief(particles, x[LAST], WORLD.truth, scale=2.0).axes[0]
    (dots,) = (line for line in axes.lines if line.get_label() == "particles")
    q = WORLD.truth[x[LAST]][:2]
    np.testing.assert_allclose(dots.get_xydata(), q + 2 * (particles.X[:, :2] - q))


def test_correlations_of_a_filter_are_those_of_the_graph() -> None:
    """The last pose and the landmarks: Marginals of the measurements up to then say the same."""
    ekf = after(EKF())
    assert isinstance(ekf, EKF)
    joint = ekf.joint
    figure = correlations(joint)
    rho = np.asarray(figure.axes[0].images[0].get_array())
    sigma = np.sqrt(np.diagonal(joint.matrix))
    np.testing.assert_allclose(rho, joint.matrix / np.outer(sigma, sigma), atol=1e-12)
    np.testing.assert_allclose(np.diagonal(rho), 1.0)
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == [repr(key) for key in joint.keys]
    last = [LAST - (factor.name == "Between") for factor in WORLD.graph.factors]
    until = WORLD.graph.only([f.keys[0].numbers <= k for f, k in zip(WORLD.graph.factors, last, strict=True)])
    found = [int(key.numbers[0]) for key in joint.keys[1:]]
    start = Values({x: (SE2, WORLD.start[x[: LAST + 1]]), l: (R(2), WORLD.start[l[found]], found)})
    values = until.optimize(start, gauge="none").values
    graph_joint = Marginals(until, values, gauge="none").joint(joint.keys, frame="world")
    assert graph_joint.names == joint.names
    scale = np.sqrt(np.diagonal(graph_joint.matrix))
    np.testing.assert_allclose((joint.matrix - graph_joint.matrix) / np.outer(scale, scale), 0, atol=0.03)


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
    assert [text.get_text() for text in figure.legends[0].get_texts()][-1] == "fixed"


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


def test_refusals_of_a_factor_graph_name_the_variable() -> None:
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


def moving(**options: object) -> Animation:
    figure, axes = plt.subplots(figsize=(2, 1))
    axes.set_axis_off()

    def draw(shade: float) -> None:
        figure.set_facecolor(str(shade))

    return animation(figure, draw, [0.0, 0.5, 1.0], **({"alt": 'From <black> to "white".'} | options))  # type: ignore[arg-type]


def test_the_frames_are_in_order_and_the_last_one_is_the_still() -> None:
    made = moving()
    shades = [np.asarray(Image.open(BytesIO(frame))).mean() for frame in made.frames]
    assert np.allclose(shades, [0, 127, 255], atol=3)
    assert np.asarray(Image.open(BytesIO(made._repr_png_()))).mean() == 255
    assert len(plt.get_fignums()) == 0, "the cell would show the figure a second time"


def test_the_page_of_an_animation_stands_alone() -> None:
    made = moving(seconds=0.5)
    html = made._repr_html_()
    still = re.search(r'<img src="data:image/webp;base64,([^"]+)" alt="([^"]+)"', html)
    assert still is not None
    assert still[2] == "From &lt;black&gt; to &quot;white&quot;."
    assert f'"{still[1]}"]' in html, "what stands there before anything plays is the last frame"
    assert "seconds = [0.5, 0.5, 0.5];" in html
    assert "http" not in html
    assert "$" not in html
    assert html.index("<div hidden>") < html.index("controls.hidden = false"), "without scripts there are no controls"
    assert moving().html.split('id="')[1][:15] == html.split('id="')[1][:15], "the same frames give the same bytes"


def test_a_frame_is_the_whole_figure_on_white() -> None:
    figure = plt.figure(figsize=(4.33, 3.17))
    figure.set_facecolor((0, 0, 0, 0.5))
    plain = np.asarray(image(figure))
    assert plain.shape == (253, 346, 3)
    assert np.allclose(plain, 127, atol=1), "half transparent black on white"
    with plt.rc_context({"savefig.bbox": "tight"}):
        assert np.array_equal(np.asarray(image(figure)), plain)
    plt.close(figure)


def test_refusals_of_an_animation() -> None:
    figure = plt.figure()
    with pytest.raises(OptionError, match=r"frames.* expected at least one"):
        animation(figure, print, [], alt="Nothing.")
    for seconds in (0, float("inf"), [0.1, 0.2], [0.1, 0.1, -1]):
        with pytest.raises(OptionError, match=r"seconds.* above 0 for all frames, or one for each"):
            moving(seconds=seconds)
    assert "seconds = [1.0, 2.0, 3.0];" in moving(seconds=[1, 2, 3]).html
    noise = np.random.default_rng(0)
    figure, axes = plt.subplots(figsize=(8, 8))
    with pytest.raises(OptionError, match=r"frames.* at most 1,000,000 bytes"):
        animation(figure, lambda _: axes.imshow(noise.random((600, 600, 3))), range(6), alt="Noise.")
    plt.close("all")


SIGHT = {  # what is seen of linear red, green and blue: G. Machado et al., IEEE TVCG 15(6), 2009, severity 1
    "normal": np.eye(3),
    "no red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "no green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "no blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
LEAST = 12.0  # CIE 1976 distance; 2.3 is just noticeable for areas side by side, thin lines need several times that


def lab(color: str, sight: str) -> np.ndarray:
    c = np.array(to_rgb(color))
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    t = XYZ @ np.clip(np.asarray(SIGHT[sight]) @ linear, 0, 1) / XYZ.sum(axis=1)
    f = np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("sight", SIGHT)
def test_colors_that_meet_are_told_apart(sight: str) -> None:
    of_maps = (ESTIMATE, BEFORE, TRUE, CLOSURE, REJECTED, ECHO)
    for together in (SERIES, of_maps, (LANDMARK, ESTIMATE, TRUE)):
        near = [(a, b) for a, b in combinations(together, 2) if np.linalg.norm(lab(a, sight) - lab(b, sight)) < LEAST]
        assert near == []
