"""Matches as columns, one row each: the form in which they are judged and become factors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.algebra import Array
from nls.sonar.scans.matching import Match

__all__ = ["Fits"]


@dataclass(frozen=True)
class Fits:
    """Matches, one row each; see `Match`.

    Attributes
    ----------
    pose : (n, 3) x, y, m, and yaw, rad.
    covariance : (n, 3, 3) in the frame of the scan, m and rad.
    score, ratio, edge, spread : (n,)

    Examples
    --------
    >>> import numpy as np
    >>> fits = Fits.of([Match(np.array([1.0, 0.0, 0.2]), np.diag([0.04, 0.01, 1e-4]), score=2.0, second=0.5, edge=0.1)])
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
    def of(cls, matches: Sequence[Match]) -> Fits:
        """The columns of matches, in their order; empty ones of no match."""
        numbers = np.array([(match.score, match.ratio, match.edge, match.spread) for match in matches])
        return cls(
            np.array([match.pose for match in matches]).reshape(-1, 3),
            np.array([match.covariance for match in matches]).reshape(-1, 3, 3),
            *numbers.reshape(-1, 4).T,
        )
