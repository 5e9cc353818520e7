r"""How far an estimator is off along the axes of the world: field, heading, position and landmarks, side by side.

    field       the map: tracks and landmarks
    heading     estimate minus truth, deg
    position    dX and dY, estimate minus truth, m, in one picture
    landmarks   dX against dY of every landmark in the end

The step of every landmark from the truth is nearly the same where the whole map is shifted. Then the points lie in one
heap beside the origin. A shift of everything is not measured by ranges and bearings, so its sigma is that of the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from models import LINE
from nls.covariance import frames
from nls.covariance.frames import outlines
from nls.plot.filters import estimator_map
from nls.plot.picture import add_lines, legend_below, name_plane, new_figure
from nls.plot.style import ESTIMATE, LANDMARK, SERIES, TRUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from factors.keys import Keys
    from models.algebra import Array, Numbers
    from nls.filters.base import Track
    from nls.values import Values

ONE_SIGMA = 1 - np.exp(-0.5)  # probability of the ellipse that cuts the axes at one sigma
ROW = 13.0  # points: height of a row of the column of names at most; the column has 190 at most


def offsets(track: Track, truth: Values, title: str = "", sightings: Sequence[Keys] | None = None) -> Figure:
    """The four pictures. Bands and ellipses are one sigma.

    Parameters
    ----------
    track : poses in SE2, and landmarks.
    truth : its poses and landmarks, under the same names.
    title : of the figure; the method of the track is always named.
    sightings : poses and the walls seen from them: walls are drawn as long as they were seen.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.filters.ekf import EKF
    >>> from nls.plot import offsets
    >>> world = sim.subsea(np.random.default_rng(1), laps=1)
    >>> figure = offsets(EKF().run(world.graph, world.start), world.truth)
    >>> [axes.get_title() for axes in figure.axes][:3]
    ['field', 'heading, estimate minus truth', 'position, estimate minus truth']
    """
    figure = new_figure(10.5, 8.8)
    (field, heading), (position, landmarks) = figure.subplots(2, 2)
    estimator_map(track, truth, field, sightings)
    field.set_title("field")
    steps, e = track.x.numbers, -track.manifold.local(track.X, truth[track.x])
    _band(heading, steps, np.degrees(e[:, 2]), np.degrees(np.sqrt(track.P[:, 2, 2])), ESTIMATE, "heading")
    heading.set(title="heading, estimate minus truth", ylabel="[deg]")
    away = track.manifold.position(track.X) - track.manifold.position(truth[track.x])
    J, _ = frames.axes(track.x, track.manifold, track.X, None, "position")
    sigma = np.sqrt(np.diagonal(frames.turned(J, track.P), axis1=1, axis2=2))
    for k, name in enumerate(("dX", "dY")):
        _band(position, steps, away[:, k], sigma[:, k], SERIES[k], name)
    position.set(title="position, estimate minus truth", ylabel="[m]")
    for axes in (heading, position):
        axes.set_xlabel("step")
        axes.axhline(0.0, color=TRUE, linewidth=0.8)
        axes.margins(x=0)
        legend_below(axes)
    _landmarks(track, truth, landmarks)
    figure.suptitle(f"{title}: {track.method}" if title else track.method)
    return figure


def _band(axes: Axes, steps: Numbers, e: Array, sigma: Array, color: str, name: str) -> None:
    """Errors as a line, and one sigma to both sides of zero as dashed lines."""
    axes.plot(steps, e, color=color, linewidth=1.2, label=name)
    axes.plot(steps, sigma, color=color, linewidth=0.8, linestyle="--", label=f"one sigma of {name}")
    axes.plot(steps, -sigma, color=color, linewidth=0.8, linestyle="--")


def _landmarks(track: Track, truth: Values, axes: Axes) -> None:
    """Offsets of the landmarks in the end, each with its name and its ellipse of one sigma.

    Names stand in a column beside the axes, the highest point first, so that those of a heap can be read.
    """
    from matplotlib.text import OffsetFrom

    axes.axhline(0.0, color=TRUE, linewidth=0.8)
    axes.axvline(0.0, color=TRUE, linewidth=0.8)
    line = track.values.stack(track.landmarks.kind).manifold is LINE
    unit = np.array([180 / np.pi, 1.0]) if line else np.ones(2)
    e = unit * track.landmark_errors(truth)
    P = unit[:, None] * track.P_landmarks * unit
    label = f"one sigma of a {'wall' if line else 'landmark'}"
    add_lines(axes, list(e[:, None] + outlines(P, ONE_SIGMA)), colors=LANDMARK, linewidths=0.8, alpha=0.5, label=label)
    axes.plot(*e.T, "o", color=LANDMARK, markersize=5)
    upwards, row = np.argsort(e[:, 1]), min(ROW, 190.0 / max(len(e), 1))
    beside, middle = OffsetFrom(axes.transAxes, (1.0, 0.5), "points"), (len(e) - 1) / 2
    leader = {"arrowstyle": "-", "color": LANDMARK, "linewidth": 0.6, "alpha": 0.6, "relpos": (0, 0.5)}
    style: dict[str, Any] = {"va": "center", "color": LANDMARK, "fontsize": min(9.0, row), "arrowprops": leader}
    for k, (key, place) in enumerate(zip(track.landmarks[upwards], e[upwards], strict=True)):
        axes.annotate(f"{key!r}", place, (ROW, row * (k - middle)), textcoords=beside, **style)
    if line:
        axes.set(title="walls, estimate minus truth", xlabel="alpha [deg]", ylabel="r [m]")
    else:
        name_plane(axes, "dX [m]", "dY [m]", title="landmarks, estimate minus truth")
        common = e.mean(axis=0)
        rest = np.sqrt(np.mean(np.sum((e - common) ** 2, axis=1)))
        label = f"common offset {np.linalg.norm(common):.2g} m, beside it {rest:.2g} m rms"
        axes.plot(*common, "x", color=TRUE, markersize=9, markeredgewidth=2, label=label)
    legend_below(axes)
