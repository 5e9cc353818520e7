"""A mission from above and from the side: as it was read, solved beside dead reckoning, and its open elevations.

Maps are charts: north (x) up, east (y) to the right. Side views look north, z, which is down, downwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from factors.keys import kinds
from models.algebra import Array, distance_along
from nls.plot.ellipses import ellipses, visible_scale
from nls.plot.style import BEFORE, ELLIPSE, ESTIMATE, LANDMARK, SIGHT, TRUE
from nls.plot.trajectory import SHARED, annotate, closures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.missions.solution import TrackErrors
    from nls.missions.sonar.elevation import Elevations
    from nls.optimizers import Result
    from nls.values import Values

LEAST = 1e-3  # m; what is below is nothing to see
HIGHEST = 7.5  # inches of the panels
SIDE = 4.2  # inches of the widest of three panels side by side
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
    from matplotlib.figure import Figure

    sure = marginals is not None and marginals.underconstrained is None
    figure = Figure(figsize=(11, 5.8) if errors or sure else (7, 5.8), layout="constrained")
    axes = figure.subplots(1, 2 if errors or sure else 1, squeeze=False)[0]
    _path(axes[0], dead, color=BEFORE, linewidth=1.0, linestyle="--", label=_dead_reckoning(dead, values))
    if truth is not None and "x" in truth.stacks:
        _path(axes[0], truth, color=TRUE, linewidth=2.4, alpha=0.35, label="truth")
    _path(axes[0], values, color=ESTIMATE, linewidth=1.0, label="solution")
    if marginals is not None:
        ellipses(marginals, axes[0], scale=visible_scale(marginals, ["x"]), kind=x, north_up=True)
    axes[0].set(xlabel="y, east [m]", ylabel="x, north [m]", title="Track from above")
    axes[0].set_aspect("equal", adjustable="datalim")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower left", ncols=4, fontsize=8)
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
    from matplotlib.collections import LineCollection

    points = values[l[elevations.landmarks]]
    known = np.isfinite(elevations.sigma)
    sigma = np.degrees(elevations.sigma)
    most = float(sigma[known].max(initial=0.0) if aperture is None else np.degrees(aperture / np.sqrt(12)))
    reach = (elevations.range * elevations.sigma)[:, None] * elevations.along  # one sigma along the arc, m
    path = _positions(values)
    figure, panels = _views(np.concatenate([path, points, (points + reach)[known], (points - reach)[known]]))
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
            ax.add_collection(LineCollection(list(ends), colors="0.45", linewidths=0.9, label="one sigma of elevation"))
            dots = ax.scatter(P[known, 0], P[known, 1], c=sigma[known], vmax=most, label="landmark", **SHADED)
    if known.any():
        label = "elevation at first view known to [deg]"
        label += "" if aperture is None else "; top: by the aperture alone"
        extend = "max" if sigma[known].max() > most else "neither"
        bar = figure.colorbar(dots, ax=list(panels), label=label, extend=extend, aspect=30)
        bar.ax.yaxis.set_major_formatter("{x:g}")
    figure.legend(*panels[1].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
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
    figure, panels = _views(_places(values))
    _plan(panels, graph, values)
    panels[0].set_title("From above")
    _legend(figure, panels[1])
    return figure


def plan_before_after(graph: FactorGraph, before: Values, result: Result, title: str = "") -> Figure:
    """`plan` before and after, and the convergence; the maps have one scale, or the first says its own.

    Parameters
    ----------
    graph, before, result, title : as for `nls.plot.before_after`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure

    places = [_places(before), _places(result.values)]
    first, second = map(_box, places)
    times = float(np.max((first[1] - first[0]) / (second[1] - second[0])))
    if times > SHARED:
        half = times * (second[1] - second[0]) / 2
        first = sum(first) / 2 - half, sum(first) / 2 + half
    else:
        times, first = 1.0, _box(np.concatenate(places))
        second = first
    north, east, down = second[1] - second[0]
    inch = min(SIDE / east, HIGHEST / (north + down))
    figure = Figure(figsize=(2 * inch * east + 2.6 + SIDE, inch * (north + down) + 2.4), layout="constrained")
    grid = figure.add_gridspec(2, 3, height_ratios=[north, down], width_ratios=[inch * east, inch * east, SIDE])
    columns = []
    for k, (box, values) in enumerate(((first, before), (second, result.values))):
        above = figure.add_subplot(grid[0, k])
        columns.append((above, figure.add_subplot(grid[1, k], sharex=above)))
        _chart(columns[k], *box)
        _plan(columns[k], graph, values)
    right = figure.add_subplot(grid[:, 2])
    annotate((columns[0][0], columns[1][0], right), graph.chi2(before), result, times, title)
    _legend(figure, columns[1][1])
    return figure


def _plan(panels: tuple[Axes, Axes], graph: FactorGraph, values: Values) -> None:
    """Track, landmarks, beacons and lines of sight, in the panels from above and from the side."""
    from matplotlib.collections import LineCollection

    path = _positions(values)
    sights, _ = closures(graph, values, {"x", *POINTS})
    # from 500 lines on, the more there are, the fainter
    sight = {"colors": SIGHT, "alpha": min(0.5, 250 / max(len(sights), 1))}
    for ax, rows in zip(panels, VIEWS, strict=True):
        ax.add_collection(LineCollection([ends[:, rows] for ends in sights], linewidths=0.4, zorder=1, **sight))
        for kind, (name, style) in POINTS.items():
            if kind in values.stacks:
                points = values.stack(kind).X
                ax.plot(*points[:, rows].T, style, color=LANDMARK, markersize=4, label=f"{len(points):,} {name}")
        ax.plot(*path[:, rows].T, color=ESTIMATE, linewidth=1.6, label=f"track, {len(path):,} poses")
        ax.plot(*path[:1, rows].T, "o", color=ESTIMATE, markersize=5, label="first pose")


def _legend(figure: Figure, axes: Axes) -> None:
    """Below the figure: the lines of one panel of `_plan`, and those of sight, which are too faint for a legend."""
    from matplotlib.collections import LineCollection

    handles, labels = axes.get_legend_handles_labels()
    if any(len(lines.get_paths()) for lines in axes.collections):
        handles.append(LineCollection([], colors=SIGHT))
        labels.append("lines of sight")
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8)


def _views(points: Array) -> tuple[Figure, tuple[Axes, Axes]]:
    """Two panels for points (n, 3) at one scale: from above, north up; from the side, z downwards."""
    from matplotlib.figure import Figure

    low, high = _box(points)
    north, east, down = high - low
    inch = min(7.5 / east, HIGHEST / (north + down))
    figure = Figure(figsize=(inch * east + 2.4, inch * (north + down) + 2.2), layout="constrained")
    above, beside = figure.subplots(2, 1, sharex=True, height_ratios=[north, down])
    _chart((above, beside), low, high)
    return figure, (above, beside)


def _chart(panels: tuple[Axes, Axes], low: Array, high: Array) -> None:
    """Names, limits and directions of the axes of two panels for a box: from above, north up; from the side, z down."""
    above, beside = panels
    above.set(ylabel="x, north [m]", xlim=(low[1], high[1]), ylim=(low[0], high[0]))
    beside.set(title="from the side, looking north", xlabel="y, east [m]", ylabel="z, down [m]", ylim=(high[2], low[2]))
    for ax in panels:
        ax.set_aspect("equal")


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
