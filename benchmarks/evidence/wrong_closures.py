"""Public pose graphs with wrong loop closures planted among the right ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from script import POSE_GRAPHS

import nls
from factors import Between
from factors.keys import Keys
from models import LieGroup
from models.algebra import Index, Mask
from nls import FactorGraph, Values
from nls.metrics import ate

RENAMED = {"INTEL": "input_INTEL", "M3500": "input_M3500", "Olson": "manhattanOlson3500"}
NAMES = ("CSAIL", "FR079", "INTEL", "intel", "kitti_00", "ring", "M3500", "manhattan", "Olson", "city10000")
NAMES += ("smallGrid3D", "sphere2500", "torus3D", "parking-garage")
SETS = {name: POSE_GRAPHS[RENAMED.get(name, name)] for name in NAMES}
GROUP = 10  # wrong closures in a group
KINDS = {  # how the ends are drawn, and how many in a row say the same
    "random": ("random", 1),
    "grouped": ("random", GROUP),
    "local": ("local", 1),
    "local in groups": ("local", GROUP),
    "alias": ("alias", 1),
    "alias in groups": ("alias", GROUP),
}
NEAR = 20  # steps at most between the ends of a local one
LOOP = 10  # steps at least between the two ends of an alias, and three times its group
SIGMA_METERS, SIGMA_RADIANS = 0.3, np.radians(10)  # of what a random or local one says
HALF = 0.5  # of the trials with few closures have them spread over the track
TWENTY = 20  # closures of a graph with few
FINE = 0.01  # of the extent: what is nearer to the optimum without wrong closures is right
X = "x"  # the kind of every pose here


@dataclass(frozen=True)
class Solved:
    """A graph without wrong closures.

    Attributes
    ----------
    edges : all its measurements; poses are numbered from 0 without a gap.
    loops : (m,) which of them are closures.
    start, best : the values of the file, and the optimum.
    extent : the longest side of the box around the track, m.
    """

    edges: Between
    loops: Mask
    start: Values
    best: Values
    extent: float

    def off(self, values: Values) -> float:
        """ATE from the optimum, rigidly aligned, over the extent."""
        return ate(values[nls.kinds(X)[0]], self.best.stack(X).X, "rigid").rmse / self.extent


@cache
def solved(path: Path) -> Solved:
    """A graph of one batch of relative poses, solved from the default start."""
    graph, values, _ = nls.load(path)
    (edges,) = graph.factors
    assert isinstance(edges, Between)
    result = graph.optimize(nls.initialize(graph, values)[0])
    assert result.converged, result.reason
    stack = result.values.stack(X)
    assert isinstance(stack.manifold, LieGroup)
    assert (stack.numbers == np.arange(len(stack))).all()
    loops = np.abs(edges.keys[0].numbers - edges.keys[1].numbers) != 1
    return Solved(edges, loops, values, result.values, float(np.ptp(stack.manifold.position(stack.X), axis=0).max()))


def few(right: Solved, count: int, rng: np.random.Generator, spread: bool | None = None) -> Solved:
    """The graph with so many of its closures, drawn at random, or in two runs, and its own optimum.

    Spread ones hold all of the map, two runs two places of it. The generator decides where it is not said.
    """
    loops, n = np.flatnonzero(right.loops), count // 2
    if rng.random() < HALF if spread is None else spread:
        chosen = rng.choice(loops, count, replace=False)
    else:
        first = np.sort([right.edges.keys[slot].numbers[loops] for slot in (0, 1)], axis=0)
        order, runs = loops[np.lexsort(first[::-1])], rng.choice(len(loops) - n, 2, replace=False)
        chosen = np.unique([order[begin : begin + n] for begin in runs])
    mask = ~right.loops
    mask[chosen] = True
    edges = right.edges[mask]
    assert isinstance(edges, Between)
    result = FactorGraph([edges]).optimize(right.best)
    assert result.converged, result.reason
    return Solved(edges, right.loops[mask], right.start, result.values, right.extent)


def spoiled(right: Solved, wrong: int, kind: str, rng: np.random.Generator) -> Between:
    """So many wrong closures, one of `KINDS`.

    Random ones join two poses drawn at random, local ones two within 20 steps. Both say that the poses are one place,
    but for 0.3 m and 10 degrees, all of a group the same, with the weight of the graph's first closure: the generator
    of N. Suenderhauf and P. Protzel, "Switchable constraints for robust pose graph SLAM", IROS 2012.

    An alias says of two poses drawn at random what a right closure says of its own. The others of its group say it,
    too, carried along the true track at both ends, each with weight and residual of a right one: one place looks like
    another.
    """
    ends, size = KINDS[kind]
    if ends == "alias":
        return _aliases(right, wrong, size, rng)
    edges, n = right.edges, len(right.best.stack(X))
    groups = -(-wrong // size)
    a, b = _ends(ends, groups, n - size, rng)
    group = right.best.stack(X).manifold
    assert isinstance(group, LieGroup)
    meters = rng.normal(0, SIGMA_METERS, (groups, group.point_dim))
    radians = rng.normal(0, SIGMA_RADIANS, (groups, group.dim - group.point_dim))
    z = group.exp(np.column_stack([meters, radians]))
    of, step = np.divmod(np.arange(wrong), size)
    weights = edges.noise.take(np.full(wrong, np.flatnonzero(right.loops)[0]), len(edges))
    return Between(Keys(X, a[of] + step), Keys(X, b[of] + step), z[of], weights, convention=edges.convention)


def _ends(kind: str, groups: int, last: int, rng: np.random.Generator) -> tuple[Index, Index]:
    """First and second pose of the first of every group, neither the same nor neighbors."""
    a = rng.integers(0, last, groups)
    b = rng.integers(0, last, groups) if kind == "random" else rng.integers(a, np.minimum(last, a + NEAR) + 1)
    again = np.abs(a - b) < 2
    if again.any():
        a[again], b[again] = _ends(kind, int(again.sum()), last, rng)
    return np.minimum(a, b), np.maximum(a, b)


def _aliases(right: Solved, wrong: int, size: int, rng: np.random.Generator) -> Between:
    edges, stack = right.edges, right.best.stack(X)
    group, P, n = stack.manifold, stack.X, len(stack)
    assert isinstance(group, LieGroup)
    ends = np.empty((0, 2), dtype=np.intp)
    while len(ends) * size < wrong:
        drawn = rng.integers(0, n - size + 1, (wrong, 2))
        ends = np.concatenate([ends, drawn[np.abs(drawn[:, 0] - drawn[:, 1]) >= max(LOOP, 3 * size)]])
    of, step = np.divmod(np.arange(wrong), size)
    a, b = ends[of].T
    i, j = a + step, b + step
    donors = rng.choice(np.flatnonzero(right.loops), wrong)
    seen = group.between(*(P[edges.keys[slot].numbers[donors]] for slot in (0, 1)))
    residual = group.log(group.compose(group.inverse(seen), edges.z[donors]))
    z = group.compose(group.between(P[i], P[a]), edges.z[donors[of * size]])
    z = group.compose(group.compose(z, group.between(P[b], P[j])), group.exp(residual))
    return Between(Keys(X, i), Keys(X, j), z, edges.noise.take(donors, len(edges)), convention=edges.convention)
