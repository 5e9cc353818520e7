"""Worlds of which some measurements are read otherwise, for the tests of `nls.analysis`."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

import sim
from factors import Between, Factor
from nls import FactorGraph, LevenbergMarquardt, Values, initialize, load
from nls.analysis.freedom import freedom
from nls.analysis.leave_one_out import Checked, Linearization
from nls.analysis.misread import READINGS
from nls.analysis.suspects import Suspects, suspects
from nls.gauge import choose_gauge, fixed_variables
from nls.sparse.pattern import Pattern

WORLDS: dict[str, Callable[[np.random.Generator], sim.World | sim.LandmarkWorld | sim.Mission]] = {
    "ring": lambda rng: sim.ring(rng, laps=2, per_lap=20),
    "sphere": lambda rng: sim.sphere(rng, 6, 8),
    "manhattan": lambda rng: sim.manhattan(rng, 150),
    "subsea": lambda rng: sim.subsea(rng, laps=1, known_start=True),
    "headings": lambda rng: sim.subsea(rng, laps=1, azimuth="absolute", known_landmarks=2),
    "lines": lambda rng: sim.lines(rng),
}
PUBLIC = (
    "pose-graphs-2d/CSAIL.g2o",
    "pose-graphs-2d/FR079_P_toro.graph",
    "pose-graphs-2d/input_INTEL.g2o",
    "pose-graphs-2d/intel.g2o",
    "pose-graphs-2d/kitti_00.g2o",
    "pose-graphs-2d/ring.g2o",
    "pose-graphs-3d/smallGrid3D.g2o",
    "pose-graphs-3d/sphere2500.g2o.gz",
)


def world(name: str, seed: int) -> tuple[FactorGraph, Values]:
    """A world by name: graph and start."""
    made = WORLDS[name](np.random.default_rng(seed))
    return made.graph, made.start


@cache
def clean(name: str, seed: int) -> tuple[FactorGraph, Values, Values]:
    """A world by name: graph, start and optimum."""
    graph, start = world(name, seed)
    return graph, start, optimum(graph, start)


def public(path: object) -> tuple[FactorGraph, Values]:
    """A public graph and its optimum."""
    graph, values, *_ = load(path)  # type: ignore[arg-type]
    return graph, graph.optimize(initialize(graph, values)[0]).values


def read(factor: Factor, reading: str, values: Values) -> Factor:
    """A factor read otherwise; no reading changes what it says twice."""
    meant = READINGS[reading](values.gather(factor)[0])
    assert meant is not None
    return meant


def misread(graph: FactorGraph, values: Values, k: int, reading: str) -> FactorGraph:
    """The graph with one factor read otherwise."""
    return FactorGraph([read(f, reading, values) if n == k else f for n, f in enumerate(graph.factors)], graph.fixed)


def misread_one(graph: FactorGraph, values: Values, k: int, i: int, reading: str) -> FactorGraph:
    """The graph with one measurement read otherwise, in a factor of its own, the last one."""
    factor = graph.factors[k]
    rest = [f for n, f in enumerate(graph.factors) if n != k]
    one = read(factor, reading, values)[[i]]
    return FactorGraph([*rest, factor[np.arange(len(factor)) != i], one], graph.fixed)


def wrong_closure(graph: FactorGraph, rng: np.random.Generator) -> FactorGraph:
    """A graph with a closure of two poses drawn at random that says what another closure says."""
    closures = graph.factors[1]
    assert isinstance(closures, Between)
    i, j = closures.keys
    k = int(rng.integers(len(closures)))
    other = Between(i[[k]], j[[(k + len(closures) // 2) % len(closures)]], closures.z[[k]], closures.noise)
    return FactorGraph([*graph.factors, other])


def optimum(graph: FactorGraph, start: Values) -> Values:
    return graph.optimize(start, LevenbergMarquardt()).values


def held(graph: FactorGraph, values: Values) -> Pattern:
    """The pattern with the gauge held."""
    whole = graph.pattern(values)
    return whole.holding(choose_gauge("first", whole, values, fixed_variables(graph.fixed, values)).held)


def judged(graph: FactorGraph, values: Values) -> Checked | None:
    """Every measurement against all others; what is free is held by anchors, where that can be."""
    return freedom(held(graph, values), values).checked


def checked(graph: FactorGraph, values: Values) -> Checked:
    """Every measurement against all others, where that can be."""
    checks = judged(graph, values)
    assert checks is not None
    return checks


def doubted(graph: FactorGraph, values: Values) -> tuple[Pattern, Suspects]:
    """The pattern with the gauge held, and the measurements that do not fit."""
    pattern = held(graph, values)
    return pattern, suspects(graph, pattern, values, Checked(Linearization(pattern, values)))
