"""Pose graphs with more than one minimum."""

from __future__ import annotations

import numpy as np

from factors import Between, Diagonal, Isotropic
from models import SE2, SE3, LieGroup
from models.algebra import Array
from nls import FactorGraph, Values
from nls.certificate.problem import Problem, certifiable
from tests.nls.graphs import ODD, pose_graph, x

GROUPS = (SE2, SE3)
SEED = 3


def problem_of(group: LieGroup, seed: int = SEED, start: float = 0.3) -> tuple[Problem, Array, FactorGraph, Values]:
    sample = pose_graph(group, anchored=False, numbers=ODD, seed=seed, start=start)
    graph = certifiable(sample.graph, sample.values)
    return graph, graph.matrices(graph.graph.stack(sample.values)), sample.graph, sample.values


def ring(turns: int, n: int = 12, sigma: float = 0.1) -> tuple[FactorGraph, Values]:
    """A ring of exact steps, started with the headings going round so many times."""
    k = np.arange(n)
    graph = FactorGraph([Between(x[k], x[(k + 1) % n], [1.0, 0.0, 2 * np.pi / n], Isotropic(sigma))])
    heading = turns * 2 * np.pi / n * k
    steps = np.column_stack([np.cos(heading), np.sin(heading)])
    X = np.column_stack([np.cumsum(steps, axis=0) - steps[0], heading])
    return graph, Values({x: (SE2, X)})


def noise_graph(group: LieGroup, seed: int) -> tuple[FactorGraph, Values]:
    """Measurements between all pairs of five poses that have nothing to do with each other."""
    rng = np.random.default_rng(seed)
    i, j = np.triu_indices(5, 1)
    scale = np.repeat([1.0, 2.0], [group.point_dim, group.dim - group.point_dim])
    z = group.exp(rng.normal(size=(len(i), group.dim)) * scale)
    return FactorGraph([Between(x[i], x[j], z, Isotropic(0.5))]), Values({x: (group, group.identity(5))})


def square(spin: float = 0.05) -> tuple[FactorGraph, Values]:
    """A square whose turns add up to a little more than one, and its corners on one spot."""
    z = np.tile([1.0, 0.0, np.pi / 2], (4, 1))
    z[0, 2] += spin
    graph = FactorGraph([Between(x[[0, 1, 2, 3]], x[[1, 2, 3, 0]], z, Isotropic(0.1), "g2o")])
    return graph, Values({x: (SE2, [[0, 0, 0], [0, 0, 1e-3], [0, 0, 0], [0, 0, 0]])})


def dominated(group: LieGroup, far: float, turns: int, noise: float = 0.0) -> tuple[FactorGraph, Values]:
    """A ring of six steps, wound so many times, and a pose beside it that is measured twice, `far` apart."""
    k, step, shift = np.arange(6), np.zeros((6, group.dim)), group.identity(2)
    step[:, 0], step[:, -1], shift[:, 0] = 1.0, 2 * np.pi / 6, [1.0, far]
    z = group.exp(step) if group is SE3 else step
    z = group.retract(z, noise * np.random.default_rng(1).normal(size=step.shape))
    ring = Between(x[k], x[(k + 1) % 6], z, Isotropic(0.1))
    graph = FactorGraph([ring, Between(x[[5, 5]], x[[6, 6]], shift, Isotropic(0.1))])
    turned, moved = np.zeros((2, 7, group.dim))
    turned[:, -1] = (2 * np.pi * turns / 6 * np.arange(7) + np.pi) % (2 * np.pi) - np.pi
    moved[:, :2] = 0.3 * np.random.default_rng(0).normal(size=(7, 2))
    return graph, Values({x: (group, group.retract(group.retract(group.identity(7), turned), moved))})


def contradiction(seed: int, n: int = 12) -> tuple[FactorGraph, Values]:
    """A chain in space and two closures of its ends, 12 times as wrong as they say; poses anywhere."""
    rng = np.random.default_rng(seed)
    i, j = np.array([*range(n - 1), 0, 1]), np.array([*range(1, n), n - 1, n - 2])
    X = SE3.exp(rng.normal(size=(n, 6)) * np.repeat([2.0, 0.7], 3))
    sigmas = np.repeat([0.3, 0.2], 3)
    noise = rng.normal(size=(len(i), 6)) * sigmas
    noise[-2:] *= 12
    graph = FactorGraph([Between(x[i], x[j], SE3.retract(SE3.between(X[i], X[j]), noise), Diagonal(sigmas))])
    return graph, Values({x: (SE3, SE3.exp(2 * np.random.default_rng(seed + 1).normal(size=(n, 6))))})
