"""The candidates of closing, matched: one row each, with what became of it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from models import SE2
from models.algebra import Array, Index, Mask
from nls.sonar.scans import candidates
from nls.sonar.scans.field import Field
from nls.sonar.scans.fits import Fits
from nls.sonar.scans.matching import Match
from nls.sonar.scans.scans import Scans
from nls.sonar.scans.submaps import match_submap, submap
from nls.sonar.scans.verdicts import ACCEPTED, verdicts

__all__ = ["Matches"]


@dataclass(frozen=True)
class Matches:
    """The matched candidates of a round, one row each.

    Attributes
    ----------
    i, j : (n,) keyframes in the middle of the earlier and of the later submap.
    pose : (n, 3) of j in the frame of i: x, y, m, and yaw, rad.
    covariance : (n, 3, 3) in the frame of j.
    score, ratio, edge, spread : (n,) of the match, see `Match`.
    window : (n, 2) half widths of the search, m and rad.
    verdict : (n,) `Verdict`, accepted or why not.
    kept : (n,) whether the selection kept it.
    """

    i: Index
    j: Index
    pose: Array
    covariance: Array
    score: Array
    ratio: Array
    edge: Array
    spread: Array
    window: Array
    verdict: Index
    kept: Mask

    def __len__(self) -> int:
        return len(self.i)

    @classmethod
    def of(cls, poses: Array, scans: Scans, i: Index, j: Index, window: Array) -> Matches:
        """Match the submaps (n,) around keyframes j with those around i, from present poses (count, 3), and judge."""
        guess = SE2.between(poses[i], poses[j])
        part = {k: submap(poses, scans, k, candidates.HALF) for k in np.unique(np.append(i, j)).tolist()}
        by_field: list[Match] = []
        order = np.argsort(i, kind="stable")  # one field at a time: they are large
        for a, rows in groupby(order.tolist(), key=lambda row: int(i[row])):
            field = Field(part[a])
            for row in rows:
                reach, turn = window[row].tolist()
                by_field.append(match_submap(field, part[int(j[row])], guess[row], (reach, turn)))
        fits = Fits.of([by_field[place] for place in np.argsort(order).tolist()])
        verdict = verdicts(fits.score, fits.ratio, fits.edge, fits.spread, window[:, 0])
        return cls(i, j, **vars(fits), window=window, verdict=verdict, kept=np.zeros(len(i), dtype=bool))

    @property
    def accepted(self) -> Mask:
        """(n,) whether the selection was to judge it."""
        return np.asarray(self.verdict == ACCEPTED)
