"""A landmark slides along an arc that one sonar image cannot tell apart; in a second image, taken from higher up, the
same slide is seen at once.

Left the scene from the side, right the two images: range against azimuth, the measured contact as a circle.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from models import SE3
from models.manifolds import euler
from nls.plot.style import ARC, ELLIPSE, ESTIMATE

INK, ACCENT, SECOND = ESTIMATE, ARC, ELLIPSE
RANGE, TRUE = 4.0, np.radians(-6.0)
APERTURE = np.radians(14.0)  # half of it, up and down: what the sonar hears
ROLL, PITCH = np.radians(25.0), np.radians(15.0)


def make() -> tuple[list[Figure], list[float]]:
    """Frames and seconds."""
    turn = np.linspace(0.5, 2.5, 17)[1:] * np.pi  # the last frame, which may stand alone, is as high as the slide goes
    swing = TRUE + (APERTURE - abs(TRUE)) * np.sin(turn)
    first = SE3.identity(1)[0]
    up = SE3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]))  # z down: 1 m higher,
    second = SE3.compose(up, euler.to_se3([ROLL, -PITCH, 0.0, 0.0, 0.0, 0.0]))  # looking down a little, and rolled
    ahead, _, below = SE3.act(SE3.inverse(second[None]), _arc(np.array(TRUE)))[0]
    assert abs(np.arctan2(below, ahead)) < APERTURE  # the second image sees it, too
    frames = [_drawn(el, first, second) for el in swing]
    return frames, [0.18] * len(frames)


def _seen(X: np.ndarray, p: np.ndarray) -> tuple[float, float]:
    """Azimuth (deg) and range (m) of a point."""
    q = SE3.act(SE3.inverse(X[None]), p[None])[0]
    return float(np.degrees(np.arctan2(q[1], q[0]))), float(np.linalg.norm(q))


def _arc(el: np.ndarray) -> np.ndarray:
    """The points that the first image cannot tell apart: one range, one azimuth."""
    el = np.atleast_1d(el)
    return RANGE * np.stack([np.cos(el), 0 * el, -np.sin(el)], axis=1)


def _drawn(el: float, first: np.ndarray, second: np.ndarray) -> Figure:
    figure = Figure(figsize=(9, 4.0))
    side = figure.add_axes((0.07, 0.15, 0.44, 0.71))
    images = [figure.add_axes((left, 0.15, 0.18, 0.71)) for left in (0.6, 0.81)]
    arc, p, truth = _arc(np.linspace(-APERTURE, APERTURE, 60)), _arc(np.array(el))[0], _arc(np.array(TRUE))[0]
    side.plot(arc[:, 0], arc[:, 2], color=INK, linewidth=5, alpha=0.25, solid_capstyle="round")
    side.annotate("every point of the arc\nhas this range\nand azimuth", (1.9, 0.75), color=INK, ha="center", va="top")
    for X, color, name in ((first, INK, "1"), (second, SECOND, "2")):
        side.plot([X[0], p[0]], [X[2], p[2]], color=color, linewidth=1)
        side.plot(X[0], X[2], ">", color=color, markersize=13)
        side.annotate(name, (X[0], X[2]), (-18, -5), textcoords="offset points", color=color, weight="bold")
    side.plot(truth[0], truth[2], "o", color="none", markeredgecolor="0.3", markersize=15)
    side.plot(p[0], p[2], "*", color=ACCENT, markersize=13)
    side.set(xlim=(-0.7, 4.5), ylim=(1.8, -1.8), xticks=[0, 2, 4], yticks=[-1, 0, 1], aspect="equal")
    side.set(xlabel="forward [m]", ylabel="down [m]")
    side.set_title("from the side: where is the landmark?")
    for axes, X, color, name in zip(images, (first, second), (INK, SECOND), "12", strict=True):
        (azimuth, r), (true_azimuth, true_r) = _seen(X, p), _seen(X, truth)
        axes.plot(true_azimuth, true_r, "o", color="none", markeredgecolor="0.3", markersize=15)
        axes.plot(azimuth, r, "*", color=ACCENT, markersize=13)
        same = abs(azimuth - true_azimuth) < 0.5 and abs(r - true_r) < 0.03
        axes.set_title(f"image {name}\n{'fits' if same else 'does not fit'}", color="black" if same else ACCENT)
        axes.set(xlim=(-25, 25), ylim=(3.6, 4.8), xticks=[-20, 0, 20], yticks=[4.0, 4.5], xlabel="azimuth [°]")
        if name == "1":
            axes.set_ylabel("range [m]")
        else:
            axes.set_yticklabels([])  # the same scale
        for spine in axes.spines.values():
            spine.set(color=color, linewidth=2)
    return figure
