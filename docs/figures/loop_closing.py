"""A vehicle closes a loop: the filter corrects only where it is now, the graph moves the whole path and knows every
pose of it better.

One lap of `sim.subsea`. Both are given the same factors: left an EKF, right the graph of what was measured so far,
solved again for every frame. Errors and 95 % ellipses are drawn ten times too large, since both are good.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import sim
from models.algebra import Array
from nls import kinds
from nls.filters.base import steps
from nls.filters.ekf import EKF
from nls.filters.smoother import Smoother
from nls.plot.style import BEFORE, ELLIPSE, ESTIMATE, LANDMARK

LARGER, EVERY = 10.0, 4
ANGLES = np.linspace(0, 2 * np.pi, 41)
CIRCLE = np.sqrt(-2 * np.log(0.05)) * np.stack([np.cos(ANGLES), np.sin(ANGLES)])


def make() -> tuple[list[Figure], list[float]]:
    """Frames and seconds."""
    world = sim.subsea(np.random.default_rng(6), laps=1, known_start=True)
    x, l = kinds("x", "l")
    truth, L = world.truth[x], world.truth[l]
    ekf, online = EKF(), Smoother()
    frames, off, then = [], [], []
    for k, step in enumerate(steps(world.graph, world.start)):
        for estimator in (ekf, online):
            estimator.start(step, world.start) if k == 0 else estimator.step(step)
        X, P = ekf.pose
        then.append((X.copy(), P.copy()))
        if k % EVERY == EVERY - 1:
            P_now = online.smoother.covariance(x[: k + 1], frame="body")
            path = [np.array([X for X, _ in then]), online.smoothed()]
            sure = [np.array([P for _, P in then]), P_now]
            found = [ekf.landmarks, online.landmarks]
            frames.append(_drawn(k, truth, L, path, sure, found))
            off.append(_rms(path[1], truth))
    closed = int(np.argmin(np.diff(off))) + 1
    seconds = np.full(len(frames), 0.25)
    seconds[[closed - 1, closed, -1]] = 1.2, 1.8, 3.0  # before and after the loop closes there is something to see
    return frames, seconds.tolist()


def _rms(X: Array, truth: Array) -> float:
    return float(np.sqrt(np.mean(np.sum((X - truth[: len(X)])[:, :2] ** 2, axis=1))))


def _drawn(k: int, truth: Array, L: Array, path: list[Array], sure: list[Array], found: list) -> Figure:
    figure = Figure(figsize=(8, 4.2))
    for side, name in enumerate(("filter (EKF)", "graph")):
        axes = figure.add_axes((0.01 + 0.5 * side, 0.01, 0.48, 0.88))
        X, P = path[side], sure[side]
        axes.plot(*truth[:, :2].T, color="0.87", linewidth=4)
        shown = truth[: len(X), :2] + LARGER * (X[:, :2] - truth[: len(X), :2])
        axes.plot(*shown.T, color=ESTIMATE, linewidth=1.5)
        for at in [*range(5, k, 10), k]:
            c, s = np.cos(X[at, 2]), np.sin(X[at, 2])
            _ellipse(axes, shown[at], np.array([[c, -s], [s, c]]) @ np.linalg.cholesky(P[at, :2, :2]), ELLIPSE)
        keys, places, P_l = found[side]
        for number, p, P_n in zip(keys.numbers, places, P_l, strict=True):
            q = L[number] + LARGER * (p - L[number])
            _ellipse(axes, q, np.linalg.cholesky(P_n), LANDMARK)
        axes.plot(*L.T, "^", color="0.6", markersize=5)
        axes.plot(*shown[-1], "o", color=BEFORE, markersize=8)
        axes.set_title(f"{name}: path {_rms(X, truth):.2f} m off")
        axes.set(xlim=(-50, 50), ylim=(-48, 48), xticks=[], yticks=[], aspect="equal")
    return figure


def _ellipse(axes: Axes, center: Array, root: Array, color: str) -> None:
    axes.plot(*(center[:, None] + LARGER * root @ CIRCLE), color=color, linewidth=0.9, alpha=0.8)
