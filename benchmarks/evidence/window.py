"""A window of poses beside the batch: its heading, and whether its covariances pass.

    python benchmarks/evidence/window.py [--seeds 20] [--runs 100] [--gtsam PYTHON] [--out DIR]

Heading: a vehicle in the plane among landmarks seen by bearing and range. Only the prior of the first pose, 0.1 rad,
tells its heading. NEES: of the last pose in three worlds. GTSAM's smoother runs where an interpreter has its wheel, in
worlds whose factors its wheel has.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from script import GTSAM, Table, fresh, make_page, over

import nls
import sim
from factors import BearingRange, Between, Diagonal, Factor, Position, Prior
from models import SE2, Manifold, R, wrap
from models.algebra import Array
from nls import FactorGraph, Incremental, Marginals, Values, kinds
from nls.filters.consistency import nees_bounds
from nls.incremental.steps import steps

x, l = kinds("x", "l")
LAGS = (5, 10, 20)
FIRST, STEP, SEEN = np.array([0.01, 0.01, 0.1]), np.array([0.05, 0.05, 0.01]), np.array([0.01, 0.1])
MATCH, FIX = np.array([0.1, 0.1, 0.02]), 0.5  # of a scan match five poses back; of a position fix, m
POSES = 60
NEAR = 1.0  # m; nearer landmarks are not seen


class World(NamedTuple):
    """Measurements, the truth of all variables, and the numbers for a peer; none where it has no such factors."""

    factors: list[Factor]
    truth: Values
    numbers: dict[str, Array]


def path(turn: float, length: float, n: int = POSES) -> Array:
    """Poses (n + 1, 3) of equal steps."""
    X = [np.array([-3.0, 0.0, 0.3])]
    for _ in range(n):
        X.append(SE2.compose(X[-1], np.array([length, 0.0, turn])))
    return np.array(X)


def among(seed: int, turn: float, length: float, sharper: float = 1.0, reach: float = 100.0) -> World:
    """A vehicle that sees landmarks within reach by bearing and range."""
    rng, X = np.random.default_rng(seed), path(turn, length)
    p = rng.uniform(-12, 12, (12 if reach > 50 else 40, 2)) + (0 if reach > 50 else [10, 3])
    away = np.linalg.norm(p - X[:, None, :2], axis=2)
    i, j = np.nonzero((away < reach) & (away > NEAR))
    d = p[j] - X[i, :2]
    z = np.column_stack([np.arctan2(d[:, 1], d[:, 0]) - X[i, 2], np.linalg.norm(d, axis=1)])
    z += rng.normal(0, sharper * SEEN, z.shape)
    z[:, 0] = wrap(z[:, 0])
    first = SE2.retract(X[:1], rng.normal(0, FIRST, (1, 3)))
    step = SE2.retract(SE2.between(X[:-1], X[1:]), rng.normal(0, sharper * STEP, (POSES, 3)))
    k = np.arange(POSES)
    factors = [
        Prior(x[0], first, Diagonal(FIRST)),
        Between(x[k], x[k + 1], step, Diagonal(sharper * STEP)),
        BearingRange(x[i], l[j], z, Diagonal(sharper * SEEN)),
    ]
    numbers = {"first": first[0], "step": step, "pose": i, "landmark": j, "seen": z}
    sigmas = {"sigma_first": FIRST, "sigma_step": sharper * STEP, "sigma_seen": sharper * SEEN}
    seen = np.unique(j)
    return World(factors, Values({x: (SE2, X), l: (R(2), p[seen], seen)}), numbers | sigmas)


def matched(seed: int, n: int = POSES, backs: tuple[int, ...] = (5,)) -> World:
    """A vehicle with odometry, scan matches some poses back and a position fix at every tenth pose."""
    rng, X, k = np.random.default_rng(seed), path(0.1, 1.0, n), np.arange(n)
    first = SE2.retract(X[:1], rng.normal(0, FIRST, (1, 3)))
    step = SE2.retract(SE2.between(X[:-1], X[1:]), rng.normal(0, STEP, (n, 3)))
    ways = {back: SE2.between(X[:-back], X[back:]) for back in backs}
    match = {back: SE2.retract(way, rng.normal(0, MATCH, way.shape)) for back, way in ways.items()}
    fixed = k[10::10]
    fix = X[fixed, :2] + rng.normal(0, FIX, (len(fixed), 2))
    factors = [
        Prior(x[0], first, Diagonal(FIRST)),
        Between(x[k], x[k + 1], step, Diagonal(STEP)),
        *(Between(x[: len(z)], x[back : n + 1], z, Diagonal(MATCH)) for back, z in match.items()),
        Position(x[fixed], fix, Diagonal([FIX, FIX])),
    ]
    numbers = {"first": first[0], "step": step, "fixed": fixed, "fix": fix}
    numbers |= {f"match {back}": z for back, z in match.items()}
    sigmas = {"sigma_first": FIRST, "sigma_step": STEP, "sigma_match": MATCH, "sigma_fix": np.array([FIX, FIX])}
    return World(factors, Values({x: (SE2, X)}), numbers | sigmas)


def contacts(seed: int) -> World:
    """A hovering vehicle over the sea floor: steps, depth and tilt, and contacts of an imaging sonar."""
    mission = sim.hauv_floor(np.random.default_rng(seed), legs=1)
    return World(list(mission.graph.factors), mission.truth, {})


WORLDS: dict[str, Callable[[int], World]] = {
    "standing": partial(among, turn=0.0, length=0.0),
    "standing, sensors ten times better": partial(among, turn=0.0, length=0.0, sharper=0.1),
    "circling": partial(among, turn=2 * np.pi / 30, length=1.0),
    "circling, sensors ten times better": partial(among, turn=2 * np.pi / 30, length=1.0, sharper=0.1),
    "driving by, landmarks within 8 m": partial(among, turn=0.0, length=0.4, reach=8.0),
}
CONSISTENT: dict[str, tuple[Callable[[int], World], tuple[int, ...]]] = {
    "plane: bearings and ranges, circling": (WORLDS["circling"], LAGS),
    "plane: steps, scan matches, position fixes": (matched, LAGS),
    "space: steps, depth, tilt, sonar contacts": (contacts, (10,)),
}


def last_of(world: World) -> tuple[nls.Keys, Manifold]:
    """The last pose, and its space."""
    stack = world.truth.stack("x")
    return x[int(stack.numbers.max())], stack.manifold


def estimates(seed: int, world: Callable[[int], World], lags: tuple[int, ...]) -> dict[str, Any]:
    """Error of the last pose in its own axes, its NEES and the sigma of its yaw: of the batch, and of every lag."""
    made = world(seed)
    last, space = last_of(made)
    graph = FactorGraph(made.factors)
    best = graph.optimize(made.truth.copy()).values
    found = {"batch": (best[last], Marginals(graph, best).covariance(last, frame="body"))}
    for lag in lags:
        smoother = Incremental(1e-8, lag=lag)  # so close that differences are those of the prior
        smoother.update([], made.truth.spaces().extended(x[0], made.truth[x[0]][None]))
        for step in steps(made.factors):
            smoother.update(step.factors)
        found[str(lag)] = smoother[last], smoother.covariance(last, frame="body")
    return {name: [*judged(space, made.truth[last], best[last], X, P)] for name, (X, P) in found.items()}


def judged(space: Manifold, truth: Array, best: Array, X: Array, P: Array) -> tuple[float, float, float]:
    """NEES, yaw off the batch, and sigma of yaw, rad."""
    e, off = space.local(X[None], truth[None])[0], space.local(best[None], X[None])[0]
    return float(e @ np.linalg.solve(P, e)), float(off[-1]), float(np.sqrt(P[-1, -1]))


def peer(gtsam: str, world: Callable[[int], World], seeds: int, lag: int) -> Array | None:
    """NEES, yaw off the batch and sigma of yaw (seeds, 3) of GTSAM's smoother; None where it has no such factors."""
    made = [world(seed) for seed in range(seeds)]
    if not made[0].numbers:
        return None
    runs = fixed_lag(gtsam, made, lag)
    rows = []
    for w, one, covariance in zip(made, runs["X"], runs["P"], strict=True):
        last, space = last_of(w)
        best = FactorGraph(w.factors).optimize(w.truth.copy()).values
        rows.append(judged(space, w.truth[last], best[last], one, covariance))
    return np.array(rows)


