r"""The cost of a step against the number of landmarks: a filter keeps every correlation, a graph only measurements.

    EKF       P has (3 + 2 m)^2 numbers, each of which every update changes        a step O(m^2), all steps O(m^3)
    online    the graph so far solved at each step, from the last optimum          a step O(m),   all steps O(m^2)
    batch     the graph solved once                                                               all steps O(m)

Measured on a ring that grows with its landmarks: the vehicle goes round once, past all of them, and a little further.
So the loop is closed and every landmark is known. Poses see equally many landmarks whatever the size of the ring. Times
are those of the processor, on one BLAS thread.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import cos, pi, sin
from time import process_time

import numpy as np

from factors import Between, Diagonal, Prior
from models import SE2, R
from nls import FactorGraph, Values, kinds
from nls.filters.base import steps
from nls.sparse.threads import single_thread
from nls.starts import locate_points
from sim.checks import check_rng, check_size
from sim.estimators import batch, estimator
from sim.landmark_world import KNOWN_START, LandmarkWorld
from sim.world import chain, seed_of
from sim.worlds.subsea import STEP, sightings

__all__ = ["FITTED", "SCALED", "Cost", "circuit", "costs", "exponent", "panels", "scaling_rows"]

SCALED = ("ekf", "online", "batch")
SIZES = tuple(100 * 2**k for k in range(8))  # landmarks
FITTED = 3  # sizes an exponent is fitted to: the largest
PER_POSE, ASIDE, SIGHT = 4, 2.0, 4.0  # new landmarks a step; m from the way; m
AGAIN = 20  # steps of the second round, all landmarks known: a step costs the median of these
SIGMAS = (2e-3, 2e-3, 5e-6)  # of a step, m, m, rad: the largest ring closes within 1 m, of 2 m to the landmarks


@dataclass
class Cost:
    """The cost of an estimator, size by size, and why there are no larger ones.

    Attributes
    ----------
    name : of the estimator.
    landmarks, poses : of each size.
    step : s, of a step of the second round; of a batch solution, of all of it over its poses.
    total : s, of all steps.
    stopped : a sentence; empty where every size was run.
    """

    name: str
    landmarks: list[int] = field(default_factory=list)
    poses: list[int] = field(default_factory=list)
    step: list[float] = field(default_factory=list)
    total: list[float] = field(default_factory=list)
    stopped: str = ""

    def law(self, quantity: str) -> float:
        """p of m^p for the times of ``step`` or ``total`` and the landmarks m, at the largest sizes."""
        return exponent(self.landmarks[-FITTED:], getattr(self, quantity)[-FITTED:])


def circuit(rng: np.random.Generator, landmarks: int) -> LandmarkWorld:
    """A vehicle on a ring road with landmarks on both sides, once round and 20 steps more.

    Parameters
    ----------
    rng : source of the noise.
    landmarks : on both sides in turn, 2 m from the way and four to a step of 2.1 m; at least 100. Those within 4 m are
        seen, 13 or 14 from each pose, as precisely as in `sim.subsea`.

    Returns
    -------
    LandmarkWorld

    Raises
    ------
    OptionError
        Too few landmarks.

    Examples
    --------
    >>> world = circuit(np.random.default_rng(1), 100)
    >>> world.poses, world.landmarks, round(len(world.sightings) / world.poses)
    (46, 100, 14)
    """
    check_rng(rng)
    check_size("landmarks", landmarks, 100)
    x, l = kinds("x", "l")
    lap = -(-landmarks // PER_POSE)
    n, turn = lap + AGAIN + 1, 2 * pi / lap
    radius = STEP / (2 * sin(turn / 2))
    step = np.tile([STEP * cos(turn / 2), STEP * sin(turn / 2), turn], (n - 1, 1))
    first = np.array([[radius, 0.0, pi / 2]])
    X = chain(SE2, first[0], step)
    odometry = SE2.retract(step, rng.standard_normal((n - 1, 3)) * SIGMAS)
    k = np.arange(landmarks)
    at, away = 2 * pi * (k + 0.5) / landmarks, radius + np.where(k % 2, ASIDE, -ASIDE)
    L = np.stack([away * np.cos(at), away * np.sin(at)], axis=1)

    poses = np.arange(n)
    graph = FactorGraph(
        [
            Prior(x[0], first, Diagonal(KNOWN_START)),
            Between(x[poses[:-1]], x[poses[1:]], odometry, Diagonal(SIGMAS)),
            sightings(rng, X, L, SIGHT),
        ]
    )
    truth = Values({x: (SE2, X), l: (R(2), L)})
    start = locate_points(graph, Values({x: (SE2, chain(SE2, first[0], odometry)), l: (R(2), np.zeros_like(L))}))
    description = f"Circuit: a ring of {2 * radius:.4g} m across, {n} poses, {landmarks} landmarks."
    rows = graph.pattern(truth).measured_rows
    return LandmarkWorld("circuit", truth, graph, start, rows, "correlated", seed_of(rng), description)


def costs(
    seed: int, names: Sequence[str], settings: Mapping[str, int], seconds: float, sizes: Sequence[int] = SIZES
) -> list[Cost]:
    """The cost of estimators on circuits of several sizes.

    Parameters
    ----------
    seed : of the noise.
    names : some of `sim.estimators.ESTIMATORS`.
    settings : of the estimators, see `sim.estimators.tracked`.
    seconds : an estimator stops before a size that is foreseen to take longer.
    sizes : numbers of landmarks, rising.

    Returns
    -------
    list of `Cost`, one an estimator.
    """
    all_costs = [Cost(name) for name in names]
    for landmarks in sizes:
        going = [cost for cost in all_costs if not cost.stopped]
        world = circuit(np.random.default_rng(seed), landmarks) if going else None
        for cost in going:
            if (time := _foreseen(cost, landmarks)) > seconds:
                about = f"{time:.0f}" if time >= 1 else f"{time:.2g}"
                cost.stopped = f"{cost.name} stops before {landmarks} landmarks, which would take about {about} s"
                continue
            assert world is not None
            times = _times(world, cost.name, settings)
            cost.landmarks.append(landmarks)
            cost.poses.append(world.poses)
            cost.step.append(float(np.median(times[-AGAIN:])))
            cost.total.append(float(times.sum()))
    return all_costs


@single_thread()
def _times(world: LandmarkWorld, name: str, settings: Mapping[str, int]) -> np.ndarray:
    """Processor time of each step; of a batch solution, with all covariances, the same for all."""
    chosen = estimator(world, name, **settings)
    began = process_time()
    if chosen is None:
        batch(world)
        return np.full(world.poses, (process_time() - began) / world.poses)
    clock = []
    for k, step in enumerate(steps(world.graph, world.start)):
        began = process_time()
        if k:
            chosen.step(step)
        else:
            chosen.start(step, world.start)
        clock.append(process_time() - began)
    return np.array(clock)


def _foreseen(cost: Cost, landmarks: int) -> float:
    """Seconds a size will take, by the law of the last two and at least linear; 0 while nothing is known."""
    if len(cost.total) < 2:
        return 0.0
    p = max(1.0, exponent(cost.landmarks[-2:], cost.total[-2:]))
    return float(cost.total[-1] * (landmarks / cost.landmarks[-1]) ** p)


def exponent(n: Sequence[int], y: Sequence[float]) -> float:
    """p of the power law y ~ n^p through the points, by least squares of the logarithms; nan of a single one.

    Examples
    --------
    >>> exponent([100, 200, 400], [1.0, 4.0, 16.0])
    2.0
    """
    return float(np.polyfit(np.log(n), np.log(y), 1)[0]) if len(n) > 1 else float("nan")


def scaling_rows(all_costs: Sequence[Cost]) -> list[tuple[str, str]]:
    """The table, one (label, text) a line."""
    sizes = max((cost.landmarks for cost in all_costs), key=len)
    poses = max((cost.poses for cost in all_costs), key=len)
    rows = [("landmarks", "".join(f"{text:>12s}" for text in ("poses", *(cost.name for cost in all_costs))))]
    for quantity, unit, scale in (("step", "ms a step", 1e3), ("total", "s in all", 1.0)):
        rows.append((unit, ""))
        for k, (size, n) in enumerate(zip(sizes, poses, strict=True)):
            cells = [f"{scale * getattr(c, quantity)[k]:.4g}" if k < len(c.landmarks) else "" for c in all_costs]
            rows.append((str(size), "".join(f"{text:>12s}" for text in (str(n), *cells))))
        laws = [f"m^{c.law(quantity):.2f}" for c in all_costs]
        rows.append(("law", "".join(f"{text:>12s}" for text in ("", *laws))))
    rows += [("fitted to", f"{c.name}: {', '.join(map(str, c.landmarks[-FITTED:]))} landmarks m") for c in all_costs]
    rows.append(("a step", f"median of {AGAIN} with all landmarks known; of batch, with all covariances, the mean"))
    return rows + [("stopped", cost.stopped) for cost in all_costs if cost.stopped]


def panels(all_costs: Sequence[Cost]) -> dict[str, dict[str, tuple[list[int], list[float], float]]]:
    """The two panels of `nls.plot.filters.power_laws`: what a step costs, and all of them."""
    return {
        title: {cost.name: (cost.landmarks, getattr(cost, quantity), cost.law(quantity)) for cost in all_costs}
        for title, quantity in (("one step [s]", "step"), ("all steps [s]", "total"))
    }
