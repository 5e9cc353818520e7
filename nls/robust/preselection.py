"""What is chosen among loop closures: all of them where these explain each other, else from what `growth` accepts.

`Preselection.doubts` says why the choice may be wrong.
"""

from __future__ import annotations

from math import ceil

import numpy as np

from models.algebra import Mask
from nls.analysis.chi_squared import chi2_gate
from nls.optimizers import Automatic, Iteration, Result
from nls.robust import verdict
from nls.robust.consistency import unit_variance
from nls.robust.exchange import exchanged
from nls.robust.groups import Witness, misfits, witnesses
from nls.robust.growth import grown
from nls.robust.loop_graph import LoopGraph
from nls.robust.truncated_least_squares import DEARER, Choice, Truncated, lowest
from nls.robust.verdict import Doubt, DoubtKind
from nls.sparse.pattern import measured_rows
from nls.starts import chordal

__all__ = ["Preselection"]

FAR = (10.0, 1000.0)  # thresholds within which closures pull at first: the lower cost is taken
WIDE = 3.0  # times sigma0 of what was accepted: residuals have heavier tails than chi2
UNLIKELY = 0.05  # of chi2 to be smaller, or larger
MOST = 0.95  # of all closures; where odometry allows fewer, some are wrong
STILL = 0.005  # of the extent: a map that moves less is the same
STRAIN = 2.38  # times the typical noise between neighbors; of public graphs 0.9 to 2.35
CHANCE = 0.1  # with which a wrong closure may pass; on public graphs 0.2 % at most
MANY = 0.6  # of the closures kept; where fewer are, sigmas that neighbors contradict are a doubt of their own
QUIET = 0.6  # times the stated sigmas: a map with less noise shows that these are not too small
SOLE = 3  # groups of closures; where no more are there, and none is rejected, nothing was chosen
NOISIER = 2.5  # times the noise of all else; of right maps that move without such closures 1.3 at most
RIVAL, AWAY = 7.0, 0.01  # measurements by which a rival fits worse, at most; part of the extent to its map, at least
CHEAP = 2.0  # times the operations at which all closures are tried from odometry, too
SETTLED, HOPELESS = 3, 2.0  # steps from a chordal start, and chi2 per row then that noise will not explain; clean: 0.5
TURNS = 3  # of giving up contradicted groups


