"""Graphs of poses and landmarks for the tests of `schur`, and its step beside that of Cholesky."""

from __future__ import annotations

import numpy as np

from factors import Between, Diagonal, Factor, Isotropic, Landmark, Prior, Range
from models import SE2, LieGroup, R
from models.algebra import Array
from nls import FactorGraph, LinearSystem, Schur, Values, kinds
from nls.linear import LU, SOLVERS, LinearSolver
from tests.nls.graphs import Sample, moved, walk
from tests.nls.solving import near

x, l, m, o = kinds("x", "l", "m", "o")
MISSING = SOLVERS["cholesky"].missing()


def reference() -> LinearSolver:
    return SOLVERS["cholesky"]() if MISSING is None else LU()


def landmarks(group: LieGroup, n: int = 12, k: int = 30, seed: int = 0, anchored: bool = True) -> Sample:
    """A trajectory with odometry, and points each seen from one to all of its poses, some twice from the same."""
    rng = np.random.default_rng(seed)
    d = 2 if group is SE2 else 3
    X, L = walk(group, n, rng), 5 * rng.normal(size=(k, d))
    z = group.between(X[:-1], X[1:])
    graph = FactorGraph([Between(x[: n - 1], x[1:n], moved(group, z, 0.05, rng), Isotropic(0.1))])
    views = [np.sort(rng.permutation(n)[: 1 + j % n]) for j in range(k)]
    i, j = np.concatenate([*views, views[-1]]), np.repeat([*range(k), k - 1], [*map(len, views), len(views[-1])])
    seen = np.matvec(group.rotation(X[i]).mT, L[j] - group.position(X[i]))
    graph.add(Landmark(x[i], l[j], seen + 0.05 * rng.normal(size=seen.shape), Diagonal([0.1, 0.3, 0.5][:d])))
    if anchored:
        graph.add(Prior(x[0], X[0], Isotropic(0.1)))
    start = Values({x: (group, moved(group, X, 0.05, rng)), l: (R(d), L + 0.1 * rng.normal(size=L.shape))})
    return Sample(graph, start, Values({x: (group, X), l: (R(d), L)}))


def step(solver: LinearSolver, system: LinearSystem, damping: Array | None = None) -> Array:
    return solver.analyze(system.pattern).solve(system, damping).dx


def same(system: LinearSystem, damping: Array | None = None, solver: LinearSolver | None = None) -> None:
    """The step of Cholesky; that of conjugate gradients to their tolerance."""
    solver = solver or Schur()
    near(step(solver, system, damping), step(reference(), system, damping), 1e-9 if solver.name == "schur" else 1e-8)


def said(system: LinearSystem) -> str:
    return Schur().analyze(system.pattern).description


def two_kinds() -> Sample:
    """Points l in the plane, numbers m that poses measure too, and a scale o that some of the points share."""
    sample = landmarks(SE2, seed=12)
    rng = np.random.default_rng(12)
    i, j = np.tile(np.arange(12), 3), np.repeat(np.arange(9), 4)
    graph = FactorGraph(sample.graph.factors)
    graph.add(Factor.from_function(lambda X, M: X[:, :1] + np.sin(M), [x[i], m[j]], 1, Isotropic(0.3)))
    graph.add(Factor.from_function(lambda P, s: s * P - 1.0, [l[[0, 4, 9, 28]], o[[0, 0, 0, 0]]], 2, Isotropic(0.5)))
    graph.add(Prior(o[0], [1.0], Isotropic(0.1)))
    poses, points, numbers = sample.values[x], sample.values[l], 0.2 * rng.normal(size=(9, 1))
    values = Values({x: (SE2, poses), l: (R(2), points), o: (R(1), [[1.0]]), m: (R(1), numbers)})
    return Sample(graph, values, values)


def seen_by_range(*poses: int) -> Sample:
    """A landmark more, whose distance alone is known, from some poses."""
    sample = landmarks(SE2, seed=13)
    graph = FactorGraph(sample.graph.factors)
    graph.add(Range(x[list(poses)], l[[99] * len(poses)], np.full(len(poses), 3.0), Isotropic(0.1)))
    values = Values({x: (SE2, sample.values[x]), l: (R(2), np.vstack([sample.values[l], [3, 1]]), [*range(30), 99])})
    return Sample(graph, values, values)
