"""A mission from above and from the side: as it was read, solved beside dead reckoning, and its open elevations.

Maps are charts: north (x) up, east (y) to the right. Side views look north, z, which is down, downwards.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from factors.keys import kinds
from models.algebra import Array, distance_along
from models.listing import number
from nls.plot.ellipses import ellipses, visible_scale
from nls.plot.picture import add_lines, full_legend, name_plane, new_figure
from nls.plot.style import BEFORE, BELOW, ELLIPSE, ESTIMATE, LANDMARK, SIGHT, TRUE
from nls.plot.trajectory import SHARED, closures, convergence, in_words, mark

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec

    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.missions.solution import TrackErrors
    from nls.missions.sonar.elevation import Elevations
    from nls.optimizers import Result
    from nls.robust.graduated import Rejected
    from nls.values import Values

LEAST = 1e-3  # m; what is below is nothing to see
HIGHEST = 7.5  # inches of the panels
SIDE = 4.2  # inches of the panel of the convergence
VIEWS = ([1, 0], [1, 2])  # from above, east and north; from the side, east and down
SLIM = 0.4  # of the larger side of the map: the least its other side is drawn with
SHADED: dict[str, Any] = {"s": 14, "cmap": "YlOrRd", "vmin": 0.0, "edgecolors": "0.3", "linewidths": 0.4, "zorder": 3}
HOLLOW: dict[str, Any] = {"s": 12, "facecolors": "none", "edgecolors": LANDMARK, "zorder": 3}
POINTS = {"l": ("landmarks", "."), "b": ("beacons", "^")}  # kinds of points, with their names and markers
x, l = kinds("x", "l")


def track(
    values: Values,
    dead: Values,
    truth: Values | None = None,
    marginals: Marginals | None = None,
    errors: Mapping[str, TrackErrors] | None = None,
) -> Figure:
    """The track from above, solved, dead-reckoned and true, with 95 % ellipses; and how far each is off along the way.

    Parameters
    ----------
    values, dead : poses ``x`` of the solution and of dead reckoning.
    truth : true poses.
    marginals : covariances of the solution.
    errors : tracks by what they are called, see `nls.missions.track_of`; their errors are drawn beside the map. With
        marginals the error to be expected is drawn, the root of the trace of the covariance of the position. Without
        errors this is drawn alone.

    Returns
    -------
    matplotlib.figure.Figure
    """
    sure = marginals is not None and marginals.underconstrained is None
    figure = new_figure(11 if errors or sure else 7, 5.8)
    axes = figure.subplots(1, 2 if errors or sure else 1, squeeze=False)[0]
    if truth is not None and "x" in truth.stacks:
        _path(axes[0], truth, color=BELOW, linewidth=5.0, zorder=0, label="truth")
    _path(axes[0], dead, color=BEFORE, linewidth=1.0, linestyle="--", label=_dead_reckoning(dead, values))
    _path(axes[0], values, color=ESTIMATE, linewidth=1.0, label="solution")
    if marginals is not None:
        ellipses(marginals, axes[0], scale=visible_scale(marginals, ["x"]), kind=x, north_up=True)
    name_plane(axes[0], "y, east [m]", "x, north [m]", title="Track from above")
    full_legend(axes[0], 4)
    if errors or sure:
        figure.suptitle(_along(axes[1], values, errors or {}, marginals if sure else None))
    return figure


def _along(axes: Axes, values: Values, errors: Mapping[str, TrackErrors], marginals: Marginals | None) -> str:
    """How far tracks are off along the way, and the error to be expected of the solution; the end of it in words."""
    on = next(iter(errors.values()), None)
    axes.set(title="Along the way", xlabel="distance travelled [m]", ylabel="[m]")
    for (name, error), color in zip(errors.items(), (BEFORE, ESTIMATE), strict=False):
        axes.plot(error.along, error.error, color=color, label=f"{name}, against the {error.against}")
        axes.set_ylabel(f"away from the {error.against} [m]")
    ends = ", ".join(f"{name} {round(error.end, 4):.2g} m" for name, error in errors.items())
    words = "" if on is None else f"{ends} from the {on.against}"
    most = max([LEAST, *(float(error.error.max()) for error in errors.values())])
    along = distance_along(_positions(values)) if on is None else on.along
    if marginals is not None:
        numbers = np.sort(values.stack(x).numbers) if on is None else on.numbers
        sigma = np.sqrt(np.trace(marginals.covariance(x[numbers], view="position"), axis1=1, axis2=2))
        axes.plot(along, sigma, color=ELLIPSE, linestyle=":", label="solution, by its covariance")
        if on is None:
            most, words = max(LEAST, float(sigma.max())), f"the solution is expected to be {sigma[-1]:.2g} m off"
    axes.set_ylim(-0.02 * most, 1.05 * most)  # a line at 0 is seen
    axes.legend(loc="best", fontsize=8)
    # from 1 km three digits would be written as a power of ten
    travelled = f"{along[-1]:,.0f}" if along[-1] >= 1e3 else f"{along[-1]:.3g}"
    return f"After {travelled} m: {words}"


def _dead_reckoning(dead: Values, values: Values) -> str:
    """How dead reckoning is called in the legend: where it is hidden under the solution, it says so."""
    common = x[np.intersect1d(dead.stack(x).numbers, values.stack(x).numbers)]
    p, q = (np.asarray(estimates.stack(x).manifold.position(estimates[common]))[:, :2] for estimates in (dead, values))
    apart = float(np.linalg.norm(p - q, axis=1).max(initial=0.0))
    # what is nearer to another line than 0.003 of the width of the map is under it
    if apart > 0.003 * float(np.ptp(q, axis=0).max(initial=0.0)):
        return "dead reckoning"
    return "dead reckoning (hidden under the solution)"


def landmark_map(
    values: Values, elevations: Elevations, truth: Values | None = None, aperture: float | None = None
) -> Figure:
    """Landmarks from above and from the side, each with the arc of one sigma of its elevation.

    Parameters
    ----------
    values : poses ``x`` and landmarks ``l``.
    elevations : `nls.missions.elevations` at these values; without sigmas the landmarks alone are drawn.
    truth : true landmarks.
    aperture : of the sonar, rad: the colors end at aperture / sqrt(12), what it says of an elevation by itself; at the
        largest sigma when omitted.

    Returns
    -------
    matplotlib.figure.Figure
    """
    points = values[l[elevations.landmarks]]
    known = np.isfinite(elevations.sigma)
    sigma = np.degrees(elevations.sigma)
    most = float(sigma[known].max(initial=0.0) if aperture is None else np.degrees(aperture / np.sqrt(12)))
    reach = (elevations.range * elevations.sigma)[:, None] * elevations.along  # one sigma along the arc, m
    path = _positions(values)
    places = np.concatenate([path, points, (points + reach)[known], (points - reach)[known]])
    figure, panels, _ = _views(*_box(places))
    panels[0].set_title("Landmarks from above")
    for ax, rows in zip(panels, VIEWS, strict=True):
        P = points[:, rows]
        if truth is not None and "l" in truth.stacks:
            ax.plot(*truth[l][:, rows].T, "+", color=TRUE, markersize=5, alpha=0.5, label="truth")
        ax.plot(*path[:, rows].T, color=ESTIMATE, linewidth=0.8, label="track")
        if not known.all():
            unknown = "landmark" if not known.any() else "landmark, elevation free"
            ax.scatter(P[~known, 0], P[~known, 1], label=unknown, **HOLLOW)
        if known.any():
            ends = np.stack([points - reach, points + reach], axis=1)[known][:, :, rows]
            add_lines(ax, ends, color="0.45", linewidth=0.9, label="one sigma of elevation")
            dots = ax.scatter(P[known, 0], P[known, 1], c=sigma[known], vmax=most, label="landmark", **SHADED)
    if known.any():
        label = "elevation at first view known to [deg]"
        label += "" if aperture is None else "; top: by the aperture alone"
        extend = "max" if sigma[known].max() > most else "neither"
        bar = figure.colorbar(dots, ax=list(panels), label=label, extend=extend, aspect=30)
        bar.ax.yaxis.set_major_formatter("{x:g}")
    full_legend(panels[1])
    return figure


def plan(graph: FactorGraph, values: Values) -> Figure:
    """A mission as it was read, from above and from the side: track, landmarks, beacons and, faintly, lines of sight.

    Parameters
    ----------
    graph : whose contacts and ranges are drawn, from pose to landmark or beacon.
    values : poses ``x``; landmarks ``l`` and beacons ``b``, where there are any.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, panels, _ = _views(*_box(_places(values)))
    _plan(panels, values)
    sights, _ = closures(graph, values, {"x", *POINTS})
    for ax, rows in zip(panels, VIEWS, strict=True) if len(sights) else ():
        # from 300 lines on, the more there are, the fainter
        alpha = min(0.3, 90 / len(sights))
        add_lines(ax, sights[:, :, rows], color=SIGHT, linewidth=0.4, alpha=alpha, zorder=1, label="lines of sight")
    panels[0].set_title("From above")
    full_legend(panels[1], 3)
    return figure