def fixed_lag(gtsam: str, worlds: list[World], lag: int, *numbers: float) -> dict[str, Array]:
    """What GTSAM's smoother makes of worlds, see benchmarks/peers/fixed_lag.py."""
    with tempfile.TemporaryDirectory() as folder:
        file, out = Path(folder) / "worlds.npz", Path(folder) / "out.npz"
        arrays: dict[str, Any] = {f"{k}/{name}": a for k, w in enumerate(worlds) for name, a in w.numbers.items()}
        np.savez(file, count=len(worlds), **arrays)
        script = Path(__file__).parents[1] / "peers" / "fixed_lag.py"
        fresh(gtsam, "-P", script, file, out, lag, *numbers).check_returncode()
        with np.load(out) as runs:
            return dict(runs)


def headings(seeds: int, gtsam: str | None) -> list[str]:
    """A row for every world and lag: yaw off the batch, and its sigma."""
    titles = ["world", "lag", "sigma, batch", "off, window", "sigma, window", "off, GTSAM", "sigma, GTSAM"]
    table = Table(titles)
    for name, world in WORLDS.items():
        found = over(partial(estimates, world=world, lags=LAGS), seeds)
        for lag in LAGS:
            theirs = peer(gtsam, world, seeds, lag) if gtsam else None
            cells = [name, lag, span(found["batch"][:, 2]), *off(found[str(lag)])]
            table.add(*cells, *(["", ""] if theirs is None else off(theirs)))
    return table


