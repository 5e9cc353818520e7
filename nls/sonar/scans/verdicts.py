"""Which matches a selection may judge, and why the others may not."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from models.algebra import Array, Index

__all__ = ["ACCEPTED", "Verdict", "verdicts"]

SCORE = 0.8  # least log-likelihood for every point: nearly anything; a high floor loses the map, not the wrong matches
RATIO = 0.95  # most of the second score over the first
EDGE = 0.3  # most probability at the rim of the window
SPREAD = 1.5  # m, most standard deviation of the position


class Verdict(IntEnum):
    """What became of a match."""

    ACCEPTED = 0
    NO_FIT = 1
    AMBIGUOUS = 2
    AT_THE_RIM = 3
    WIDE = 4


ACCEPTED = Verdict.ACCEPTED


def verdicts(score: Array, ratio: Array, edge: Array, spread: Array) -> Index:
    """`Verdict` (n,) of matches by their score, ratio, edge and spread (n,), see `Match`: the first that applies."""
    reasons = [score < SCORE, edge > EDGE, spread > SPREAD, ratio > RATIO]
    names = [Verdict.NO_FIT, Verdict.AT_THE_RIM, Verdict.WIDE, Verdict.AMBIGUOUS]
    return np.asarray(np.select(reasons, names, ACCEPTED), dtype=np.intp)
