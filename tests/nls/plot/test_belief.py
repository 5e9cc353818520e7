"""The belief of a filter: ellipses are its covariances, about the truth; correlations are those of the graph."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import PolyCollection

import sim
from models import SE2, R
from nls import Marginals, Values, kinds
from nls.filters import EKF, FastSLAM, Filter, steps
from nls.plot import belief, correlations

x, l = kinds("x", "l")
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
