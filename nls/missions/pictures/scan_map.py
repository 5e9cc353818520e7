"""A map from scans: the points in the world, the track through them, and the closures that hold it together."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from models import SE2
from nls.missions.scans.scans import in_world
from nls.plot.style import BEFORE, CLOSURE, ECHO, ESTIMATE, REJECTED, TRUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from models.algebra import Array, Mask
    from nls.missions.scans import Matches, Scans
    from nls.missions.scans.folder import Truth

LONG = 9.0  # inches of the map; its short side has at least half


def scan_map(
    poses: Array, dead: Array, scans: Scans, matches: Matches | None = None, truth: Truth | None = None
) -> Figure:
    """The map from above, x to the right and y up.

    Parameters
    ----------
    poses, dead : (count, 3) keyframes of the solution and of dead reckoning: x, y, m, and yaw, rad.
    scans : their points.
    matches : of the last round: closures that were kept, and faintly those that the others contradict.
    truth : moved onto the solution by the rigid motion of least squares.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    points = in_world(poses, scans)
    shown = np.concatenate([poses[:, :2], points])
    low, high = np.percentile(shown, [0.2, 99.8], axis=0)  # single points far away do not shrink the map
    tracks = np.concatenate([poses[:, :2], dead[:, :2]])
    low, high = np.minimum(low, tracks.min(axis=0)), np.maximum(high, tracks.max(axis=0))
    side = np.maximum(high - low, 1e-3)
    width, height = np.clip(LONG * side / side.max(), LONG / 2, LONG)
    figure = Figure(figsize=(width + 0.8, height + 1.4), layout="constrained")
    axes = figure.add_subplot()
    # all points of the scans together have 50,000 square points of ink
    size = float(np.clip(5e4 / max(len(points), 1), 0.8, 4.0))
    # at most 200,000 points are drawn
    drawn = points[:: max(1, -(-len(points) // 200_000))]
    axes.scatter(drawn[:, 0], drawn[:, 1], s=size, color=ECHO, alpha=0.35, linewidths=0, rasterized=True, zorder=1.5)
    axes.plot(*dead[:, :2].T, color=BEFORE, linewidth=1.0, linestyle="--", alpha=0.6, label="dead reckoning")
    if matches is not None:
        rejected = matches.accepted & ~matches.kept
        _joined(axes, poses, matches, rejected, REJECTED, 0.35, f"{int(rejected.sum())} closures rejected")
        _joined(axes, poses, matches, matches.kept, CLOSURE, 0.45, f"{int(matches.kept.sum())} closures kept")
    title = f"{len(poses):,} keyframes, {len(points):,} points"
    if truth is not None:
        error = truth.ate(poses)
        aligned = SE2.act(SE2.inverse(error.T[None]), truth.poses[:, :2])
        axes.plot(*aligned.T, color=TRUE, linewidth=1.2, label="truth, aligned")
        title = f"{error.rmse:.2f} m rmse from the truth, dead reckoning {truth.ate(dead).rmse:.2f} m"
    axes.plot(*poses[:, :2].T, color=ESTIMATE, linewidth=1.6, label="solution")
    axes.plot(*poses[0, :2], "o", color=ESTIMATE, markersize=5, label="start")
    margin = 0.03 * side.max()
    axes.set(xlabel="x [m]", ylabel="y [m]", title=title)
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal")
    handles, _ = axes.get_legend_handles_labels()
    dot = axes.scatter([], [], s=9, color=ECHO, label="points of the scans")  # one that can be seen
    figure.legend(handles=[dot, *handles], loc="outside lower center", ncols=4, fontsize=8)
    return figure


def _joined(axes: Axes, poses: Array, matches: Matches, rows: Mask, color: str, alpha: float, label: str) -> None:
    """A line between the keyframes of some matches."""
    from matplotlib.collections import LineCollection

    segments = np.stack([poses[end[rows], :2] for end in (matches.i, matches.j)], axis=1)
    if len(segments):
        alpha *= min(1.0, (100 / len(segments)) ** 0.5)  # many closures, over 100, must not hide the map
        lines = LineCollection(list(segments), colors=color, linewidths=0.7, alpha=alpha, label=label, zorder=1)
        axes.add_collection(lines)
