"""One wrong loop closure bends a whole map; as its weight goes to zero the map straightens.

The path of `sim.manhattan` with one closure between two places far apart, solved once for every weight.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

import nls
import sim
from factors import Between, Diagonal
from models import SE2
from nls import Values, kinds
from nls.plot.style import ESTIMATE, REJECTED

WEIGHTS = np.concatenate([np.geomspace(1, 2e-3, 21), [0.0]])


def make() -> tuple[list[Figure], list[float]]:
    """Frames and seconds."""
    world = sim.manhattan(np.random.default_rng(1), n_poses=400, closure_ratio=0.15, sigma_t=0.05, sigma_r=0.03)
    (x,) = kinds("x")
    i, j = 60, 331
    values, solved = world.start, []
    values, _, _ = nls.initialize(world.graph, values)
    for w in WEIGHTS[::-1]:  # from the good map on, so that every solution is near the one before
        graph = nls.FactorGraph(world.graph.factors)
        if w > 0:
            sigmas = np.array([0.05, 0.05, 0.03]) / np.sqrt(w)
            graph.add(Between(x[i], x[j], [0.0, 0.0, 0.0], Diagonal(sigmas)))
        values = graph.optimize(values, nls.LevenbergMarquardt()).values
        solved.append((w, values, world.graph.chi2(values)))
    frames = [_drawn(world, *each, i, j) for each in solved[::-1]]
    return frames, [1.5, *[0.12] * (len(frames) - 2), 2.5]


def _drawn(world: sim.World, w: float, values: Values, chi2: float, i: int, j: int) -> Figure:
    figure = Figure(figsize=(8, 4.2))
    place, bars = figure.add_axes((0.01, 0.03, 0.58, 0.88)), figure.add_axes((0.7, 0.36, 0.2, 0.55))
    X, T = values.stack("x").X, world.truth.stack("x").X
    X = SE2.compose(SE2.compose(T[0], SE2.inverse(X[0])), X)
    place.plot(*T[:, :2].T, color="0.85", linewidth=4, label="truth")
    place.plot(*X[:, :2].T, color=ESTIMATE, linewidth=1.2, label="map")
    place.plot(
        *X[[i, j], :2].T, "o-", color=REJECTED, linewidth=2, alpha=0.2 + 0.8 * bool(w), label="the wrong closure"
    )
    low, high = T[:, :2].min(axis=0) - 1.5, T[:, :2].max(axis=0) + 1.5
    place.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[], aspect="equal")
    figure.legend(*place.get_legend_handles_labels(), loc="lower right", bbox_to_anchor=(0.96, 0.04), frameon=False)
    error = np.sqrt(np.mean(np.sum((X - T)[:, :2] ** 2, axis=1)))
    place.set_title(f"weight of the wrong closure: {w:.2g}" if w else "the wrong closure is gone")
    dof = 3 * (sum(map(len, world.graph.factors)) - len(X) + 1)
    bars.bar([0], [chi2 / dof], color=ESTIMATE)
    bars.axhline(1, color="0.65", linestyle="--", linewidth=1.5)
    bars.text(1.05, 1, "expected", transform=bars.get_yaxis_transform(), va="center", fontsize=9, color="0.4")
    bars.set(xticks=[], ylim=(0.5, 200), yscale="log", ylabel="chi2 / dof of the others")
    bars.minorticks_off()
    bars.set_title(f"{error:.1f} m off")
    return figure