def plan_before_after(
    graph: FactorGraph, before: Values, result: Result, title: str = "", rejected: Sequence[Rejected] = ()
) -> Figure:
    """Dead reckoning beside the solution, from above and from the side, and the convergence.

    A thin line leads to each landmark from where it was before. Dead reckoning that is much wider than the solution
    leaves the map.

    Parameters
    ----------
    graph, before, result, title, rejected : as for `nls.plot.before_after`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    values = result.values
    near, far = _box(_places(values)), _box(np.concatenate([_places(before), _places(values)]))
    half = SHARED * (near[1] - near[0]) / 2
    low, high = np.maximum(far[0], sum(near) / 2 - half), np.minimum(far[1], sum(near) / 2 + half)
    figure, panels, grid = _views(low, high, SIDE)
    for ax, rows in zip(panels, VIEWS, strict=True):
        if "l" in values.stacks:
            moved = np.stack([before.stack(l).X, values.stack(l).X], axis=1)[:, :, rows]
            add_lines(ax, moved, color=BEFORE, linewidth=0.7, alpha=0.5, label="landmarks moved")
        label = _dead_reckoning(before, values)
        ax.plot(*_positions(before)[:, rows].T, color=BEFORE, linewidth=1.4, linestyle="--", label=label)
        if rejected:
            wrong = [measurement.keys for measurement in rejected]
            mark(ax, values, wrong, rows, linestyle="--", linewidth=0.8, label=f"{in_words(rejected)}, not in chi2")
    _plan(panels, values)
    chi2 = graph.chi2(before)
    panels[0].set_title(f"chi2 = {number(chi2)} before, {number(result.chi2_final)} after")
    convergence(result, figure.add_subplot(grid[:, 1], box_aspect=0.9), chi2)
    if title:
        figure.suptitle(title)
    full_legend(panels[1], 3)
    return figure


def _plan(panels: tuple[Axes, Axes], values: Values) -> None:
    """Track, landmarks and beacons, in the panels from above and from the side."""
    path = _positions(values)
    for ax, rows in zip(panels, VIEWS, strict=True):
        for kind, (name, style) in POINTS.items():
            if kind in values.stacks:
                points = values.stack(kind).X
                ax.plot(*points[:, rows].T, style, color=LANDMARK, markersize=4, label=f"{len(points):,} {name}")
        ax.plot(*path[:, rows].T, color=ESTIMATE, linewidth=1.6, label=f"track, {len(path):,} poses")
        ax.plot(*path[:1, rows].T, "o", color=ESTIMATE, markersize=5, label="first pose")


def _views(low: Array, high: Array, beside: float = 0.0) -> tuple[Figure, tuple[Axes, Axes], GridSpec]:
    """Two panels for a box at one scale: from above, north up; from the side, z downwards; beside them some inches."""
    north, east, down = high - low
    inch = min(7.5 / east, HIGHEST / (north + down))
    figure = new_figure(inch * east + 2.4 + beside, inch * (north + down) + 2.2)
    widths = [inch * east, beside] if beside else [1.0]
    grid = figure.add_gridspec(2, len(widths), height_ratios=[north, down], width_ratios=widths)
    above = figure.add_subplot(grid[0, 0], ylabel="x, north [m]", xlim=(low[1], high[1]), ylim=(low[0], high[0]))
    side = figure.add_subplot(grid[1, 0], sharex=above, xlabel="y, east [m]", ylabel="z, down [m]")
    side.set(title="from the side, looking north", ylim=(high[2], low[2]))
    for ax in (above, side):
        ax.set_aspect("equal")
    return figure, (above, side), grid


def _places(values: Values) -> Array:
    """Positions (n, 3) of all that `plan` draws."""
    return np.concatenate([_positions(values), *(values.stack(kind).X for kind in POINTS if kind in values.stacks)])


def _positions(values: Values) -> Array:
    """Positions (n, 3) of the poses in the order of their numbers."""
    stack = values.stack(x)
    return np.asarray(stack.manifold.position(stack.X))[np.argsort(stack.numbers)]


def _box(points: Array) -> tuple[Array, Array]:
    """Lower and upper corners (3,) of what is drawn: with a margin, and not too slim in any direction."""
    low, high = points.min(axis=0), points.max(axis=0)
    widest = max(float((high - low)[:2].max()), 1e-3)
    half = np.maximum((high - low) / 2 + 0.03 * widest, widest / 2 * np.array([SLIM, SLIM, 0.15]))
    return (low + high) / 2 - half, (low + high) / 2 + half


def _path(axes: Axes, values: Values, **style: Any) -> None:
    """Poses in the order of their numbers, east to the right and north up."""
    axes.plot(*_positions(values)[:, VIEWS[0]].T, **style)
