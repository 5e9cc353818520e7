"""A solved mission: its track beside dead reckoning and the truth, and its landmarks with the elevation they may have.

Maps are seen from above, north (x) to the right and east (y) downwards, as z is down. Side views have z downwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from factors.keys import kinds
from nls.plot.ellipses import ellipses

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from models.algebra import Array
    from nls.covariance import Marginals
    from nls.io.mission.solution import Elevations, Track
    from nls.values import Values

__all__ = ["landmark_map", "track"]

SOLUTION, DEAD, TRUE, POINT = "#0b4f6c", "#e07a2f", "#202020", "#3f8f4f"
VISIBLE = 0.02  # of the width of the map: the largest ellipse is drawn at least so large
x, l = kinds("x", "l")


def track(
    values: Values,
    dead: Values,
    truth: Values | None = None,
    marginals: Marginals | None = None,
    errors: Mapping[str, Track] | None = None,
) -> Figure:
    """The track from above, solved, dead-reckoned and true, with 95 % ellipses; and how far each is off along the way.

    Parameters
    ----------
    values, dead : poses ``x`` of the solution and of dead reckoning.
    truth : true poses.
    marginals : covariances of the solution.
    errors : tracks by what they are called, see `nls.io.mission.track_of`; their errors are drawn beside the map.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.5) if errors else (7, 5.5), layout="constrained")
    axes = figure.subplots(1, 2 if errors else 1, squeeze=False)[0]
    _path(axes[0], dead, color=DEAD, linewidth=1.0, linestyle="--", label="dead reckoning")
    if truth is not None and "x" in truth.stacks:
        _path(axes[0], truth, color=TRUE, linewidth=2.4, alpha=0.35, label="truth")
    _path(axes[0], values, color=SOLUTION, linewidth=1.0, label="solution")
    if marginals is not None:
        ellipses(marginals, axes[0], scale=_scale(marginals), kind=x)
    _from_above(axes[0])
    axes[0].legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2, fontsize=8)
    for (name, found), color in zip((errors or {}).items(), (DEAD, SOLUTION), strict=False):
        axes[1].plot(found.along, found.error, color=color, label=f"{name}, against the {found.against}")
        axes[1].set(xlabel="distance travelled [m]", ylabel="error of the position [m]")
        axes[1].set_ylim(bottom=0.0)
        axes[1].legend(loc="upper left", fontsize=8)
    return figure


def landmark_map(values: Values, found: Elevations, truth: Values | None = None) -> Figure:
    """Landmarks from above and from the side, each with the arc of one sigma of its elevation.

    Parameters
    ----------
    values : poses ``x`` and landmarks ``l``.
    found : `nls.io.mission.elevations` at these values; without sigmas the landmarks alone are drawn.
    truth : true landmarks.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.5), layout="constrained")
    axes = figure.subplots(1, 2)
    points = values[l[found.landmarks]]
    known = np.isfinite(found.sigma)
    reach = (found.range * found.sigma)[:, None] * found.along  # one sigma along the arc, m
    for ax, rows in ((axes[0], [0, 1]), (axes[1], [0, 2])):
        if truth is not None and "l" in truth.stacks:
            ax.plot(*truth[l][:, rows].T, "+", color=TRUE, markersize=5, alpha=0.5, label="truth")
        if not known.all():
            unknown = "landmark" if not known.any() else "landmark, free"
            ax.scatter(*points[~known][:, rows].T, s=12, facecolors="none", edgecolors=POINT, zorder=3, label=unknown)
        if known.any():
            ends = np.stack([points - reach, points + reach], axis=1)[known][:, :, rows]
            ax.add_collection(LineCollection(list(ends), colors=POINT, linewidths=0.8, label="one sigma of elevation"))
            dots = ax.scatter(
                *points[known][:, rows].T,
                c=np.degrees(found.sigma[known]),
                s=12,
                norm="log",
                zorder=3,
                label="landmark",
            )  # by powers: most landmarks are known to tenths of a degree, some to no better than the aperture
        ax.plot(*values[x][:, [0, 1, 2]][:, rows].T, color=SOLUTION, linewidth=0.6, alpha=0.6, label="track")
    if known.any():
        figure.colorbar(dots, ax=axes, label="sigma of elevation at first view [deg]", shrink=0.8)
    _from_above(axes[0])
    axes[1].set(xlabel="x, north [m]", ylabel="z, down [m]")
    axes[1].set_aspect("equal", adjustable="datalim")
    axes[1].invert_yaxis()
    axes[0].legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2, fontsize=8)
    return figure


def _path(axes: Axes, values: Values, **style: object) -> None:
    stack = values.stack("x")
    position: Array = np.asarray(stack.manifold.position(stack.X))[np.argsort(stack.numbers)]
    axes.plot(*position[:, :2].T, **style)  # type: ignore[arg-type]


def _from_above(axes: Axes) -> None:
    axes.set(xlabel="x, north [m]", ylabel="y, east [m]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()


def _scale(marginals: Marginals) -> float:
    """1, 2, 5, 10, ...: how many times larger than they are ellipses must be drawn to be seen."""
    stack = marginals.values.stack("x")
    position = np.asarray(stack.manifold.position(stack.X))[:, :2]
    largest = float(np.sqrt(np.linalg.eigvalsh(marginals.all(x, view="position")[:, :2, :2]).max()))
    wanted = VISIBLE * float(np.ptp(position, axis=0).max()) / (2 * largest) if largest > 0 else 1.0
    steps = [m * 10.0**k for k in range(4) for m in (1, 2, 5)]
    return max((step for step in steps if step <= wanted), default=1.0)
