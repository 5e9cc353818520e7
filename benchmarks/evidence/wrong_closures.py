"""Public pose graphs with wrong loop closures planted among the right ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

import nls
from factors import Between
from factors.keys import Keys
from models import LieGroup
from nls import Values
from nls.metrics import ate

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
SETS = {
    "intel": "pose-graphs-2d/intel.g2o",
    "manhattan": "pose-graphs-2d/manhattan.g2o",
    "sphere2500": "pose-graphs-3d/sphere2500.g2o.gz",
    "torus3D": "pose-graphs-3d/torus3D.g2o.gz",
    "parking-garage": "pose-graphs-3d/parking-garage.g2o.gz",
}
LOOP = 10  # steps at least between the two ends of a wrong closure, and three times its group
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


def spoiled(right: Solved, share: float, size: int, rng: np.random.Generator) -> Between:
    """Wrong closures in groups: `size` in a row from poses a, a+1, ... to b, b+1, ... that agree with one another.

    The first of a group says of two poses drawn at random what a right one, drawn at random, says of its own. The
    others say it too, carried along the true track at both ends, each with weight and residual of a right one.

    Parameters
    ----------
    share : of all closures, right and wrong, that are wrong in the end.
    """
    edges, stack = right.edges, right.best.stack(X)
    group, P, n = stack.manifold, stack.X, len(stack)
    assert isinstance(group, LieGroup)
    wrong = round(share / (1 - share) * int(right.loops.sum()))
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
