"""Which matches a selection may judge, and why the others may not."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from models.algebra import Array, Index
from nls.sonar.scans import matching

__all__ = ["ACCEPTED", "Verdict", "verdicts"]

SCORE = 0.8  # least log-likelihood for every point: nearly anything; a high floor loses the map, not the wrong matches
ODDS = 1.5  # least log odds of the best place against the second, in a window of `WIDTH`
WIDTH = 3.0  # m
EDGE = 0.3  # most probability at the rim of the window
SPREAD = 1.0  # m, most standard deviation of the position


class Verdict(IntEnum):
    """The verdict on a match."""

    ACCEPTED = 0
    NO_FIT = 1
    AMBIGUOUS = 2
    AT_THE_RIM = 3
    WIDE = 4


ACCEPTED = Verdict.ACCEPTED


def verdicts(score: Array, ratio: Array, edge: Array, spread: Array, window: Array) -> Index:
    r"""`Verdict` (n,) of matches: the first that applies.

    The odds of the best place against the second are :math:`\exp(n\,(S_1 - S_2))` with n independent points. A window
    with twice as many places has twice as many that may fit by chance, so its odds have to be twice as large:

    .. math:: n\,(S_1 - S_2) \ge 1.5 + 2 \log(w / 3 m)

    Parameters
    ----------
    score, ratio, edge, spread : (n,), see `Match`.
    window : (n,) half widths w of the search in x and y, m.

    Examples
    --------
    >>> import numpy as np
    >>> same = dict(score=np.full(2, 2.0), ratio=np.full(2, 0.96), edge=np.zeros(2), spread=np.full(2, 0.4))
    >>> [Verdict(v).name for v in verdicts(**same, window=np.array([3.0, 20.0]))]
    ['ACCEPTED', 'AMBIGUOUS']
    """
    odds = matching.INDEPENDENT * score * (1 - ratio)
    reasons = [score < SCORE, edge > EDGE, spread > SPREAD, odds < ODDS + 2 * np.log(window / WIDTH)]
    names = [Verdict.NO_FIT, Verdict.AT_THE_RIM, Verdict.WIDE, Verdict.AMBIGUOUS]
    return np.asarray(np.select(reasons, names, ACCEPTED), dtype=np.intp)
