"""A map from scans: how many echoes are where, the track through them, and the closures that hold it together."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from models import SE2
from nls.missions.scans.scans import in_world
from nls.plot.picture import add_lines, full_legend, new_figure
from nls.plot.style import BEFORE, BELOW, CLOSURE, ESTIMATE, REJECTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from models.algebra import Array, Mask
    from nls.missions.scans import Matches, Scans
    from nls.missions.scans.folder import Truth

LONG = 9.0  # inches of the map; its short side has at least half
CELLS = 450  # of the map along its long side


def scan_map(
    poses: Array,
    scans: Scans,
    dead: Array | None = None,
    matches: Matches | None = None,
    truth: Truth | None = None,
) -> Figure:
    """The map from above, x to the right and y up: the darker a cell, the more points of the scans are in it.

    Parameters
    ----------
    poses : (count, 3) keyframes: x, y, m, and yaw, rad.
    scans : their points.
    dead : (count, 3) keyframes of dead reckoning, beside the solution; when omitted, `poses` are dead reckoning.
    matches : of the last round: closures that were kept, faintly, and those that the others contradict.
    truth : moved onto the solution by the rigid motion of least squares.

    Returns
    -------
    matplotlib.figure.Figure
    """
    points = in_world(poses, scans)
    tracks = poses[:, :2] if dead is None else np.concatenate([poses[:, :2], dead[:, :2]])
    # single points far away do not shrink the map
    low, high = np.percentile(points, [1, 99], axis=0) if len(points) else (tracks[0], tracks[0])
    low, high = np.minimum(low, tracks.min(axis=0)), np.maximum(high, tracks.max(axis=0))
    margin = 0.04 * max(float((high - low).max()), 1e-3)
    low, high = low - margin, high + margin
    width, height = np.clip(LONG * (high - low) / (high - low).max(), LONG / 2, LONG)
    figure = new_figure(width + 0.8, height + 1.4)
    axes = figure.add_subplot()
    _echoes(axes, points, low, high)
    if matches is not None:
        rejected = matches.accepted & ~matches.kept
        _joined(axes, poses, matches, matches.kept, CLOSURE, "-", f"{int(matches.kept.sum())} closures kept")
        _joined(axes, poses, matches, rejected, REJECTED, "--", f"{int(rejected.sum())} closures rejected")
    title = f"{len(poses):,} keyframes, {len(points):,} points"
    if truth is not None and dead is not None:
        error = truth.ate(poses)
        aligned = SE2.act(SE2.inverse(error.T[None]), truth.poses[:, :2])
        axes.plot(*aligned.T, color=BELOW, linewidth=5.0, label="truth, aligned")
        title = f"{error.rmse:.2f} m rmse from the truth, dead reckoning {truth.ate(dead).rmse:.2f} m"
    if dead is not None:
        axes.plot(*dead[:, :2].T, color=BEFORE, linewidth=1.4, linestyle="--", label="dead reckoning")
    color, label = (BEFORE, "dead reckoning") if dead is None else (ESTIMATE, "solution")
    axes.plot(*poses[:, :2].T, color=color, linewidth=1.6, label=label)
    axes.plot(*poses[0, :2], "o", color=color, markersize=5, label="start")
    axes.set(xlabel="x [m]", ylabel="y [m]", title=title, aspect="equal")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    full_legend(axes, 4)
    return figure


def _echoes(axes: Axes, points: Array, low: Array, high: Array) -> None:
    """Cells by the number of points in them: white for none, black from a hundredth of the fullest cells on."""
    edges = [np.linspace(a, b, 2 + int(CELLS * (b - a) / (high - low).max())) for a, b in zip(low, high, strict=True)]
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=edges)
    full = float(np.percentile(counts[counts > 0], 95)) if counts.any() else 1.0
    shade = np.clip(counts.T / full, 0, 1) ** 0.6
    axes.imshow(shade, cmap="gray_r", vmin=0, vmax=1.1, origin="lower", extent=(low[0], high[0], low[1], high[1]))


def _joined(axes: Axes, poses: Array, matches: Matches, rows: Mask, color: str, linestyle: str, label: str) -> None:
    """A line between the keyframes of some matches; many of them are fainter."""
    segments = np.stack([poses[end[rows], :2] for end in (matches.i, matches.j)], axis=1)
    if len(segments):
        style = {"color": color, "linestyle": linestyle, "alpha": min(0.8, 20 / len(segments) ** 0.8)}
        add_lines(axes, segments, linewidth=1.0, label=label, zorder=1.5, **style)
