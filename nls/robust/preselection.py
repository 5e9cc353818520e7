"""Choice among loop closures: all of them where these explain each other, else from those that `grown` accepts.

Graduation follows one minimum only and cannot leave it by itself. Where groups are few a choice is improved by giving
up one group or taking one back. Closures that agree with neighbors are one witness, however many they are, and stay
together. Each move is solved for; the one that lowers the cost, the sum of min(s, c^2), the most is taken, until none
does. Where closures are many no group decides alone, and each move costs as much as the whole choice.

Why the choice may be wrong is the matter of `nls.robust.verdict`.
"""

from math import ceil

import numpy as np

from models.algebra import Mask
from models.chi_squared import chi2_gate
from nls.optimizers import Automatic, Iteration
from nls.robust import verdict
from nls.robust.accepted_closures import Witness, grown, misfits, witnesses
from nls.robust.loop_graph import LoopGraph
from nls.robust.truncated_least_squares import DEARER, Choice, Truncated, lowest
from nls.robust.verdict import Doubt, Evidence
from nls.starts.chordal import chordal

HEAVY_TAILS = 3.0  # times sigma0 of what was accepted: residuals have heavier tails than chi2
MANY_CLOSURES = 600  # among which none is exchanged: there are others that check each


class Preselection:
    """A choice among the loop closures of a graph.

    Attributes
    ----------
    choice : of measurements, and its optimum; it is compared with its rivals.
    variance : factor on the squares of the stated sigmas for the threshold.
    """

    def __init__(self, problem: Truncated, loops: LoopGraph, loss: str, probability: float) -> None:
        self.problem, self.loops, self.loss, self.probability = problem, loops, loss, probability
        self.rivals: list[Choice] = []
        self.tried = False
        self._judged: tuple[Choice | None, list[Witness]] = None, []
        explained = self._explained()
        self.choice, self.variance = explained or self._grown()
        self.moved = 0.0
        for _ in range(0 if explained else 3):
            other, self.moved = self._without_contradicted(self.choice)
            if self.moved <= verdict.SAME_MAP:
                break
            self.choice = other

    def kept(self) -> Choice:
        """The choice, with right closures that the uncertainty of its map explains, if they contradict no group."""
        taken = self.problem.scaled(self.variance).taken_back(self.choice)
        return taken if self._without_contradicted(taken)[1] <= verdict.SAME_MAP else self.choice

    def doubts(self) -> list[Doubt]:
        """Reasons not to trust the choice, see `nls.robust.verdict`."""
        of_choice = self.problem, self.loops, self.choice, self.rivals, self.tried, self.variance
        return verdict.preselected(Evidence(*of_choice, self._witnesses(self.choice), self.moved), self.probability)

    def _explained(self) -> tuple[Choice, float] | None:
        """All closures but a few, where noise explains the optimum of all; None where it does not."""
        loops, graph = self.loops, self.loops.graph
        if loops.neighbors.passing < 0.95 or self._dearer(DEARER):
            return None  # odometry allows so few that some are wrong
        rows = graph.pattern(loops.values).measured_rows

        def hopeless(step: Iteration) -> bool:
            return step.number >= 3 and step.chi2 > 2.0 * rows  # clean graphs have 0.5 then

        first = graph.optimize(chordal(graph, loops.values), Automatic(callback=hopeless))
        if not first.converged or first.dof < 1 or first.chi2_final > chi2_gate(first.dof, 1 - verdict.UNLIKELY):
            return None
        if verdict.strain(loops, first) > verdict.STRAIN:
            return None
        variance = min(HEAVY_TAILS**2 * verdict.noise(first), 1.0)
        choice = self.problem.scaled(variance).settled(first.values)
        chance = ceil((1 - self.probability) * len(loops.closures))
        if self.problem.rejected(choice.inliers) > chance or self._without_contradicted(choice)[1] > verdict.SAME_MAP:
            return None
        return choice, variance

    def _grown(self) -> tuple[Choice, float]:
        """From the closures that could be accepted one after the other."""
        loops, growth = self.loops, grown(self.loops)
        first = lowest(loops.graph.only(growth.masks), growth.values)
        noise = verdict.noise(first) if loops.accepted(growth.masks).any() else 1.0  # odometry fits by itself
        variance = min(HEAVY_TAILS**2 * noise, max(1.0, noise))
        problem = self.problem.scaled(variance)
        reaches = problem.affordable(first.values, (10.0, 1000.0))  # in thresholds
        choices = [problem.choice(first.values, self.loss, far) for far in reaches]
        self.rivals = sorted(choices, key=lambda choice: choice.cost)
        if not self._dearer(2.0):
            other = problem.choice(loops.values, self.loss, np.inf)
            better = other.cost < self.rivals[0].cost - 7.0 * max(problem.c2)  # seven rejections
            self.rivals.insert(0 if better else 1, other)
        choice, alternatives = exchanged(problem, loops, self.rivals[0])
        self.rivals, self.tried = [choice, *self.rivals, *alternatives], bool(alternatives)
        return choice, variance

    def _dearer(self, times: float) -> bool:
        """Whether all closures take so many times the operations of those that agree with a neighbor."""
        loops = self.loops
        chosen = np.ones(len(loops.closures), dtype=bool), loops.neighbors.support > 0
        whole, supported = (self.problem.flops(loops.values, loops.masks(mask)) for mask in chosen)
        return whole > times * supported

    def _without_contradicted(self, choice: Choice) -> tuple[Choice, float]:
        """The choice without the groups that the others contradict, and how far the map moves, part of its extent."""
        wrong = misfits(self._witnesses(choice), choice.result, self.loops)
        if not wrong.any():
            return choice, 0.0
        other = self.problem.among(choice, self.loops, ~wrong)
        return other, verdict.difference(self.loops, choice.result.values, other.result.values).fraction

    def _witnesses(self, choice: Choice) -> list[Witness]:
        """The groups of a choice, tested against its other closures; stored, as they cost a covariance."""
        if self._judged[0] is not choice:
            inliers = self.loops.accepted(choice.inliers)
            groups = list(witnesses(self.loops, choice.result.values, inliers)) if inliers.any() else []
            self._judged = choice, groups
        return self._judged[1]


def exchanged(problem: Truncated, loops: LoopGraph, choice: Choice) -> tuple[Choice, list[Choice]]:
    """The choice no move improves, and where the last moves led."""
    cluster = loops.neighbors.cluster
    groups = np.unique(cluster)
    alternatives: list[Choice] = []
    if len(groups) > 60 or len(cluster) > MANY_CLOSURES:
        return choice, alternatives
    for _ in range(10):
        inliers = loops.accepted(choice.inliers)
        alternatives = [_moved(problem, loops, choice, inliers, cluster == group) for group in groups]
        best = min(alternatives, key=lambda alternative: alternative.cost)
        if best.cost >= choice.cost * (1 - 1e-3):
            break
        choice = best
    return choice, alternatives


def _moved(problem: Truncated, loops: LoopGraph, choice: Choice, inliers: Mask, group: Mask) -> Choice:
    """The choice without a group, or with all of it where most of it is rejected."""
    takes = 2 * (inliers & group).sum() < group.sum()
    masks = loops.masks(inliers | group if takes else inliers & ~group)
    return problem.settled(problem.graph.only(masks).optimize(choice.result.values).values)
