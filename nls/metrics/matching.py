r"""Poses of two trajectories at the same times: the truth is interpolated between the rows around each estimate.

    Q(t) = (t_0 + a (t_1 - t_0),  R_0 Exp(a Log(R_0' R_1))),   a = (t - time_0) / (time_1 - time_0)

Positions on the straight line, rotations along the shorter turn with constant rate (slerp). Nothing is extrapolated,
and no gap of the truth is bridged that is longer than the tolerance: such poses are left out, and counted.

Source of the interpolation of rotations: K. Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from models import SE2, SE3, SO2, SO3
from models.algebra import Array, Index
from models.errors import GraphError, OptionError
from models.finite import finite


@dataclass(frozen=True)
class Matched:
    """Poses of an estimate and the truth at their times.

    Attributes
    ----------
    times : (m,) s.
    estimate, truth : (m, 3) SE2 or (m, 7) SE3.
    rows : (m,) the poses of the estimate that have a match.
    outside : how many others are before the first or after the last true pose.
    gaps : how many others are in a gap of the truth.
    tolerance : the longest time between two rows of the truth that was interpolated, s.
    """

    times: Array = field(repr=False)
    estimate: Array = field(repr=False)
    truth: Array = field(repr=False)
    rows: Index = field(repr=False)
    outside: int
    gaps: int
    tolerance: float


def matched(
    times_estimate: npt.ArrayLike,
    estimate: npt.ArrayLike,
    times_truth: npt.ArrayLike,
    truth: npt.ArrayLike,
    tolerance: float | None = None,
) -> Matched:
    """Match two trajectories by time.

    Parameters
    ----------
    times_estimate : (n,) s, of one clock with the other.
    estimate : (n, 3) SE2 or (n, 7) SE3.
    times_truth : (k,) s, rising.
    truth : (k, 3) or (k, 7), of the same space.
    tolerance : the longest time between two rows of the truth between which it is interpolated, s; twice the median
        time between its rows when omitted.

    Returns
    -------
    Matched

    Raises
    ------
    GraphError
        Shapes that do not fit, no numbers, times of the truth that do not rise, no pose with a match.
    OptionError
        A tolerance below 0.

    Examples
    --------
    >>> truth = [[0, 0, 0], [2, 0, 0.2]]
    >>> pairs = matched([0.5, 3.0], [[0.6, 0, 0], [9, 0, 0]], [0.0, 1.0], truth)
    >>> pairs.truth, pairs.outside, pairs.gaps
    (array([[1. , 0. , 0.1]]), 1, 0)
    """
    t, s = (finite("matched", n, v) for n, v in (("times_estimate", times_estimate), ("times_truth", times_truth)))
    P, Q = (np.atleast_2d(finite("matched", n, v)) for n, v in (("estimate", estimate), ("truth", truth)))
    space = {3: SE2, 7: SE3}.get(P.shape[-1])
    if space is None or P.shape[-1] != Q.shape[-1] or P.ndim != 2 or Q.ndim != 2 or not (len(P) and len(Q)):
        raise GraphError(f"matched: shapes {P.shape} and {Q.shape}, expected (n, 3) and (k, 3), or (n, 7) and (k, 7)")
    for name, times, X in (("times_estimate", t, P), ("times_truth", s, Q)):
        if times.shape != (len(X),):
            raise GraphError(f"matched: {name} has shape {times.shape}, expected ({len(X)},): one per pose")
    if not (np.diff(s) > 0).all():
        k = int(np.argmin(np.diff(s) > 0)) + 1
        message = f"times_truth[{k}], {float(s[k])} s, does not rise over {float(s[k - 1])} s before it; sort them"
        raise GraphError(f"matched: {message}")
    if tolerance is None:
        tolerance = float(2.0 * np.median(np.diff(s))) if len(s) > 1 else 0.0
    elif not tolerance >= 0:
        raise OptionError("tolerance", tolerance, "a time in seconds, 0 or above")
    P, Q = space.stack(P), space.stack(Q)
    after = np.minimum(np.searchsorted(s, t), len(s) - 1)
    exact = s[after] == t
    before = np.where(exact, after, np.maximum(after - 1, 0))
    outside = (t < s[0]) | (t > s[-1])
    gap = ~outside & (s[after] - s[before] > tolerance)
    rows = np.flatnonzero(~outside & ~gap)
    if not len(rows):
        raise GraphError(
            f"matched: none of {len(t)} poses has a match. Their times are {t.min():.10g} to {t.max():.10g} s, those "
            f"of the truth {s[0]:.10g} to {s[-1]:.10g} s; gaps of the truth up to {tolerance:.4g} s are bridged. Give "
            "both times of one clock, or a longer tolerance"
        )
    i, j = before[rows], after[rows]
    step = s[j] - s[i]
    a = np.divide(t[rows] - s[i], step, out=np.zeros(len(rows)), where=step > 0)
    d = space.point_dim
    position = Q[i, :d] + a[:, None] * (Q[j, :d] - Q[i, :d])
    turn = (SO3 if space is SE3 else SO2).interpolate(Q[i, d:], Q[j, d:], a)
    return Matched(
        *(t[rows], P[rows], np.concatenate([position, turn], axis=1), rows),
        *(int(outside.sum()), int(gap.sum()), float(tolerance)),
    )
