"""A crumpled ball of poses unfolds into a sphere in a few Gauss-Newton steps, and chi2 falls from ten million to what
noise alone would leave.

The start is the odometry of `sim.sphere`. Each frame stands between two iterates, X retracted by a part of the step.
"""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

import nls
import sim
from models import SE3
from nls.plot.style import CLOSURE, ESTIMATE

TURN, TILT = np.radians(-60), np.radians(20)  # of the view; without perspective
VIEW = np.array(
    [
        [-np.sin(TURN), -np.cos(TURN) * np.sin(TILT)],
        [np.cos(TURN), -np.sin(TURN) * np.sin(TILT)],
        [0.0, np.cos(TILT)],
    ]
)
STEPS, PARTS = 5, np.linspace(0, 1, 5)[1:-1]


def make() -> tuple[list[Figure], list[float]]:
    """Frames and seconds."""
    world = sim.sphere(np.random.default_rng(3), rings=16, per_ring=24, sigma_r=0.05)
    one = nls.GaussNewton(nls.Stop(max_iterations=1))
    values, frames, seconds, chi2 = world.start, [], [], []
    for step in range(STEPS + 1):
        X = values.stack("x").X
        chi2.append(world.graph.chi2(values))
        frames.append(_drawn(world, X, chi2, f"step {step}"))
        seconds.append(0.9)
        if step < STEPS:
            values = world.graph.optimize(values, one).values
            delta = SE3.local(X, values.stack("x").X)
            for part in PARTS:
                frames.append(_drawn(world, SE3.retract(X, part * delta), chi2, f"step {step} to {step + 1}"))
                seconds.append(0.15)
    seconds[0], seconds[-1] = 1.5, 3.0
    return frames, seconds


def _drawn(world: sim.World, X: np.ndarray, chi2: list[float], title: str) -> Figure:
    figure = Figure(figsize=(8, 4.2))
    ball = figure.add_axes((0.0, 0.0, 0.52, 0.92))
    fall = figure.add_axes((0.63, 0.13, 0.35, 0.77))
    P = SE3.position(X)
    P = (P - P.mean(axis=0)) @ VIEW
    _, closures = world.graph.factors
    ends = np.stack([P[keys.numbers] for keys in closures.keys], axis=1)
    ball.add_collection(LineCollection(list(ends), color=CLOSURE, linewidth=0.6, alpha=0.6))
    ball.plot(*P.T, color=ESTIMATE, linewidth=0.9)
    ball.set(xlim=(-62, 62), ylim=(-62, 62), xticks=[], yticks=[], aspect="equal")
    ball.set_axis_off()
    ball.set_title(title)
    fall.semilogy(chi2, "o-", color=ESTIMATE)
    dof = 6 * (sum(map(len, world.graph.factors)) - len(P) + 1)
    fall.axhline(dof, color="0.5", linestyle="--", linewidth=1)
    fall.text(STEPS, 0.8 * dof, "expected of noise alone", ha="right", va="top", color="0.4")
    fall.set(xlim=(-0.3, STEPS + 0.3), ylim=(dof / 4, 3 * chi2[0]), xlabel="step", title=f"chi2 = {chi2[-1]:,.0f}")
    fall.set_yticks([10.0**k for k in range(3, 8)], ["10³", "10⁴", "10⁵", "10⁶", "10⁷"])  # mathtext is slow
    fall.minorticks_off()
    return figure
