"""Trajectories and their edges, in the plane or in space; before and after an optimization, and how chi2 fell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from factors import XYH, ZPR, DvlLeg, Gravity
from nls.gauge import placeless_kinds
from nls.plot.picture import add_lines, axes_or_new, figure_of, name_plane, new_figure
from nls.plot.style import CLOSURE, LANDMARK, SERIES, SIGHT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from models.algebra import Array
    from nls.covariance import Marginals
    from nls.graph import FactorGraph
    from nls.optimizers import Result
    from nls.values import Stack, Values

DOWN = (DvlLeg, XYH, ZPR)  # factors whose world has z down
MANY = 300  # lines, from which they are fainter the more there are
PAD = 9.0  # points between the numbers of an axis of space and its name
LEAST = 1e-3  # m, of the widest side
SHARED = 3.0  # times the width of the optimum: so wide the values before may be to be drawn at one scale with it
MOST_EDGES = 20_000  # edges drawn as lines; beyond this an evenly spaced part of them is drawn, and the title says so


def before_after(graph: FactorGraph, before: Values, result: Result, title: str = "") -> Figure:
    """The initial guess, the optimum and the convergence, side by side; the maps have one scale, or say theirs.

    Parameters
    ----------
    graph : its edges are drawn.
    before : the values as they came, from a file or dead reckoning (the optimizer may have had a better start).
    result : after.
    title : of the figure.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = new_figure(11.5, 4.2)
    figure.set_layout_engine("constrained", wspace=0.12)
    space = {"projection": "3d"} if _dimension(_places(graph, result.values)) == 3 else {}
    left, middle = (figure.add_subplot(1, 3, k, **space) for k in (1, 2))
    right = figure.add_subplot(1, 3, 3)
    chi2 = graph.chi2(before)
    trajectory(graph, before, left)
    trajectory(graph, result.values, middle)
    times = one_scale(graph, (left, before), (middle, result.values))
    annotate((left, middle, right), chi2, result, times, title)
    legends = [legend for axes in (left, middle) if (legend := axes.get_legend()) is not None]
    if legends:  # once for both
        names = [text.get_text() for text in legends[0].get_texts()]
        handles = [handle for handle in legends[0].legend_handles if handle is not None]
        figure.legend(handles, names, loc="outside lower left", ncols=4, fontsize=9, frameon=False)
    for legend in legends:
        legend.remove()
    return figure


def annotate(axes: Sequence[Axes], chi2: float, result: Result, times: float, title: str) -> None:
    """Draw the convergence into the last of three axes, and write the titles of all.

    Parameters
    ----------
    axes : the map before, the map after, and where the convergence is drawn.
    chi2 : before.
    result : after.
    times : by how much the map before is drawn smaller.
    title : of the figure; none where it is empty.
    """
    from models.listing import number

    left, middle, right = axes
    left.set_title(f"before: chi2 = {number(chi2)}" + f",\ndrawn {times:.2g} times smaller" * (times > 1))
    middle.set_title(f"after: chi2 = {number(result.chi2_final)}")
    figure = convergence(result, right)
    if not np.isclose(chi2, result.chi2_initial):
        right.set_title(f"{right.get_title()},\nfrom a better start: chi2 = {number(result.chi2_initial)}")
    if title:
        figure.suptitle(title)


