"""Matches of a scan with those just before it: what the sensor says of the way itself."""

from __future__ import annotations

import numpy as np

from factors import Cauchy, Covariance, Robust, SequentialMatch
from factors.keys import kinds
from models import SE2
from models.algebra import Array, Index
from nls.sonar.scans.field import Field
from nls.sonar.scans.matches import ACCEPTED, Fits, verdicts
from nls.sonar.scans.scans import Scans
from nls.sonar.scans.submaps import match_submap, submap

__all__ = ["comparable", "field_before", "sequential_matches"]

BACK = 6  # keyframes before it with which a scan is matched
POINTS = (20, 40)  # least points of the scan, and of those before it
WINDOW = (2.0, float(np.radians(4.0)))  # half widths of the search, m, rad
x = kinds("x")[0]


def sequential_matches(poses: Array, scans: Scans) -> SequentialMatch | None:
    """One factor between a keyframe and one a few before it for every scan that fits those before; None without any.

    A kernel weighs them: the points that are common to all scans because they move with the vehicle say that it stands.

    Parameters
    ----------
    poses : (count, 3) present estimate, SE2.
    scans : the points.
    """
    k = comparable(scans)
    fits = Fits.of([match_submap(field_before(poses, scans, j), scans[j], np.zeros(3), WINDOW) for j in k.tolist()])
    unjudged = np.zeros(len(k))  # ratio: a second place is no reason against a match in so narrow a window
    accepted = verdicts(fits.score, unjudged, fits.edge, fits.spread, np.full(len(k), WINDOW[0])) == ACCEPTED
    if not accepted.any():
        return None
    j = k[accepted]
    i = np.maximum(j - (BACK + 1) // 2, 0)
    z = SE2.compose(SE2.between(poses[i], poses[j]), fits.pose[accepted])
    C = (BACK + 1) * fits.covariance[accepted]  # the points of a scan take part in so many matches
    return SequentialMatch(x[i], x[j], z, Robust(Covariance(C), Cauchy(1.0)))


def comparable(scans: Scans) -> Index:
    """Keyframes (n,) that have points enough, and enough in the keyframes before them."""
    starts, k = scans.starts, np.arange(len(scans))
    before = starts[k] - starts[np.maximum(k - BACK, 0)]
    return np.flatnonzero((np.diff(starts) >= POINTS[0]) & (before >= POINTS[1]))


def field_before(poses: Array, scans: Scans, k: int) -> Field:
    """The field of the keyframes before one, in its frame, from poses (count, 3)."""
    return Field(submap(poses, scans, k, (BACK, -1)))
