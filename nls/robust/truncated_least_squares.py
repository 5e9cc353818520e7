"""Selection of the tested measurements to keep, and solving for the others: in turns, until neither changes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from factors import Factor, GemanMcClure
from models.algebra import Array, Mask, congruence
from models.chi_squared import innovation_distances
from nls.covariance import Marginals
from nls.gauge import fixed_variables
from nls.graph import FactorGraph
from nls.linear import best_decomposition
from nls.optimizers import Optimizer, Result, Status, Stop, default_optimizer
from nls.optimizers.base import Watch
from nls.optimizers.problem import Problem
from nls.robust.kernels import LOSSES, Graduated
from nls.robust.landmarks import Landmarks
from nls.robust.loop_graph import LoopGraph
from nls.sparse.fill import fill_in
from nls.starts.chordal import chordal
from nls.starts.parts import put_back
from nls.system import LinearSystem
from nls.values import Values

DEARER = 10  # a second reach that takes so many times the operations is left out: torus3D, half wrong, 9 minutes
FEWER = 0.8  # part of the pulling measurements; where fewer still pull the graph is made anew


@dataclass(frozen=True)
class Choice:
    """A choice of measurements that reproduces itself, or the last of eight; three are the rule.

    Attributes
    ----------
    result : the optimum of the inliers.
    graph : the inliers.
    inliers : per factor which of its measurements are kept.
    s : per factor (n,) squared residuals at the optimum, of all.
    cost : the sum of min(s, c^2) over tested measurements, of s over others.
    values : the optimum, and the landmarks that left at their last values.
    """

    result: Result
    graph: FactorGraph
    inliers: list[Mask]
    s: list[Array]
    cost: float
    values: Values

    @cached_property
    def marginals(self) -> Marginals:
        """Covariances of the optimum."""
        return Marginals(self.graph, self.result.values)


@dataclass(frozen=True)
class Truncated:
    """The problem of truncated least squares: a graph, and which of its measurements may be wrong.

    Attributes
    ----------
    masks : per factor which of its measurements are tested, all others are trusted.
    c2 : per factor the squared residual beyond which a tested one is rejected.
    landmarks : that leave with their measurements; none where it is not given.
    """

    graph: FactorGraph
    masks: list[Mask]
    c2: list[float]
    landmarks: Landmarks = field(default_factory=lambda: Landmarks(FactorGraph(), (), {}, {}))

    def scaled(self, variance: float) -> Truncated:
        """A problem with all thresholds c^2 times so much."""
        return replace(self, c2=[variance * c2 for c2 in self.c2])

    def rejected(self, inliers: list[Mask]) -> int:
        """How many tested measurements are not kept."""
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
        inliers = self._inliers(self._s(values), values)
        best = lowest(self.graph.only(inliers), self.landmarks.present(inliers, values))
        return self.settled(put_back(values, best.values))

    def softened(self, values: Values, inliers: list[Mask]) -> Choice:
        """The choice that follows from some inliers, the tested ones first under Geman and McClure's kernel.

        Its c^2 is the threshold, so that wrong ones among them bend the estimate little, and right ones come back.
        """
        factors: list[Factor] = []
        for factor, mask, kept, c2 in zip(self.graph.factors, self.masks, inliers, self.c2, strict=True):
            parts = (factor[kept & ~mask], factor[kept & mask].robust(GemanMcClure(c2**0.5)))
            factors += [part for part in parts if len(part)]
        graph, present = FactorGraph(factors, self.graph.fixed), self.landmarks.present(inliers, values)
        # steps must lower chi2 by so much of it; the choice that follows does the rest
        soft = graph.optimize(present, default_optimizer(factors, Stop(chi2_rtol=1e-3)))
        return self.settled(put_back(values, soft.values))

    def settled(self, values: Values) -> Choice:
        """The choice that reproduces itself, from what is within the thresholds at some values."""
        choice = self.optimum(values, self._inliers(self._s(values), values))
        for _ in range(7):  # two choices may take turns: the last one is taken
            inliers = self._inliers(choice.s, choice.values)
            if all((a == b).all() for a, b in zip(choice.inliers, inliers, strict=True)):
                break
            choice = self.optimum(choice.values, inliers)
        return choice

    def taken_back(self, choice: Choice) -> Choice:
        """The choice, with rejected measurements that the uncertainty of its map explains, where that lowers the cost.

        Their residual may be large because the map is uncertain; their distance d2 from its prediction is not.
        """
        inliers = [mask.copy() for mask in choice.inliers]
        for k, (bound, c2) in enumerate(zip(self.least_distances(choice), self.c2, strict=True)):
            if len(near := np.flatnonzero(bound <= c2)):
                inliers[k][near] = choice.marginals.distances(self.graph.factors[k][near]) <= c2
        if self.rejected(inliers) == self.rejected(choice.inliers):
            return choice
        other = self.settled(self.optimum(choice.values, inliers).values)
        return other if other.cost < choice.cost else choice

    def least_distances(self, choice: Choice) -> list[Array]:
        """Per factor (n,) a lower bound of d2 of what was rejected, nan of what was kept: Sigma <= 2 diag(Sigma_kk)."""
        bounds = [np.full(len(factor), np.nan) for factor in self.graph.factors]
        for factor, bound, mask, kept in zip(self.graph.factors, bounds, self.masks, choice.inliers, strict=True):
            if len(rows := np.flatnonzero(mask & ~kept)):
                model, X = choice.values.gather(factor[rows])
                A, b = model.linearize(*X)
                Sigma = [choice.marginals.covariance(keys[rows], frame="body") for keys in factor.keys]
                C = sum((congruence(A_k, Sigma_k) for A_k, Sigma_k in zip(A, Sigma, strict=True)), np.zeros(()))
                bound[rows] = innovation_distances(b, 2 * C)
        return bounds

    def optimum(self, values: Values, inliers: list[Mask]) -> Choice:
        """The optimum of some inliers."""
        graph = self.graph.only(inliers)
        result = graph.optimize(self.landmarks.present(inliers, values))
        values = put_back(values, result.values)
        s = self._s(values)
        parts = zip(self.masks, s, self.c2, strict=True)
        cost = sum(float(np.where(m, np.minimum(k, c2), k).sum()) for m, k, c2 in parts)
        return Choice(result, graph, inliers, s, cost, values)

    def among(self, choice: Choice, loops: LoopGraph, right: Mask) -> Choice:
        """The optimum of those of a choice that are among some closures (m,)."""
        masks = loops.masks(loops.accepted(choice.inliers) & right)
        return self.optimum(choice.values, [a & b for a, b in zip(choice.inliers, masks, strict=True)])

    def _s(self, values: Values) -> list[Array]:
        return [factor.chi2(values) for factor in self.graph.factors]

    def _inliers(self, s: list[Array], values: Values) -> list[Mask]:
        """Measurements within the thresholds, without those of landmarks that leave."""
        return self.landmarks.kept(self._within(s, 1.0), values)

    def _within(self, s: list[Array], far: float) -> list[Mask]:
        """Trusted measurements, and tested ones within so many thresholds."""
        return [~m | (k <= far * c2) for m, k, c2 in zip(self.masks, s, self.c2, strict=True)]

    def _bent(self, values: Values, loss: str, far: float) -> Values:
        """The values to which one Gauss-Newton step for every mu leads.

        Landmarks that are not determined say nothing of the poses, and stay out until the kernels are bent.
        """
        s = self._s(values)
        inside = self._within(s, far)
        robust: dict[int, Factor] = {}
        kernels: list[Graduated] = []
        for number, (factor, mask, k, c2) in enumerate(zip(self.graph.factors, self.masks, s, self.c2, strict=True)):
            if (near := mask & inside[number]).any():
                kernels.append(kernel := LOSSES[loss](c2**0.5))
                kernel.begin(float(k[near].max()))
                robust[number] = factor.robust(kernel)
        fewer = 1.0 if self.landmarks.factors else FEWER  # one measurement less may free a landmark
        while not all(kernel.done for kernel in kernels):
            kept = list(inside)
            for number, factor in robust.items():
                kept[number] = inside[number] & (~self.masks[number] | (factor.weights(values) > 0))
            kept = self.landmarks.kept(kept, values, lost=False)
            trusted = self.graph.only([k & ~mask for k, mask in zip(kept, self.masks, strict=True)]).factors
            parts = (factor[kept[number] & self.masks[number]] for number, factor in robust.items())
            pulling = tuple(part for part in parts if len(part))
            graph = FactorGraph([*trusted, *pulling], self.graph.fixed)
            bending = Bending(doubted=pulling, kernels=tuple(kernels), fewer=fewer)
            bent = graph.optimize(self.landmarks.present(kept, values), bending)
            values = put_back(values, bent.values)
        return values


@dataclass(frozen=True)
class Bending(Optimizer):
    """One Gauss-Newton step for every mu of some kernels, until the last or until few tested factors have weight.

    Wrong closures couple what is far apart: what no longer pulls costs as much as before while it is in the graph.

    Attributes
    ----------
    doubted : factors under the kernels.
    fewer : part of their measurements; it ends where fewer still pull.
    """

    doubted: tuple[Factor, ...] = ()
    kernels: tuple[Graduated, ...] = ()
    fewer: float = FEWER
    name = "graduated"

    def iterate(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        least = self.fewer * sum(map(len, self.doubted))
        while True:
            X = problem.retract(X, problem.solve(system))
            for kernel in self.kernels:
                kernel.bend()
            system = problem.linearize(X)
            pulling = sum(np.count_nonzero(factor.weights(X)) for factor in self.doubted)
            if pulling < least or all(kernel.done for kernel in self.kernels):
                break
        watch.best, watch.lowest = X, system.chi2
        watch.end(Status.STOPPED, "the kernels have reached their final shape, or too few measurements have weight")


def lowest(graph: FactorGraph, values: Values) -> Result:
    """The optimum from the values or from the chordal start, whichever is lower."""
    result = graph.optimize(values)
    start = chordal(graph, values)
    if start is not values:
        other = graph.optimize(start)
        if other.chi2_final < result.chi2_final * (1 - 1e-3):
            return other
    return result
