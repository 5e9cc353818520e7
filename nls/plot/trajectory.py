"""Trajectories and their edges, in the plane or in space; before and after an optimization, and how chi2 fell."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from factors import XYH, ZPR, DvlLeg, Gravity
from models.listing import number, several
from nls.gauge import placeless_kinds
from nls.plot.picture import add_lines, axes_or_new, figure_of, full_legend, name_plane, new_figure
from nls.plot.style import BEFORE, CLOSURE, ECHO, ESTIMATE, LANDMARK, REJECTED, SERIES, SIGHT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from factors.keys import Keys
    from models.algebra import Array
    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.optimizers import Result
    from nls.robust.graduated import Rejected
    from nls.values import Stack, Values

DOWN = (DvlLeg, XYH, ZPR)  # factors whose world has z down
MANY = 300  # lines, from which they are fainter the more there are
PAD = 1.0  # points between the numbers of an axis of space and its name
LEAST = 1e-3  # m, of the widest side
SHARED = 3.0  # times the width of the optimum: so wide the values before may be to be drawn at one scale with it
MOST_EDGES = 20_000  # edges drawn as lines; beyond this an evenly spaced part of them is drawn, and the title says so


def before_after(
    graph: FactorGraph, before: Values, result: Result, title: str = "", rejected: Sequence[Rejected] = ()
) -> Figure:
    """The initial guess, the optimum and the convergence, side by side; the maps have one scale, or say theirs.

    Parameters
    ----------
    graph : its edges are drawn.
    before : the values as they came, from a file or dead reckoning (the optimizer may have had a better start).
    result : after.
    title : of the figure.
    rejected : measurements that `nls.gnc` has rejected, dashed and red on both maps.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = new_figure(11.5, 4.2)
    figure.set_layout_engine("constrained", wspace=0.08)
    space = {"projection": "3d"} if _dimension(_places(graph, result.values)) == 3 else {}
    left, middle = (figure.add_subplot(1, 3, k, **space) for k in (1, 2))
    right = figure.add_subplot(1, 3, 3)
    chi2 = graph.chi2(before)
    for axes, values in ((left, before), (middle, result.values)):
        named = _map(graph, values, axes, rejected)
    times = one_scale(graph, (left, before), (middle, result.values))
    left.set_title(f"before: chi2 = {number(chi2)}" + f",\ndrawn {times:.2g} times smaller" * (times > 1))
    middle.set_title(f"after: chi2 = {number(result.chi2_final)}")
    convergence(result, right, chi2)
    if title:
        figure.suptitle(title)
    if named:
        full_legend(middle, 4)
    return figure


def convergence(result: Result, axes: Axes | None = None, before: float | None = None) -> Figure:
    """chi2 by iteration, on a logarithmic axis from that of the values as they came to the optimum; its expectation.

    Parameters
    ----------
    result : of an optimization.
    axes : where; a new figure when omitted.
    before : chi2 of the values as they came; the optimizer may have had a better start.

    Returns
    -------
    matplotlib.figure.Figure

    Notes
    -----
    The expectation of chi2 at the optimum is the number of degrees of freedom; a robust cost has none. chi2 below a
    millionth of the expectation is rounding, and is drawn there.
    """
    from matplotlib.ticker import MaxNLocator, NullFormatter

    axes = axes_or_new(axes, (5, 4))
    steps = [iteration.number for iteration in result.history]
    chi2 = [iteration.chi2 for iteration in result.history]
    least, expected = 1e-6 * max(result.dof, 1), 0 if result.robust else max(result.dof, 0)
    labels = {steps[0]: (chi2[0], ""), steps[-1]: (chi2[-1], "")}
    if before is not None and not np.isclose(before, chi2[0]):
        axes.plot([-1, 0], np.maximum([before, chi2[0]], least), "o:", color=BEFORE)
        labels[-1] = before, " before"
    axes.plot(steps, np.maximum(chi2, least), "o-", color=ESTIMATE)
    for step, (value, word) in labels.items():
        height = expected if value < expected < 2 * value else max(value, least)  # above the line of the expectation
        style: dict[str, Any] = {"textcoords": "offset points", "color": BEFORE if word else ESTIMATE}
        axes.annotate(number(value) + word, (step, height), (3, 5), **style)
    heights = np.maximum([*chi2, *(value for value, _ in labels.values()), expected or chi2[-1]], least)
    if expected:
        axes.axhline(expected, color=ECHO, linestyle="--", zorder=0)
        near = 2 * chi2[-1] > expected  # the words are below the line and the last point, or above the line
        style = {"xycoords": axes.get_yaxis_transform(), "textcoords": "offset points", "color": "0.4", "ha": "right"}
        place, off, side = ((1, min(expected, chi2[-1])), -6, "top") if near else ((1, expected), 3, "bottom")
        axes.annotate(f"{number(expected)} expected", place, (-4, off), va=side, **style)
    middle, half = np.sqrt(heights.min() * heights.max()), max(np.sqrt(heights.max() / heights.min()), 3.0) ** 1.2
    axes.set(yscale="log", ylim=(middle / half, middle * half), ylabel="robust cost" if result.robust else "chi2")
    axes.set(xlabel="iteration", xlim=(min(labels) - 0.2, 1.15 * steps[-1] + 0.6))
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.xaxis.set_major_formatter(lambda k, _: f"{k:.0f}" if k >= 0 else "")
    axes.yaxis.set_minor_formatter(NullFormatter())
    ended = f"{result.status.name.lower().replace('_', ' ')} after {several(result.iterations, 'iteration')}"
    axes.set_title(ended if result.iterations or not result.converged else "0 more iterations")
    return figure_of(axes)


