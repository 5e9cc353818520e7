"""When an estimate from chosen closures is doubtful: too little was kept, or what was kept does not fit together."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from nls.analysis.chi_squared import chi2_gate
from nls.metrics import displacements
from nls.optimizers import Result
from nls.robust.loop_graph import LoopGraph
from nls.values import Values

__all__ = ["Doubt", "DoubtKind", "doubts", "shift"]

HALF = 0.5  # of the doubted measurements, of the steps between closures
TAIL = 0.025  # of chi2 to be larger by noise
TWICE = 2.0  # chi2 over degrees of freedom


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
