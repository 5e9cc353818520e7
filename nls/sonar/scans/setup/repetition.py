"""Whether scans show the same things from keyframe to keyframe: clutter does not, and closes loops by chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.keys import kinds
from nls.sonar.scans.matches import WINDOW, comparable, field_before
from nls.sonar.scans.matching import match
from nls.sonar.scans.scans import Scans
from nls.values import Values

__all__ = ["Repetition", "repetition"]

SCANS = 150  # matched at most, evenly along the track
RECKONED = 0.3  # m, sigma of dead reckoning over the keyframes before a scan
FITS = 3.0  # most e' C^-1 e of a scan that fits where it is reckoned: 78 % of those with right sigmas
LEAST = 20  # scans below which nothing is said
SHARE = 0.25  # least share of them: random points have 0.02 to 0.19, harbors 0.34 (one straight wall) to 0.89
x = kinds("x")[0]


@dataclass(frozen=True)
class Repetition:
    """Scans that were matched with those just before them, and how many of them fit where they are reckoned."""

    scans: int
    fits: int

    @property
    def wrong(self) -> bool:
        """Whether the scans show nothing that stays."""
        return self.scans >= LEAST and self.fits < SHARE * self.scans


def repetition(values: Values, scans: Scans) -> Repetition:
    """Match scans with the points of the keyframes just before them, at the poses of `values`."""
    k = comparable(scans)
    k = k[np.unique(np.linspace(0, len(k) - 1, min(len(k), SCANS)).astype(np.intp))] if len(k) else k
    poses, fits = values[x], 0
    for row in k.tolist():
        fit = match(field_before(poses, scans, row), scans[row], np.zeros(3), WINDOW)
        e = fit.pose[:2]
        fits += bool(e @ np.linalg.solve(fit.covariance[:2, :2] + RECKONED**2 * np.eye(2), e) < FITS)
    return Repetition(len(k), fits)