def trajectory(
    graph: FactorGraph,
    values: Values,
    axes: Axes | None = None,
    marginals: Marginals | None = None,
    every: int | None = None,
    rejected: Sequence[Rejected] = (),
) -> Figure:
    """Positions in the order of their numbers, and the measurements between positions that are not neighbors.

    Parameters
    ----------
    graph, values : what to draw; kinds without positions are left out.
    axes : where; a new figure when omitted. Space needs axes with ``projection="3d"``.
    marginals : of the same values: positions get their 95 % ellipses, see `ellipses`.
    every : an ellipse on every so many variables of a kind.
    rejected : measurements that `nls.gnc` has rejected, dashed and red.

    Returns
    -------
    matplotlib.figure.Figure

    Notes
    -----
    A graph with a factor that knows where down is (`ZPR`, `XYH`, `DvlLeg`, `Gravity`) is drawn with z down.
    """
    from nls.plot.ellipses import ellipses

    alone = axes is None
    space = _dimension(_places(graph, values)) == 3
    axes = axes_or_new(axes, (6, 6), **({"projection": "3d"} if space else {}))
    named = _map(graph, values, axes, rejected)
    if marginals is not None:
        ellipses(marginals, axes, every=every)
        named = True
    if named and axes.get_legend_handles_labels()[0]:
        full_legend(axes, outside=alone)
    return figure_of(axes)


def _map(graph: FactorGraph, values: Values, axes: Axes, rejected: Sequence[Rejected]) -> bool:
    """Draw tracks, points and measurements; whether there are lines that need a legend."""
    stacks = _places(graph, values)
    dim = _dimension(stacks)
    segments, total = closures(graph, values, {stack.kind for stack in stacks})
    if len(segments):
        points = any(stack.manifold.dim == dim for stack in stacks)
        name, color = ("measurements", SIGHT) if points else ("loop closures", CLOSURE)
        name += f", {len(segments)} of {total}" * (len(segments) < total)
        alpha = (0.2 if points else 0.8) * min(1.0, max(0.08, MANY / len(segments)))
        add_lines(axes, segments, color=color, linewidth=0.6 if points else 0.9, alpha=alpha, label=name)
    tracks = [stack.kind for stack in stacks if stack.manifold.dim > dim]
    for stack in stacks:
        X = _positions(stack)[np.argsort(stack.numbers)]
        if X.shape[1] != dim:
            continue
        if stack.manifold.dim > dim:
            label = f"trajectory {stack.kind}" if len(tracks) > 1 else "trajectory"
            own = SERIES[tracks.index(stack.kind) % len(SERIES)]
            axes.plot(*X.T, color=own, linewidth=1.0, label=label)
            axes.plot(*X[:1].T, "o", color=own, markersize=5)
        else:
            axes.plot(*X.T, "*", color=LANDMARK, markersize=5, label=stack.kind)
    if rejected:
        label = f"{in_words(rejected)}, not in chi2"
        mark(axes, values, [measurement.keys for measurement in rejected], linestyle="--", label=label)
    if dim == 3:
        space_box(axes, _points(graph, values), is_down(graph))
    else:
        name_plane(axes)
    return bool(len(segments) or rejected)


def in_words(rejected: Sequence[Rejected]) -> str:
    """How many loop closures were rejected, or measurements where some are of another kind."""
    closing = all(len({key.kind for key in measurement.keys}) == 1 < len(measurement.keys) for measurement in rejected)
    return f"{several(len(rejected), 'loop closure' if closing else 'measurement')} rejected"


def mark(
    axes: Axes, values: Values, measurements: Iterable[tuple[Keys, ...]], view: Sequence[int] = (), **style: Any
) -> None:
    """Draw a red line through the places of the variables of each measurement; all in one piece.

    `view` says which coordinates the axes show; all of them when omitted.
    """
    view = view or (0, 1, 2)[: 3 if axes.name == "3d" else 2]
    pieces = [np.zeros((0, len(view)))]
    for keys in measurements:
        stacks = [values.stack(key.kind) for key in keys]
        ends = [s.manifold.position(s.X[s.index(key)]) for s, key in zip(stacks, keys, strict=True)]
        pieces += [*(end[:, view] for end in ends if end.shape[1] > max(view)), np.full((1, len(view)), np.nan)]
    alpha = max(0.25, min(1.0, 40 / len(pieces)))
    axes.plot(*np.concatenate(pieces).T, color=REJECTED, marker=".", zorder=5, alpha=alpha, **style)


