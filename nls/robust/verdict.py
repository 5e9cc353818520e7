"""When an estimate from chosen closures is doubtful: too little was kept, or what was kept does not fit together.

Every kind of doubt, its sentence, its bound and what decides it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from models.algebra import Mask
from nls.analysis.chi_squared import chi2_gate
from nls.metrics import displacements
from nls.optimizers import Result
from nls.robust.consistency import unit_variance
from nls.robust.groups import Witness, misfits
from nls.robust.loop_graph import LoopGraph
from nls.robust.truncated_least_squares import Choice, Truncated
from nls.values import Values

__all__ = ["Doubt", "DoubtKind", "Evidence", "doubts", "noise", "preselected", "shift", "strain"]

HALF = 0.5  # of the doubted measurements, of the steps between closures
TAIL = 0.025  # of chi2 to be larger by noise
TWICE = 2.0  # chi2 over degrees of freedom
UNLIKELY = 0.05  # of chi2 to be smaller, or larger
STILL = 0.005  # of the extent: a map that moves less is the same
STRAIN = 2.38  # times the typical noise between neighbors; of public graphs 0.9 to 2.35
CHANCE = 0.1  # with which a wrong closure may pass; on public graphs 0.2 % at most
MANY = 0.6  # of the closures kept; where fewer are, sigmas that neighbors contradict are a doubt of their own
QUIET = 0.6  # times the stated sigmas: a map with less noise shows that these are not too small
NOISIER = 2.5  # times the noise of all else; of right maps that move without such closures 1.3 at most
RIVAL, AWAY = 7.0, 0.01  # measurements by which a rival fits worse, at most; part of the extent to its map, at least


class DoubtKind(Enum):
    """Why an estimate is doubtful; the value is the sentence."""

    FEW_KEPT = "{count} of {total} doubted measurements were kept, less than half"
    DEAD_RECKONING = "the kept closures span {count} of the {total} odometry steps that all closures span"
    CONTRADICTED = (
        "{count} of {total} kept closures contradict the others: without them the map moves by {percent:.2g} %"
    )
    UNCHECKED = "a wrong closure would pass with a probability of {percent:.2g} %: too little checks the closures"
    ALONE = (
        "{count} of {total} kept closures agree with no neighbor, their noise is {number:.3g} times that of the others,"
        " and without them the map moves by {percent:.2g} %"
    )
    RIVAL = "another choice fits about as well, its cost {number:+.2g} rejections, and its map is {percent:.2g} % away"
    STRAINED = "the noise of the map is {number:.3g} times that between neighboring closures"
    UNEXPLAINED = "chi2 of the kept measurements is {number:.3g} times its degrees of freedom"
    SIGMAS = (
        "most neighboring closures differ by {number:.3g} times their sigmas: these are too small, or most are wrong"
    )


@dataclass(frozen=True)
class Doubt:
    """One reason for doubt, and its numbers.

    Attributes
    ----------
    kind : the reason.
    count, total : how many measurements, or steps, of how many.
    number : a ratio, or how many measurements.
    fraction : of its extent, by which the map moves; a probability.
    """

    kind: DoubtKind
    count: int = 0
    total: int = 0
    number: float = float("nan")
    fraction: float = float("nan")

    def __str__(self) -> str:
        numbers = {"count": self.count, "total": self.total, "number": self.number, "percent": 100 * self.fraction}
        return self.kind.value.format(**numbers)


def doubts(result: Result, inlier_count: int, doubted: int, probability: float) -> list[Doubt]:
    """Reasons to doubt any choice: how much was kept, and whether chi2 of it is explained.

    Of a right half some are lost by chance: the bound is `probability` times half.
    """
    reasons = []
    if inlier_count < HALF * probability * doubted:
        reasons.append(Doubt(DoubtKind.FEW_KEPT, inlier_count, doubted))
    if result.dof > 0 and result.chi2_final > max(TWICE * result.dof, chi2_gate(result.dof, 1 - TAIL)):
        reasons.append(Doubt(DoubtKind.UNEXPLAINED, number=result.chi2_final / result.dof))
    return reasons


def shift(loops: LoopGraph, before: Values, after: Values) -> float:
    """How far a map moves, as part of its extent: rms of the positions, after the best motion; 1 without positions."""
    p, q = (loops.places(values) for values in (before, after))
    extent = float(np.ptp(p, axis=0).max()) if p.shape[1] else 0.0
    return float(np.sqrt(np.square(displacements(p, q)).mean())) / extent if extent else 1.0


@dataclass(frozen=True)
class Evidence:
    """A choice among loop closures, and what speaks against it.

    Attributes
    ----------
    rivals : other choices, in the order of their cost.
    variance : factor on the squares of the stated sigmas for the threshold.
    judged : the groups of the choice, judged by its other closures.
    moved : part of its extent by which the map moves without the contradicted groups.
    """

    problem: Truncated
    loops: LoopGraph
    choice: Choice
    rivals: list[Choice]
    variance: float
    judged: list[Witness]
    moved: float


def preselected(evidence: Evidence, probability: float) -> list[Doubt]:
    """Reasons to doubt a choice among loop closures."""
    loops, result, moved = evidence.loops, evidence.choice.result, evidence.moved
    inliers = loops.accepted(evidence.choice.inliers)
    m, n = len(inliers), int(inliers.sum())
    reasons = doubts(result, n, m, probability)
    span, spans = loops.spanned(inliers), loops.spanned(np.ones(m, dtype=bool))
    if span < HALF * spans:
        reasons.append(Doubt(DoubtKind.DEAD_RECKONING, span, spans))
    if moved > STILL:
        count = int(misfits(evidence.judged, result, loops).sum())
        reasons.append(Doubt(DoubtKind.CONTRADICTED, count, n, fraction=moved))
    reasons += [*_alone(evidence, inliers), *_rivals(evidence), *_unchecked(evidence, inliers)]
    if (ratio := strain(loops, result)) > STRAIN:
        reasons.append(Doubt(DoubtKind.STRAINED, number=ratio))
    small = loops.neighbors.typical > 1 and _sigmas(result) > QUIET
    if small and (reasons or n < MANY * m):
        reasons.append(Doubt(DoubtKind.SIGMAS, number=loops.neighbors.typical))
    return reasons


def strain(loops: LoopGraph, result: Result) -> float:
    """Noise of an optimum over the typical one between neighbors, or the stated one if that is less."""
    return _sigmas(result) / min(loops.neighbors.typical, 1.0)


def _unchecked(evidence: Evidence, inliers: Mask) -> list[Doubt]:
    """Whether a wrong closure would pass; groups that agree are believed where only single ones were rejected.

    Where all closures make one group, there is nothing to choose.
    """
    _, sizes = np.unique(evidence.loops.neighbors.cluster[~inliers], return_counts=True)
    single = len(sizes) > 0 and (sizes == 1).all()
    chances = [0.0 if single and len(w.members) > 1 else w.chance for w in evidence.judged]
    mean = float(np.mean(chances or [0.0]))
    chosen = not inliers.all() or len(chances) > 1
    return [Doubt(DoubtKind.UNCHECKED, fraction=mean)] if mean > CHANCE and chosen else []


def _alone(evidence: Evidence, inliers: Mask) -> list[Doubt]:
    """Whether the closures (m,) that agree with no neighbor are much noisier than all else without them.

    Where the stated sigmas are too large wrong closures fit, and right ones fit much better. One by one the wrong ones
    hide each other, so they are left out together.
    """
    loops, result = evidence.loops, evidence.choice.result
    alone = inliers & (loops.neighbors.support == 0)
    if not alone.any() or alone.sum() == inliers.sum():
        return []
    other = evidence.problem.among(evidence.choice, loops, ~alone).result
    if not 0 < other.dof < result.dof:
        return []
    ratio = (result.chi2_final - other.chi2_final) / (result.dof - other.dof) / noise(other)
    if ratio <= NOISIER**2 or (moved := shift(loops, result.values, other.values)) <= AWAY:
        return []
    count, total = int(alone.sum()), int(inliers.sum())
    return [Doubt(DoubtKind.ALONE, count, total, number=float(np.sqrt(ratio)), fraction=moved)]


def _rivals(evidence: Evidence) -> list[Doubt]:
    """The first choice that fits nearly as well, but for a different map."""
    c2 = evidence.variance * max(evidence.problem.c2)
    for rival in evidence.rivals[1:]:
        worse = (rival.cost - evidence.rivals[0].cost) / c2
        away = shift(evidence.loops, evidence.choice.result.values, rival.result.values)
        if worse <= RIVAL and away > AWAY:
            return [Doubt(DoubtKind.RIVAL, number=worse, fraction=away)]
    return []


def _sigmas(result: Result) -> float:
    """Noise of an optimum, in the stated sigmas."""
    return float(np.sqrt(result.chi2_final / max(result.dof, 1)))


def noise(result: Result) -> float:
    """chi2 over its 5 % quantile, as of few numbers it may be small by chance; 1 where all fit exactly."""
    return unit_variance(result.chi2_final / chi2_gate(max(result.dof, 1), UNLIKELY))
