"""A camera and a sonar calibrated on the fly: errors before and after, and whether what was predicted is what happens.

    python benchmarks/evidence/rig.py [--seeds 20] [--sigma-seeds 100] [--out DIR]

The reference scene `sim.rig`, seeds 0, 1, 2, ...: 20 poses, 600 points, uniform noise. Every number names its
alignment.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from script import Table, make_page, markdown

import sim
from models import SE3
from models.algebra import Array
from nls import GaussNewton, LevenbergMarquardt, UnderconstrainedError, Values, kinds
from nls.analysis import Motions, Observability, helpful_motions, observability
from nls.filters.consistency import nees_bounds
from nls.optimizers import Optimizer
from nls.starts import rig as start_of
from sim.camera_sonar import Rig

Start = Callable[[Rig, int], Values]
x, s = kinds("x", "s")


def turned(world: Rig, seed: int) -> Values:
    """The start from a guess of the sonar that is turned by 90 deg more, about a random axis through the sonar."""
    axis = np.random.default_rng([seed, 90]).normal(size=3)
    guess = world.start.copy()
    guess[s[0]] = SE3.compose(guess[s[0]], SE3.exp([0, 0, 0, *(np.pi / 2 * axis / np.linalg.norm(axis))]))
    return start_of(world.graph, guess)


STARTS: dict[str, Start] = {
    "guess 5 cm and 3 deg wrong": lambda world, seed: world.start,
    "guess 5 cm and 90 deg wrong": turned,
    "the first guess, poses from three points": lambda world, seed: start_of(
        world.graph, world.start, three_points=True
    ),
    "no guess, from the measurements": lambda world, seed: start_of(world.graph, world.start, calibrate=True),
}
OPTIMIZERS: dict[str, Optimizer] = {"Gauss-Newton": GaussNewton(), "Levenberg-Marquardt": LevenbergMarquardt()}
BOTH = next(iter(STARTS))  # the start from which both optimizers are tried


@dataclass
class Run:
    """One seed, one start, one optimizer."""

    status: str
    iterations: int
    chi2_dof: float
    before: Array
    after: Array
    values: Values | None


def errors(world: Rig, values: Values) -> Array:
    """Cameras, points, cameras with nothing aligned, sonar: cm; sonar: deg."""
    found = world.errors(values)
    away = np.linalg.norm(SE3.position(values[x]) - SE3.position(world.truth[x]), axis=1)
    meters = [found.poses, found.points, np.sqrt(np.mean(away[1:] ** 2)), found.extrinsic_m]
    return np.array([*(100 * np.array(meters)), np.degrees(found.extrinsic_rad)])


def run(world: Rig, start: Values, optimizer: Optimizer) -> Run:
    """Optimize from a start; a system that is singular on the way is a status too."""
    before = errors(world, start)
    try:
        result = world.graph.optimize(start, optimizer)
    except UnderconstrainedError:
        return Run("UNDERCONSTRAINED", 0, np.nan, before, np.full(len(before), np.nan), None)
    after = errors(world, result.values)
    return Run(result.status.name, result.iterations, result.chi2_final / world.dof, before, after, result.values)


def mean_most(numbers: Array, digits: int) -> str:
    """Mean, and the largest."""
    return f"{np.nanmean(numbers):.{digits}f} ({np.nanmax(numbers):.{digits}f})"


def row(start: str, optimizer: str, runs: list[Run]) -> list[str]:
    """Cells of one line of the first table."""
    before, after = np.array([r.before for r in runs]).T, np.array([r.after for r in runs]).T
    status = ", ".join(f"{n} {word}" for word, n in Counter(r.status for r in runs).most_common())
    ratio = np.array([r.chi2_dof for r in runs])
    cells = [start, optimizer]
    cells += [f"{b.mean():.2f} -> {mean_most(a, 2)}" for b, a in zip(before, after, strict=True)]
    cells += [f"{np.nanmean(ratio):.4f} ({np.nanmin(ratio):.3f}-{np.nanmax(ratio):.3f})"]
    return [*cells, mean_most(np.array([r.iterations for r in runs], dtype=float), 1), status]


def consistency_table(told: list[Observability], e: Array) -> list[str]:
    """Predicted and observed sigma of the sonar's place; e (seeds, 6) are its errors."""
    predicted, observed = np.mean([t.sigma for t in told], axis=0), np.sqrt(np.mean(np.square(e), axis=0))
    titles = ["component", "predicted at the truth", "observed (rms error)", "observed / predicted"]
    table = Table([*titles, "compared, predicted", "compared, observed"])
    for k, name in enumerate(told[0].components):
        unit, size, group = ("mm", 1e3, slice(0, 3)) if k < 3 else ("deg", np.degrees(1.0), slice(3, 6))
        best = group.start + int(np.argmin(predicted[group]))
        sizes = [f"{size * sigma[k]:.3g} {unit}" for sigma in (predicted, observed)]
        compared = [f"{sigma[k] / sigma[best]:.1f} x {told[0].components[best]}" for sigma in (predicted, observed)]
        table.add(name, *sizes, f"{observed[k] / predicted[k]:.2f}", *compared)
    return table


