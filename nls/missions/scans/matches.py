"""Matches as columns, one row each: the candidates of closing and what became of them, and scans with those before.

A scan that fits those just before it tells what the sensor says of the way itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import groupby

import numpy as np

from factors import Cauchy, Covariance, Robust, SequentialMatch
from factors.keys import kinds
from models import SE2
from models.algebra import Array, Index, Mask
from nls.missions.scans.correlation import INDEPENDENT_POINTS, Field, Match, match_submap
from nls.missions.scans.scans import SUBMAP_HALF, Scans, submap

LEAST_SCORE = 0.8  # log-likelihood of a point: nearly any; a high floor loses the map, not the wrong matches
LEAST_ODDS = 1.5  # log odds of the best place against the second, in a window of 3 m
WIDEST_SPREAD = 1.0  # m, standard deviation of the position
KEYFRAMES_BEFORE = 6  # with which a scan is matched
WINDOW_BEFORE = (2.0, float(np.radians(4.0)))  # half widths of the search, m, rad
x = kinds("x")[0]


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
    odds = INDEPENDENT_POINTS * score * (1 - ratio)
    doubt = odds < LEAST_ODDS + 2 * np.log(window / 3.0)
    reasons = [score < LEAST_SCORE, edge > 0.3, spread > WIDEST_SPREAD, doubt]
    names = [Verdict.NO_FIT, Verdict.AT_THE_RIM, Verdict.WIDE, Verdict.AMBIGUOUS]
    return np.asarray(np.select(reasons, names, ACCEPTED), dtype=np.intp)


@dataclass(frozen=True)
class MatchTable:
    """Matches, one row each; see `Match`.

    Attributes
    ----------
    pose : (n, 3) x, y, m, and yaw, rad.
    covariance : (n, 3, 3) in the frame of the scan, m and rad.
    score, ratio, edge, spread : (n,)

    Examples
    --------
    >>> import numpy as np
    >>> one = Match(np.array([1.0, 0.0, 0.2]), np.diag([0.04, 0.01, 1e-4]), score=2.0, second=0.5, edge=0.1)
    >>> fits = MatchTable.of([one])
    >>> fits.pose, fits.ratio, fits.spread
    (array([[1. , 0. , 0.2]]), array([0.25]), array([0.2]))
    """

    pose: Array
    covariance: Array
    score: Array
    ratio: Array
    edge: Array
    spread: Array

    @classmethod
    def of(cls, matches: Sequence[Match]) -> MatchTable:
        """The columns of matches, in their order; empty ones of no match."""
        numbers = np.array([(match.score, match.ratio, match.edge, match.spread) for match in matches])
        return cls(
            np.array([match.pose for match in matches]).reshape(-1, 3),
            np.array([match.covariance for match in matches]).reshape(-1, 3, 3),
            *numbers.reshape(-1, 4).T,
        )


@dataclass(frozen=True)
class Matches(MatchTable):
    """The matched candidates of a round, one row each.

    Attributes
    ----------
    i, j : (n,) keyframes in the middle of the earlier and of the later submap.
    pose, covariance : of j in the frame of i, see `MatchTable`.
    window : (n, 2) half widths of the search, m and rad.
    verdict : (n,) `Verdict`, accepted or why not.
    kept : (n,) whether the selection kept it.
    """

    i: Index
    j: Index
    window: Array
    verdict: Index
    kept: Mask

    def __len__(self) -> int:
        return len(self.i)

    @classmethod
    def around(cls, poses: Array, scans: Scans, i: Index, j: Index, window: Array) -> Matches:
        """Match the submaps (n,) around keyframes j with those around i, from present poses (count, 3), and judge."""
        guess = SE2.between(poses[i], poses[j])
        part = {k: submap(poses, scans, k, SUBMAP_HALF) for k in np.unique(np.append(i, j)).tolist()}
        by_field: list[Match] = []
        order = np.argsort(i, kind="stable")  # one field at a time: they are large
        for a, rows in groupby(order.tolist(), key=lambda row: int(i[row])):
            field = Field(part[a])
            for row in rows:
                reach, turn = window[row].tolist()
                by_field.append(match_submap(field, part[int(j[row])], guess[row], (reach, turn)))
        fits = MatchTable.of([by_field[place] for place in np.argsort(order).tolist()])
        verdict = verdicts(fits.score, fits.ratio, fits.edge, fits.spread, window[:, 0])
        return cls(**vars(fits), i=i, j=j, window=window, verdict=verdict, kept=np.zeros(len(i), dtype=bool))

    @property
    def accepted(self) -> Mask:
        """(n,) whether the selection was to judge it."""
        return np.asarray(self.verdict == ACCEPTED)


def sequential_matches(poses: Array, scans: Scans) -> SequentialMatch | None:
    """One factor between a keyframe and one a few before it for every scan that fits those before; None without any.

    A kernel weighs them: the points that are common to all scans because they move with the vehicle say that it stands.

    Parameters
    ----------
    poses : (count, 3) present estimate, SE2.
    scans : the points.
    """
    k = comparable(scans)
    fits = MatchTable.of(
        [match_submap(field_before(poses, scans, j), scans[j], np.zeros(3), WINDOW_BEFORE) for j in k.tolist()]
    )
    unjudged = np.zeros(len(k))  # ratio: a second place is no reason against a match in so narrow a window
    accepted = verdicts(fits.score, unjudged, fits.edge, fits.spread, np.full(len(k), WINDOW_BEFORE[0])) == ACCEPTED
    if not accepted.any():
        return None
    j = k[accepted]
    i = np.maximum(j - (KEYFRAMES_BEFORE + 1) // 2, 0)
    z = SE2.compose(SE2.between(poses[i], poses[j]), fits.pose[accepted])
    C = (KEYFRAMES_BEFORE + 1) * fits.covariance[accepted]  # the points of a scan take part in so many matches
    return SequentialMatch(x[i], x[j], z, Robust(Covariance(C), Cauchy(1.0)))


def comparable(scans: Scans) -> Index:
    """Keyframes (n,) that have points enough, and enough in the keyframes before them."""
    starts, k = scans.starts, np.arange(len(scans))
    before = starts[k] - starts[np.maximum(k - KEYFRAMES_BEFORE, 0)]
    return np.flatnonzero((np.diff(starts) >= 20) & (before >= 40))


def field_before(poses: Array, scans: Scans, k: int) -> Field:
    """The field of the keyframes before one, in its frame, from poses (count, 3)."""
    return Field(submap(poses, scans, k, (KEYFRAMES_BEFORE, -1)))