class Preselection:
    """A choice among the loop closures of a graph.

    Attributes
    ----------
    choice : of measurements, and its optimum.
    variance : what the squares of the stated sigmas were multiplied by for the threshold.
    """

    def __init__(self, problem: Truncated, loops: LoopGraph, loss: str, probability: float) -> None:
        self.problem, self.loops, self.loss, self.probability = problem, loops, loss, probability
        self.rivals: list[Choice] = []
        self._judged: tuple[Choice | None, list[Witness]] = None, []
        explained = self._explained()
        self.choice, self.variance = explained or self._grown()
        self.moved = 0.0
        for _ in range(0 if explained else TURNS):
            other, self.moved = self._without_contradicted(self.choice)
            if self.moved <= STILL:
                break
            self.choice = other

    def doubts(self) -> list[Doubt]:
        """Reasons to doubt the choice."""
        loops, result = self.loops, self.choice.result
        inliers = loops.accepted(self.choice.inliers)
        m, n = len(inliers), int(inliers.sum())
        reasons = verdict.doubts(result, n, m, self.probability)
        span, spans = loops.spanned(inliers), loops.spanned(np.ones(m, dtype=bool))
        if span < verdict.HALF * spans:
            reasons.append(Doubt(DoubtKind.DEAD_RECKONING, span, spans))
        if self.moved > STILL:
            count = int(misfits(self._witnesses(self.choice), result, loops).sum())
            reasons.append(Doubt(DoubtKind.CONTRADICTED, count, n, fraction=self.moved))
        reasons += self._alone(inliers)
        reasons += self._rivals()
        reasons += self._unchecked(inliers)
        if (strain := self._strain(result)) > STRAIN:
            reasons.append(Doubt(DoubtKind.STRAINED, number=strain))
        small = loops.neighbors.typical > 1 and _sigmas(result) > QUIET
        if small and (reasons or n < MANY * m):
            reasons.append(Doubt(DoubtKind.SIGMAS, number=loops.neighbors.typical))
        return reasons

    def _strain(self, result: Result) -> float:
        """Noise of an optimum over the typical one between neighbors, or the stated one if that is less."""
        return _sigmas(result) / min(self.loops.neighbors.typical, 1.0)

    def _unchecked(self, inliers: Mask) -> list[Doubt]:
        """Whether a wrong closure would pass; of groups that agree only where wrong ones come in groups, too."""
        loops = self.loops
        _, sizes = np.unique(loops.neighbors.cluster[~inliers], return_counts=True)
        alike = (sizes > 1).any()
        judged = self._witnesses(self.choice)
        chances = [w.chance if alike or len(w.members) == 1 else 0.0 for w in judged]
        mean = float(np.mean(chances or [0.0]))
        chosen = not inliers.all() or len(chances) > SOLE
        return [Doubt(DoubtKind.UNCHECKED, fraction=mean)] if mean > CHANCE and chosen else []

    def _alone(self, inliers: Mask) -> list[Doubt]:
        """Whether the closures (m,) that agree with no neighbor are much noisier than all else without them.

        Where the stated sigmas are too large wrong closures fit, and right ones fit much better. One by one the wrong
        ones hide each other, so they are left out together.
        """
        loops, result = self.loops, self.choice.result
        alone = inliers & (loops.neighbors.support == 0)
        if not alone.any() or alone.sum() == inliers.sum():
            return []
        other = self._only(self.choice, ~alone)
        if not 0 < other.result.dof < result.dof:
            return []
        ratio = (result.chi2_final - other.result.chi2_final) / (result.dof - other.result.dof) / _noise(other.result)
        if ratio <= NOISIER**2 or (moved := verdict.shift(loops, result.values, other.result.values)) <= AWAY:
            return []
        count, total = int(alone.sum()), int(inliers.sum())
        return [Doubt(DoubtKind.ALONE, count, total, number=float(np.sqrt(ratio)), fraction=moved)]

    def _rivals(self) -> list[Doubt]:
        """The first choice that fits nearly as well, but for a different map."""
        c2 = self.variance * max(self.problem.c2)
        for rival in self.rivals[1:]:
            worse = (rival.cost - self.rivals[0].cost) / c2
            away = verdict.shift(self.loops, self.choice.result.values, rival.result.values)
            if worse <= RIVAL and away > AWAY:
                return [Doubt(DoubtKind.RIVAL, number=worse, fraction=away)]
        return []

    def _explained(self) -> tuple[Choice, float] | None:
        """All closures but a few, where noise explains the optimum of all; None where it does not."""
        loops, graph = self.loops, self.loops.graph
        if loops.neighbors.passing < MOST or self._dearer(DEARER):
            return None
        rows = measured_rows(graph.pattern(loops.values))

        def hopeless(step: Iteration) -> bool:
            return step.number >= SETTLED and step.chi2 > HOPELESS * rows

        first = graph.optimize(chordal(graph, loops.values), Automatic(callback=hopeless))
        noise = _noise(first)
        if not first.converged or first.dof < 1 or first.chi2_final > chi2_gate(first.dof, 1 - UNLIKELY):
            return None
        if self._strain(first) > STRAIN:
            return None
        variance = min(WIDE**2 * noise, 1.0)
        choice = self.problem.scaled(variance).settled(first.values)
        chance = ceil((1 - self.probability) * len(loops.closures))
        if self.problem.rejected(choice.inliers) > chance or self._without_contradicted(choice)[1] > STILL:
            return None
        return choice, variance

    def _grown(self) -> tuple[Choice, float]:
        """From the closures that could be accepted one after the other."""
        loops, growth = self.loops, grown(self.loops)
        first = lowest(loops.graph.only(growth.masks), growth.values)
        noise = _noise(first) if loops.accepted(growth.masks).any() else 1.0  # odometry fits by itself
        variance = min(WIDE**2 * noise, max(1.0, noise))
        problem = self.problem.scaled(variance)
        choices = [problem.choice(first.values, self.loss, far) for far in problem.affordable(first.values, FAR)]
        self.rivals = sorted(choices, key=lambda choice: choice.cost)
        if not self._dearer(CHEAP):
            other = problem.choice(loops.values, self.loss, np.inf)
            better = other.cost < self.rivals[0].cost - RIVAL * max(problem.c2)
            self.rivals.insert(0 if better else 1, other)
        choice, alternatives = exchanged(problem, loops, self.rivals[0])
        self.rivals = [choice, *self.rivals, *alternatives]
        return choice, variance

    def _dearer(self, times: float) -> bool:
        """Whether all closures take so many times the operations of those that agree with a neighbor."""
        loops = self.loops
        every = np.ones(len(loops.closures), dtype=bool)
        whole, supported = (
            self.problem.flops(loops.values, loops.masks(m)) for m in (every, loops.neighbors.support > 0)
        )
        return whole > times * supported

    def _without_contradicted(self, choice: Choice) -> tuple[Choice, float]:
        """The choice without the groups that the others contradict, and how far the map moves, part of its extent."""
        wrong = misfits(self._witnesses(choice), choice.result, self.loops)
        if not wrong.any():
            return choice, 0.0
        other = self._only(choice, ~wrong)
        return other, verdict.shift(self.loops, choice.result.values, other.result.values)

    def _only(self, choice: Choice, right: Mask) -> Choice:
        """The optimum of those of a choice that are among some closures (m,)."""
        masks = self.loops.masks(self.loops.accepted(choice.inliers) & right)
        return self.problem.without(choice, [a & b for a, b in zip(choice.inliers, masks, strict=True)])

    def _witnesses(self, choice: Choice) -> list[Witness]:
        """The groups of a choice, judged by its other closures; kept for the last choice, as they cost a covariance."""
        if self._judged[0] is not choice:
            inliers = self.loops.accepted(choice.inliers)
            groups = list(witnesses(self.loops, choice.result.values, inliers)) if inliers.any() else []
            self._judged = choice, groups
        return self._judged[1]


def _sigmas(result: Result) -> float:
    """Noise of an optimum, in the stated sigmas."""
    return float(np.sqrt(result.chi2_final / max(result.dof, 1)))


def _noise(result: Result) -> float:
    """chi2 over its 5 % quantile, as of few numbers it may be small by chance; 1 where all fit exactly."""
    return unit_variance(result.chi2_final / chi2_gate(max(result.dof, 1), UNLIKELY))