def off(each: Array) -> list[str]:
    """The largest yaw off the batch, and the sigmas."""
    return [f"{np.abs(each[:, 1]).max():.4f}", span(each[:, 2])]


def span(numbers: Array) -> str:
    """The smallest and the largest."""
    return f"{numbers.min():.4f}-{numbers.max():.4f}"


def consistency(count: int, gtsam: str | None) -> list[str]:
    """A row for every world and lag: the mean NEES of the last pose."""
    table = Table(["world", "lag", "bounds", "batch", "window", "GTSAM"])
    for name, (world, lags) in CONSISTENT.items():
        found = over(partial(estimates, world=world, lags=lags), count)
        low, high = nees_bounds(last_of(world(0))[1].dim, count)
        for lag in lags:
            theirs = peer(gtsam, world, count, lag) if gtsam else None
            means = ("" if e is None else f"{e[:, 0].mean():.2f}" for e in (found["batch"], found[str(lag)], theirs))
            table.add(name, lag, f"{low:.2f}-{high:.2f}", *means)
    return table


def page(seeds: int, runs: int, gtsam: str | None) -> list[str]:
    """The page without its head."""
    return [
        f"## Heading, seeds 0 to {seeds - 1}",
        f"Only the prior of the first pose measures the heading: 0.1 rad. Yaw of the last of {POSES + 1} poses, rad: "
        "the largest difference from the batch, and the smallest and largest sigma.",
        *headings(seeds, gtsam),
        f"## Consistency, seeds 0 to {runs - 1}",
        "Mean NEES of the last pose. A consistent estimator is within the bounds in 95 % of all cases.",
        *consistency(runs, gtsam),
        "- GTSAM: `IncrementalFixedLagSmoother`, relinearized from 0.001 on, three updates a step. Variables of its "
        "prior keep their linearization point.",
        "- GTSAM's wheel has neither sonar contacts nor depth with tilt.",
    ]


if __name__ == "__main__":
    counts = {"seeds": (20, "of the headings"), "runs": (100, "of the NEES")}
    make_page("A window of poses", page, **counts, gtsam=GTSAM)
