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
from nls.sonar.scans.views import Observed

__all__ = ["match_submap", "submap", "submap_field"]

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
    keyframes, T = _members(poses, scans, center, half)
    rows = slice(scans.starts[keyframes.start], scans.starts[keyframes.stop])
    return np.asarray(SE2.act(T[scans.keyframe[rows] - keyframes.start], scans.points[rows]))


def submap_field(poses: Array, scans: Scans, center: int, half: int | tuple[int, int]) -> Field:
    """The field of a `submap` that has observed what its keyframes with points saw."""
    keyframes, T = _members(poses, scans, center, half)
    sensor = SE2.compose(T[scans.with_points[keyframes]], scans.mount[None])
    return Field(submap(poses, scans, center, half), observed=Observed(sensor, scans.view))


def _members(poses: Array, scans: Scans, center: int, half: int | tuple[int, int]) -> tuple[slice, Array]:
    """The keyframes of a submap, and their poses (n, 3) in the frame of the middle one."""
    before, after = (half, half) if isinstance(half, int) else half
    if not 0 <= center < len(scans):
        raise OptionError("center", center, f"a keyframe, 0 to {len(scans) - 1}")
    if before + after < 0:
        raise OptionError("half", half, "at least one keyframe")
    keyframes = slice(max(0, center - before), min(len(scans), center + after + 1))
    return keyframes, SE2.between(np.broadcast_to(poses[center], poses[keyframes].shape), poses[keyframes])


def match_submap(field: Field, points: Array, guess: Array, window: tuple[float, float]) -> Match:
    """As `match`, of submaps: they are bent by the drift within them, and the covariance says so."""
    fit = match(field, points, guess, window)
    return replace(fit, covariance=fit.covariance + np.diag(BENT**2))
