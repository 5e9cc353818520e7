"""Estimates beside the truth, one map each, with their errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from factors.keys import Keys
from nls.plot.picture import add_lines, full_legend, new_figure
from nls.plot.style import BEFORE, BELOW, CLOSURE, ESTIMATE, SERIES
from nls.plot.trajectory import closures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from nls.graph import FactorGraph
    from nls.values import Values


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

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.plot import against_truth
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
    >>> result = world.graph.optimize(world.start)
    >>> figure = against_truth(world.graph, world.truth, {"dead reckoning": world.start, "solution": result.values})
    >>> [axes.get_title() for axes in figure.axes]
    ['dead reckoning: 1.7 m off', 'solution: 0.12 m off']
    """
    # a map is 5.2 inches wide and high
    figure = new_figure(5.2 * len(estimates), 5.2)
    panels = figure.subplots(1, len(estimates), squeeze=False, sharex=True, sharey=True)[0]
    for axes, (name, values), color in zip(panels, estimates.items(), (BEFORE, ESTIMATE, *SERIES[2:]), strict=False):
        segments, _ = closures(graph, values, {*truth.stacks})
        add_lines(axes, segments[:, :, :2], color=CLOSURE, linewidth=1.2, alpha=0.8, label="loop closures")
        errors = []
        for kind, stack in truth.stacks.items():
            keys = Keys(kind, np.sort(stack.numbers))
            p, q = (np.asarray(stack.manifold.position(poses[keys])) for poses in (values, truth))
            if p.shape[1] == stack.manifold.dim:  # a point
                continue
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
