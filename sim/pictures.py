"""Estimates and the truth, from above: tracks, and a camera and a sonar that moved past points.

Errors of centimeters in a scene of meters cannot be seen. Every point and camera is drawn where it is, and its error as
a line many times as long. The line has the direction of the error, its color says the size.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from factors.keys import Keys
from models import SE3
from models.alignment import align
from models.errors import OptionError
from nls.plot.picture import add_lines, full_legend, new_figure
from nls.plot.style import BEFORE, BELOW, CLOSURE, ESTIMATE, SERIES, SIGHT, TRUE
from nls.plot.trajectory import closures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    from models.algebra import Array
    from models.sensors import Camera
    from nls.graph import FactorGraph
    from nls.values import Values

MOST_POINTS = 1000  # points with their errors; of more an evenly spaced part is drawn
LONGER = (1, 2, 5, 10, 20, 50, 100)  # how many times as long errors are drawn, up to 0.2 of the width


def against_truth(graph: FactorGraph, truth: Values, estimates: Mapping[str, Values]) -> Figure:
    """One map for each estimate over the truth, wide and gray; its title is the name and the error.

    The error is the root mean square distance of the positions from the true ones. Nothing is aligned.

    Parameters
    ----------
    graph : its loop closures are drawn.
    truth : true poses; other kinds are not drawn.
    estimates : of these poses, by name, such as ``{"dead reckoning": start, "loops closed": result.values}``.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        The truth has no poses.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
    >>> result = world.graph.optimize(world.start)
    >>> figure = sim.against_truth(world.graph, world.truth, {"dead reckoning": world.start, "solution": result.values})
    >>> [axes.get_title() for axes in figure.axes]
    ['dead reckoning: 1.7 m off', 'solution: 0.12 m off']
    """
    shapes = {kind: np.shape(stack.manifold.position(stack.X))[1] for kind, stack in truth.stacks.items()}
    poses = [kind for kind, stack in truth.stacks.items() if 0 < shapes[kind] < stack.manifold.dim and len(stack)]
    if not poses:
        raise OptionError("truth", truth, "values with poses")
    colors = (BEFORE, ESTIMATE, *SERIES[2:])
    # a map is 5.2 inches wide and high
    figure = new_figure(5.2 * len(estimates), 5.2)
    panels = figure.subplots(1, len(estimates), squeeze=False, sharex=True, sharey=True)[0]
    for k, (axes, (name, values)) in enumerate(zip(panels, estimates.items(), strict=True)):
        color = colors[k % len(colors)]
        segments, _ = closures(graph, values, {*truth.stacks})
        add_lines(axes, segments[:, :, :2], color=CLOSURE, linewidth=1.2, alpha=0.8, label="loop closures")
        errors = []
        for stack in map(truth.stack, poses):
            keys = Keys(stack.kind, np.sort(stack.numbers))
            p, q = (np.asarray(stack.manifold.position(those[keys])) for those in (values, truth))
            axes.plot(*q[:, :2].T, color=BELOW, linewidth=7.0, zorder=0, label="truth")
            axes.plot(*p[:, :2].T, color=color, linewidth=2.0)
            axes.plot(*p[0, :2], "o", color=color, markersize=9)
            errors.append(np.sum((p - q) ** 2, axis=1))
        off = np.sqrt(np.mean(np.concatenate(errors)))
        axes.set(xlabel="x [m]", aspect="equal")
        axes.set_title(f"{name}: {off:.2g} m off", fontsize=16, color=color)
    panels[0].set_ylabel("y [m]")
    full_legend(panels[0], 3)
    return figure


def rig_before_after(
    truth: Values, before: Values, after: Values, camera: Camera, changes: Mapping[str, tuple[float, float]]
) -> Figure:
    """Cameras and points from above, raw and optimized side by side, with their errors; and the errors in numbers.

    Parameters
    ----------
    truth, before, after : poses ``x`` in SE3, camera to world, and points ``l`` in R(3), the same in all three. The two
        estimates are moved onto the truth by the rigid alignment of cameras and points together.
    camera : its field of view is drawn.
    changes : by quantity and unit, ``"cameras [cm]"``, its error before and after.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    SingularGeometryError
        Cameras and points on one line; a corner of the image that the distortion gives no ray.
    """
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

    figure = Figure(figsize=(14.5, 6.2))
    figure.set_layout_engine("constrained", wspace=0.04)
    axes = figure.subplots(1, 3, width_ratios=[5, 5, 3.4])
    aligned = [_aligned(values, truth) for values in (before, after)]
    sizes = [np.linalg.norm(np.concatenate(moved) - np.concatenate(_places(truth)), axis=1) for moved in aligned]
    largest = float(np.quantile(np.concatenate(sizes), 0.99)) or 1.0
    wide = float(np.ptp(_places(truth)[1], axis=0).max())
    times = max((t for t in LONGER if t * largest <= 0.2 * wide), default=1)
    norm = LogNorm(largest / 20, largest)
    drawn, count = len(truth.stack("l").X[:: _step(truth, "l", MOST_POINTS)]), len(truth.stack("l"))
    shown = "" if drawn == count else f" of {drawn} of {count} points"
    for ax, name, moved in zip(axes, ("raw", "optimized"), aligned, strict=False):
        lines = _map(ax, truth, moved, camera, times, norm)
        ax.set_title(name, fontsize=15, color=BEFORE if name == "raw" else ESTIMATE, fontweight="bold")
    view = Bbox.union([ax.viewLim for ax in axes[:2]])
    for ax in axes[:2]:
        ax.set(xlim=view.intervalx, ylim=view.intervaly)
    bar = figure.colorbar(lines, ax=axes[:2], location="bottom", extend="both", shrink=0.6, aspect=40, pad=0.02)
    ticks = [t for t in (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0) if largest / 20 < t < largest]
    bar.set_ticks(ticks, labels=[f"{100 * t:g} cm" for t in ticks], minor=False)
    bar.minorticks_off()
    errors = f"error of cameras and points after rigid alignment, drawn {times} times as long"
    bar.set_label(f"{errors}; dots: the truth{shown}")
    _numbers(axes[2], changes)
    return figure


def _places(values: Values) -> tuple[Array, Array]:
    """Positions of cameras and points."""
    return SE3.position(values.stack("x").X), values.stack("l").X


def _aligned(values: Values, truth: Values) -> tuple[Array, Array]:
    """Positions of cameras and points, moved onto the truth."""
    cameras, points = _places(values)
    T = align(np.concatenate(_places(truth)), np.concatenate([cameras, points]))[None]
    return SE3.act(T, cameras), SE3.act(T, points)


def _step(values: Values, kind: str, most: int) -> int:
    """Of every so many variables of a kind one is drawn."""
    return max(1, -(-len(values.stack(kind)) // most))


def _map(
    axes: Axes, truth: Values, moved: tuple[Array, Array], camera: Camera, times: int, norm: LogNorm
) -> LineCollection:
    """One map from above: x to the right, z, ahead of the first camera, up."""
    from matplotlib.collections import LineCollection

    true = _places(truth)
    # the frustum of a camera: 0.08 of the width of the scene
    deep = 0.08 * float(np.ptp(true[1], axis=0).max())
    # at most 20 frusta
    frusta = _frusta(truth.stack("x").X[:: _step(truth, "x", 20)], camera, deep)[..., [0, 2]]
    axes.add_collection(LineCollection(list(frusta), colors=TRUE, linewidths=0.5, alpha=0.6))
    axes.plot(*true[0][:, [0, 2]].T, color=TRUE, linewidth=0.6, alpha=0.4)
    for where, at, step, width in zip(true, moved, (1, _step(truth, "l", MOST_POINTS)), (2.0, 1.1), strict=True):
        where, off = where[::step], (at - where)[::step]
        ends = np.stack([where, where + times * off], axis=1)[..., [0, 2]]
        lines = LineCollection(list(ends), array=np.linalg.norm(off, axis=1), cmap="plasma_r", norm=norm, zorder=3)
        lines.set_linewidth(width)
        axes.add_collection(lines)
        axes.plot(*where[:, [0, 2]].T, ".", color=TRUE, markersize=2.0 * width, markeredgewidth=0, zorder=4)
    axes.set(xlabel="x, right [m]", ylabel="z, ahead [m]")
    axes.set_aspect("equal")
    return lines


def _frusta(X: Array, camera: Camera, deep: float) -> Array:
    """Outlines (n, 11, 3) of fields of view, `deep` m, of cameras X (n, 7); without a size 45 deg to each side."""
    low, high = np.subtract(camera.center, camera.focal), np.add(camera.center, camera.focal)
    if camera.size is not None:
        low, high = np.zeros(2), np.array(camera.size)
    corners, _ = camera.ray([low, [high[0], low[1]], high, [low[0], high[1]]])
    corners, eye = deep * corners / corners[:, 2:], np.zeros((1, 3))
    outline = np.concatenate([eye, corners[[0, 1]], eye, corners[[2, 1]], corners[[2, 3]], eye, corners[[3, 0]]])
    return SE3.act(X[:, None], outline[None])


def _numbers(axes: Axes, changes: Mapping[str, tuple[float, float]]) -> None:
    """One row a quantity: its error before, an arrow, and its error after."""
    arrow = {"arrowstyle": "-|>", "color": SIGHT, "lw": 2, "mutation_scale": 20, "shrinkB": 6}
    for row, (name, (before, after)) in enumerate(changes.items()):
        axes.annotate("", (after, row), (before, row), arrowprops=arrow)
        for value, color in ((before, BEFORE), (after, ESTIMATE)):
            axes.plot(value, row, "o", color=color, markersize=10, zorder=3)
            axes.annotate(
                f"{value:.2g}", (value, row), (0, 11), textcoords="offset points", ha="center", color=color, fontsize=13
            )
        axes.text(0.0, row + 0.36, name, transform=axes.get_yaxis_transform(), fontsize=12, va="center")
    if min(min(pair) for pair in changes.values()) > 0:
        axes.set_xscale("log")
    axes.margins(x=0.15)
    axes.set_axis_off()  # the numbers are there
    axes.set_ylim(len(changes) - 0.4, -0.7)
    axes.set_title("root mean square errors", fontsize=13)
