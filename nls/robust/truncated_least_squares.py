"""Choosing which of the doubted measurements to keep, and solving for the others: in turns, until neither changes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors.base import Factor
from models.algebra import Array, Mask
from nls.gauge import fixed_variables
from nls.graph import FactorGraph
from nls.linear import best_decomposition
from nls.optimizers import Optimizer, Result, Status
from nls.robust.kernels import LOSSES, Graduated
from nls.robust.loop_graph import LoopGraph
from nls.sparse.fill import fill_in
from nls.starts import chordal
from nls.values import Values

if TYPE_CHECKING:
    from nls.optimizers.problem import Problem
    from nls.optimizers.watch import Watch
    from nls.system import LinearSystem

__all__ = ["Choice", "Truncated", "lowest"]

PASSES = 8  # of choosing and solving at most; three are the rule
DEARER = 10  # a second reach that takes so many times the operations is left out: torus3D, half wrong, 9 minutes
FEWER = 0.8  # part of the pulling measurements; where fewer still pull the graph is made anew
BETTER = 1e-3  # part of chi2 by which another start must be lower


@dataclass(frozen=True)
class Choice:
    """A choice of measurements that reproduces itself, or the last of `PASSES`.

    Attributes
    ----------
    result : the optimum of the inliers.
    graph : the inliers.
    inliers : per factor which of its measurements are kept.
    s : per factor (n,) squared residuals at the optimum, of all.
    cost : the sum of min(s, c^2) where doubted, of s elsewhere.
    """

    result: Result
    graph: FactorGraph
    inliers: list[Mask]
    s: list[Array]
    cost: float


@dataclass(frozen=True)
class Truncated:
    """The problem of truncated least squares: a graph, and which of its measurements may be wrong.

    Attributes
    ----------
    masks : per factor which of its measurements are doubted, all others are trusted.
    c2 : per factor the squared residual beyond which a doubted one is rejected.
    """

    graph: FactorGraph
    masks: list[Mask]
    c2: list[float]

    def scaled(self, variance: float) -> Truncated:
        """The same problem with all thresholds c^2 times so much."""
        return replace(self, c2=[variance * c2 for c2 in self.c2])

    def rejected(self, inliers: list[Mask]) -> int:
        """How many doubted measurements are not kept."""
        return sum(int((m & ~k).sum()) for m, k in zip(self.masks, inliers, strict=True))

    def affordable(self, values: Values, reaches: tuple[float, ...]) -> list[float]:
        """The reaches, thresholds within which measurements pull, that are not much dearer to solve than the first."""
        s = self._s(values)
        flops = [self.flops(values, self._within(s, far)) for far in reaches]
        return [far for far, count in zip(reaches, flops, strict=True) if count <= DEARER * flops[0]]

    def flops(self, values: Values, selection: list[Mask]) -> float:
        """Operations to factorize A'A of some measurements."""
        pattern, held = self.graph.only(selection).pattern(values), fixed_variables(self.graph.fixed, values)
        return fill_in(pattern, held, best_decomposition().order).flops

    def choice(self, values: Values, loss: str, far: float) -> Choice:
        """Where graduated kernels lead from some values, where all pull that are within so many thresholds."""
        values = self._bent(values, loss, far)
        subgraph = self.graph.only(self._within(self._s(values), 1.0))
        return self.settled(lowest(subgraph, values).values)

    def settled(self, values: Values) -> Choice:
        """The choice that reproduces itself, from what is within the thresholds at some values."""
        inliers: list[Mask] = []
        for _ in range(PASSES):
            s = self._s(values)
            before, inliers = inliers, self._within(s, 1.0)
            if before and all((a == b).all() for a, b in zip(before, inliers, strict=True)):
                break
            subgraph = self.graph.only(inliers)
            result = subgraph.optimize(values)
            values = result.values
        else:
            s = self._s(values)  # two choices take turns: the last one is taken
        return self.chosen(result, subgraph, inliers, s)

    def chosen(self, result: Result, graph: FactorGraph, inliers: list[Mask], s: list[Array]) -> Choice:
        """The choice with its cost."""
        cost = sum(
            float(np.where(m, np.minimum(k, c2), k).sum()) for m, k, c2 in zip(self.masks, s, self.c2, strict=True)
        )
        return Choice(result, graph, inliers, s, cost)

    def without(self, choice: Choice, inliers: list[Mask]) -> Choice:
        """The optimum of fewer measurements, from a choice of more."""
        graph = self.graph.only(inliers)
        result = graph.optimize(choice.result.values)
        return self.chosen(result, graph, inliers, self._s(result.values))

    def among(self, choice: Choice, loops: LoopGraph, right: Mask) -> Choice:
        """The optimum of those of a choice that are among some closures (m,)."""
        masks = loops.masks(loops.accepted(choice.inliers) & right)
        return self.without(choice, [a & b for a, b in zip(choice.inliers, masks, strict=True)])

    def _s(self, values: Values) -> list[Array]:
        return [factor.chi2(values) for factor in self.graph.factors]

    def _within(self, s: list[Array], far: float) -> list[Mask]:
        """What is trusted, and those doubted ones that are within so many thresholds."""
        return [~m | (k <= far * c2) for m, k, c2 in zip(self.masks, s, self.c2, strict=True)]

    def _bent(self, values: Values, loss: str, far: float) -> Values:
        """The values to which one Gauss-Newton step for every mu leads."""
        trusted = self.graph.only([~mask for mask in self.masks]).factors
        doubted: list[Factor] = []
        kernels: list[Graduated] = []
        s = self._s(values)
        for factor, mask, k, inside, c2 in zip(
            self.graph.factors, self.masks, s, self._within(s, far), self.c2, strict=True
        ):
            if (near := mask & inside).any():
                kernels.append(kernel := LOSSES[loss](c2**0.5))
                kernel.begin(float(k[near].max()))
                doubted.append(factor[near].robust(kernel))
        while not all(kernel.done for kernel in kernels):
            pulling = [factor[w > 0] for factor in doubted if (w := factor.weights(values)).any()]
            graph = FactorGraph([*trusted, *pulling], self.graph.fixed)
            values = graph.optimize(values, Bending(doubted=tuple(pulling), kernels=tuple(kernels))).values
        return values


@dataclass(frozen=True)
class Bending(Optimizer):
    """One Gauss-Newton step for every mu of some kernels, until the last or until few of the doubted factors pull.

    Wrong closures couple what is far apart: what no longer pulls costs as much as before while it is in the graph.
    """

    doubted: tuple[Factor, ...] = ()
    kernels: tuple[Graduated, ...] = ()
    name = "graduated"

    def iterate(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        least = FEWER * sum(map(len, self.doubted))
        while True:
            X = problem.retract(X, problem.solve(system))
            for kernel in self.kernels:
                kernel.bend()
            system = problem.linearize(X)
            pulling = sum(np.count_nonzero(factor.weights(X)) for factor in self.doubted)
            if pulling < least or all(kernel.done for kernel in self.kernels):
                break
        watch.best, watch.lowest = X, system.chi2
        watch.end(Status.STOPPED, "the kernels are as bent as they get, or fewer measurements pull")


def lowest(graph: FactorGraph, values: Values) -> Result:
    """The optimum from the values or from the chordal start, whichever is lower."""
    result = graph.optimize(values)
    start = chordal(graph, values)
    if start is not values:
        other = graph.optimize(start)
        if other.chi2_final < result.chi2_final * (1 - BETTER):
            return other
    return result
