"""Matches of a scan with those just before it: what the sensor says of the way itself."""

from __future__ import annotations

import numpy as np

from factors import Between, Cauchy, Covariance, Robust
from factors.keys import kinds
from models import SE2
from models.algebra import Array
from nls.sonar.scans import verdicts
from nls.sonar.scans.field import Field
from nls.sonar.scans.matching import match
from nls.sonar.scans.scans import Scans
from nls.sonar.scans.submaps import bent, submap

__all__ = ["sequential_matches"]

BACK = 6  # keyframes before it with which a scan is matched
POINTS = (20, 40)  # least points of the scan, and of those before it
WINDOW = (2.0, float(np.radians(4.0)))  # half widths of the search, m, rad
x = kinds("x")[0]


def sequential_matches(poses: Array, scans: Scans) -> Between | None:
    """One factor between a keyframe and one a few before it for every scan that fits those before; None without any.

    A kernel weighs them: the points that are common to all scans because they move with the vehicle say that it stands.

    Parameters
    ----------
    poses : (count, 3) present estimate, SE2.
    scans : the points.
    """
    i, j, z, C = [], [], [], []
    for k in range(1, len(scans)):
        before, own = submap(poses, scans, k, (BACK, -1)), scans[k]
        if len(own) < POINTS[0] or len(before) < POINTS[1]:
            continue
        fit = bent(match(Field(before), own, np.zeros(3), WINDOW))
        if verdicts.fits(fit.score, fit.edge, fit.spread):
            first = max(0, k - (BACK + 1) // 2)
            i.append(first)
            j.append(k)
            z.append(SE2.compose(SE2.between(poses[[first]], poses[[k]]), fit.pose[None])[0])
            C.append((BACK + 1) * fit.covariance)  # its points take part in so many matches
    if not i:
        return None
    return Between(x[np.array(i)], x[np.array(j)], np.array(z), Robust(Covariance(np.array(C)), Cauchy(1.0)))