def one_scale(graph: FactorGraph, before: tuple[Axes, Values], after: tuple[Axes, Values]) -> float:
    """Give two maps that `trajectory` has drawn the same limits, unless the second would be too small to be seen.

    Returns
    -------
    float
        By how much the first is drawn smaller; 1 where the limits are the same.
    """
    points = [_points(graph, values) for _, values in (before, after)]
    first, second = (float(np.ptp(X, axis=0).max(initial=0.0)) if len(X) else 0.0 for X in points)
    if first > SHARED * second > 0:
        return first / second
    together = np.concatenate(points)
    for axes, _ in (before, after) if len(together) else ():
        if together.shape[1] == 3:
            space_box(axes, together, is_down(graph))
            continue
        axes.update_datalim(together)
        axes.autoscale_view()
    return 1.0


def space_box(axes: Axes, points: Array, down: bool) -> None:
    """One scale for all axes, a box around the points (n, 3) that is not too flat, ticks that fit its sides, and names.

    With z down, y grows to the front: x, y, z are right-handed then, too.
    """
    from matplotlib.ticker import MaxNLocator

    low, high = points.min(axis=0), points.max(axis=0)
    widest = max(float((high - low).max()), LEAST)
    # the sides of a box in space have at least 0.15 of the widest
    half = np.maximum(0.52 * (high - low), 0.15 / 2 * widest)
    # width and height of the box as it is seen from 30 deg above: the larger one fills the axes
    extent = max(half @ [1.0, 0.58, 0.0], half @ [0.25, 0.43, 0.87])
    zoom = float(np.linalg.norm(half) / extent)
    axes.set_box_aspect(half.copy(), zoom=zoom)  # type: ignore[call-arg]  # which scales the array in place
    for name, middle, size in zip("xyz", (low + high) / 2, half, strict=True):
        sign = -1 if down and name in "yz" else 1
        axes.set(**{f"{name}lim": (middle - sign * size, middle + sign * size)})
        axis = getattr(axes, f"{name}axis")
        # the widest side has 5 ticks
        axis.set_major_locator(MaxNLocator(max(2, round(5 * size / half.max()))))
    axes.set_xlabel("x [m]", labelpad=PAD)
    axes.set_ylabel("y [m]", labelpad=PAD)
    axes.set_zlabel("z, down [m]" if down else "z [m]", labelpad=-6)  # type: ignore[attr-defined]
    axes.tick_params(labelsize=7, pad=-2)


def _positions(stack: Stack) -> Array:
    """Positions (n, 2 or 3) of the variables of a kind; (n, 0) of those that have none."""
    return np.asarray(stack.manifold.position(stack.X))


def _dimension(stacks: Sequence[Stack]) -> int:
    """Of the space of some variables, 2 or 3."""
    return max((_positions(stack).shape[1] for stack in stacks), default=2)


def _places(graph: FactorGraph, values: Values) -> list[Stack]:
    """Variables that have a position on the map."""
    without = placeless_kinds(graph.pattern(values))
    return [stack for kind, stack in values.stacks.items() if kind not in without and _positions(stack).shape[1]]


def _points(graph: FactorGraph, values: Values) -> Array:
    """Positions (n, 2 or 3) of all that `trajectory` draws."""
    stacks = _places(graph, values)
    dim = _dimension(stacks)
    return np.concatenate([np.zeros((0, dim)), *(_positions(stack) for stack in stacks if _dimension([stack]) == dim)])


def is_down(graph: FactorGraph) -> bool:
    """Whether the graph knows where down is, and z is down."""
    return any(isinstance(f, DOWN) or (isinstance(f, Gravity) and f.down[2] > 0) for f in graph.factors)


def closures(graph: FactorGraph, values: Values, kinds: set[str]) -> tuple[Array, int]:
    """Segments (k, 2, dim) of measurements between variables that are not neighbors in number, and their count."""
    out = []
    for factor in graph.factors:
        if len(factor.keys) != 2 or not {key.kind for key in factor.keys} <= kinds:
            continue
        i, j = factor.keys
        low, high = np.minimum(i.numbers, j.numbers), np.maximum(i.numbers, j.numbers)
        apart = (i.kind != j.kind) | (high - 1 != low)  # high - low could be beyond int64
        points = [values.stack(key.kind).manifold.position(values[key[apart]]) for key in (i, j)]
        if points[0].shape[1] == points[1].shape[1] > 0:
            out.append(np.stack(points, axis=1))
    if not out:
        return np.zeros((0, 2, 2)), 0
    segments = np.concatenate(out)
    return segments[:: max(1, -(-len(segments) // MOST_EDGES))], len(segments)