@dataclass
class Sigmas:
    """One seed: what is predicted at the truth, the error of the sonar's place (6,), and e' P^-1 e at the estimate."""

    told: Observability
    e: Array
    nees: float


def sigmas(seed: int) -> Sigmas:
    """Gauss-Newton from the guess that is little wrong."""
    world = sim.rig(np.random.default_rng(seed))
    values = world.graph.optimize(world.start, GaussNewton()).values
    e = SE3.local(values[s[0]], world.truth[s[0]])
    P = observability(world.graph, values, s[0]).covariance
    return Sigmas(observability(world.graph, world.truth, s[0]), e, float(e @ np.linalg.solve(P, e)))


def motions_table(found: Motions) -> list[str]:
    """Sigma before / after, a row a motion."""
    rows = ([m.name, *(f"{g:.3f}" for g in m.gain)] for m in found.ranking)
    return markdown(["one more view after", *found.before.components], rows)


def before_and_after(seeds: int) -> list[str]:
    """All starts."""
    runs: dict[tuple[str, str], list[Run]] = {}
    for seed in range(seeds):
        world = sim.rig(np.random.default_rng(seed))
        for start, make in STARTS.items():
            values = make(world, seed)
            for name, optimizer in OPTIMIZERS.items():
                if start == BOTH or name == "Gauss-Newton":
                    runs.setdefault((start, name), []).append(run(world, values, optimizer))
        print(f"seed {seed}", flush=True)
    same = max(
        float(np.abs(SE3.local(r.values[s[0]], b.values[s[0]])[3:]).max())
        for found in runs.values()
        for r, b in zip(found, runs[BOTH, "Gauss-Newton"], strict=True)
        if r.values is not None and b.values is not None
    )
    titles = ["start", "optimizer", "cameras, cm, aligned", "points, cm, aligned", "cameras, cm, not aligned"]
    titles += ["sonar, cm", "sonar, deg", "chi2 / dof", "iterations", "status"]
    return [
        *markdown(titles, (row(*names, found) for names, found in runs.items()), "llrrrrrrrl"),
        "Root mean square errors of positions: mean over the seeds at the start -> at the end (worst seed). "
        "*Aligned*: one rigid motion of cameras and points together, no scale. *Not aligned*: the first camera is "
        "fixed, the others are counted. Sonar: position and angle of its axes, which need no alignment. chi2 / dof: "
        f"mean, and least and most. All starts end at the same sonar, to {np.degrees(same):.1g} deg.",
    ]


def consistency(seeds: int) -> list[str]:
    """Predicted and observed."""
    found = []
    for seed in range(seeds):
        found.append(sigmas(seed))
        if seed % 10 == 9:
            print(f"sigmas of seed {seed}", flush=True)
    low, high = nees_bounds(6, seeds)
    return [
        *consistency_table([f.told for f in found], np.array([f.e for f in found])),
        "In axes of the sonar (x forward, y right, z down). Predicted: the Cramer-Rao bound of "
        "`nls.analysis.observability`, mean over the scenes. "
        f"An rms of {seeds} errors is itself known to {100 / np.sqrt(2 * seeds):.0f} %.",
        f"NEES of the six numbers: mean {np.mean([f.nees for f in found]):.2f}, expected 6, in {low:.2f}-{high:.2f} "
        "with 95 %.",
    ]


def page(seeds: int, sigma_seeds: int) -> list[str]:
    """The page."""
    first = sim.rig(np.random.default_rng(0))
    return [
        first.description,
        f"## Before and after, seeds 0 to {seeds - 1}",
        *before_and_after(seeds),
        f"## The place of the sonar, predicted and observed, seeds 0 to {sigma_seeds - 1}",
        *consistency(sigma_seeds),
        "## Which motion would help, seed 0",
        *motions_table(helpful_motions(first.graph, first.truth, s[0], frame=first.truth[s[0]])),
        "Sigma of each component of the sonar's place before / after; motions are along the axes of the sonar. "
        "*stay*: a second image from the last pose. Sorted by pitch, the weakest.",
    ]


if __name__ == "__main__":
    counts = {"seeds": (20, "scenes"), "sigma_seeds": (100, "predicted, observed")}
    make_page("A camera and a sonar, calibrated on the fly", page, **counts)
