"""Submaps: the points of neighboring keyframes in the frame of the middle one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models import SE2
from models.algebra import Array
from models.errors import OptionError
from nls.sonar.scans.field import Field
from nls.sonar.scans.matching import Match, match
from nls.sonar.scans.scans import Scans

__all__ = ["match_submap", "submap"]

BENT = np.array([0.4, 0.4, 0.025])  # sigmas, m m rad, of a submap that is not rigid: dead reckoning drifts within it


def submap(poses: Array, scans: Scans, center: int, half: int | tuple[int, int]) -> Array:
    """Points (n, 2) of the keyframes around one of them, in the frame of that one, m.

    Parameters
    ----------
    poses : (count, 3) of the keyframes, SE2.
    scans : their points.
    center : number of the keyframe in whose frame the points are.
    half : keyframes on either side of it; or how many before and after it, -1 after it for none and not its own.
        Those beyond the ends are left out.

    Raises
    ------
    OptionError
        No such keyframe; no keyframe at all.

    Examples
    --------
    >>> import numpy as np
    >>> scans = Scans([[5.0, 0.0], [4.0, 0.0]], keyframe=[0, 1], count=2)
    >>> submap(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]), scans, center=1, half=1)
    array([[3., 0.],
           [4., 0.]])
    """
    before, after = (half, half) if isinstance(half, int) else half
    if not 0 <= center < len(scans):
        raise OptionError("center", center, f"a keyframe, 0 to {len(scans) - 1}")
    if before + after < 0:
        raise OptionError("half", half, "at least one keyframe")
    first, last = max(0, center - before), min(len(scans), center + after + 1)
    rows = slice(scans.starts[first], scans.starts[last])
    T = SE2.between(np.broadcast_to(poses[center], (last - first, 3)), poses[first:last])
    return np.asarray(SE2.act(T[scans.keyframe[rows] - first], scans.points[rows]))


def match_submap(field: Field, points: Array, guess: Array, window: tuple[float, float]) -> Match:
    """As `match`, of submaps: they are bent by the drift within them, and the covariance says so."""
    fit = match(field, points, guess, window)
    return replace(fit, covariance=fit.covariance + np.diag(BENT**2))