def convergence(result: Result, axes: Axes | None = None) -> Figure:
    """chi2 (left axis) and max |dx| (right axis) per iteration, logarithmic; chi2 that falls by less than 10 is linear.

    Parameters
    ----------
    result : of an optimization.
    axes : where; a new figure when omitted.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.ticker import MaxNLocator

    axes = axes_or_new(axes, (5, 4))
    number = [iteration.number for iteration in result.history]
    chi2 = np.array([iteration.chi2 for iteration in result.history])
    # a smaller range has no ticks on a logarithmic axis
    falls = bool((chi2 > 0).all()) and chi2.max() > 10 * chi2.min()
    # a smaller part cannot be read off the number itself
    last = chi2[-1] if np.ptp(chi2) < 1e-3 * chi2.max() else 0.0
    (axes.semilogy if falls else axes.plot)(number, chi2 - last, "o-", color=SERIES[0])
    axes.set_xlabel("iteration")
    axes.set_ylabel(f"chi2 - {last:.6g}" if last else "chi2", color=SERIES[0])  # a legend would cover the curves
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if len(number) > 1:
        twin = axes.twinx()
        twin.semilogy(number[1:], [iteration.update for iteration in result.history[1:]], "s--", color=SERIES[1])
        twin.set_ylabel("max |dx|", color=SERIES[1])
    axes.set_title(f"{result.status.name.lower().replace('_', ' ')} after {result.iterations} iterations")
    return figure_of(axes)


def trajectory(
    graph: FactorGraph,
    values: Values,
    axes: Axes | None = None,
    marginals: Marginals | None = None,
    every: int | None = None,
) -> Figure:
    """Positions in the order of their numbers, and the measurements between positions that are not neighbors.

    Parameters
    ----------
    graph, values : what to draw; kinds without positions are left out.
    axes : where; a new figure when omitted. Space needs axes with ``projection="3d"``.
    marginals : of the same values: positions get their 95 % ellipses, see `ellipses`.
    every : an ellipse on every so many variables of a kind.

    Returns
    -------
    matplotlib.figure.Figure

    Notes
    -----
    A graph with a factor that knows where down is (`ZPR`, `XYH`, `DvlLeg`, `Gravity`) is drawn with z down.
    """

    from matplotlib.lines import Line2D

    from nls.plot.ellipses import ellipses

    stacks = _places(graph, values)
    dim = _dimension(stacks)
    alone = axes is None
    axes = axes_or_new(axes, (6, 6), **({"projection": "3d"} if dim == 3 else {}))
    segments, total = closures(graph, values, {stack.kind for stack in stacks})
    if len(segments):
        points = any(stack.manifold.dim == dim for stack in stacks)
        name, color = ("measurements", SIGHT) if points else ("loop closures", CLOSURE)
        alpha = min(0.3 if points else 0.5, max(0.06, MANY / len(segments)))
        add_lines(axes, segments, color=color, linewidth=0.6, alpha=alpha)
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
    if marginals is not None:
        ellipses(marginals, axes, every=every)
    if dim == 3:
        space_box(axes, _points(graph, values), _is_down(graph))
    else:
        name_plane(axes)
    handles, labels = axes.get_legend_handles_labels()
    if len(segments):  # a line that can be seen, however faint they are
        shown = f", {len(segments)} of {total}" if len(segments) < total else ""
        handles, labels = [Line2D([], [], color=color), *handles], [name + shown, *labels]
    if len(segments) or (marginals is not None and handles):
        if alone:
            figure_of(axes).legend(handles, labels, loc="outside lower center", ncols=2, fontsize=9, frameon=False)
        else:
            axes.legend(handles, labels, loc="best", fontsize=8)
    return figure_of(axes)


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
            space_box(axes, together, _is_down(graph))
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
    axes.set_box_aspect(half.copy(), zoom=0.85)  # type: ignore[call-arg]  # which scales the array in place
    for name, middle, size in zip("xyz", (low + high) / 2, half, strict=True):
        sign = -1 if down and name in "yz" else 1
        axes.set(**{f"{name}lim": (middle - sign * size, middle + sign * size)})
        axis = getattr(axes, f"{name}axis")
        # the widest side has 5 ticks
        axis.set_major_locator(MaxNLocator(max(2, round(5 * size / half.max()))))
    axes.set_xlabel("x [m]", labelpad=PAD)
    axes.set_ylabel("y [m]", labelpad=PAD)
    axes.set_zlabel("z, down [m]" if down else "z [m]")  # type: ignore[attr-defined]
    axes.tick_params(labelsize=7)


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


def _is_down(graph: FactorGraph) -> bool:
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
