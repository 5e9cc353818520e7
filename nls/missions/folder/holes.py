r"""Holes in the log of an attitude or depth sensor: what its values are there, and how well they are known.

A hole is more time between two rows than twice the median step, as for the DVL. Within one, from t_a to t_b = t_a + T,
a value y is taken along the straight line between the rows before and after it. How far the true one wanders from that
is not known; it is taken from the same log, as a Brownian bridge of density

    beta = 2 max(rms d, |y_b - y_a| / 2) / sqrt(T)

where d is measured elsewhere in the log, over times as long as the hole. It is the distance of the value in the middle
from the mean of the values at the ends. The second number is there as nothing says *when* in the hole the change was
made. In the middle of the hole the value has the standard deviation max(rms d, |y_b - y_a| / 2), at its ends none but
that of a row.

Poses in one hole share the error of its line. A factor of each cannot say so, and each counts with the sum of its
covariances with all of them, K(s, t) = beta^2 s (T - t) / T for s <= t since t_a, so that no combination of them is
better known than it is (`models.dead_reckoning.drop_outs` has the argument).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.algebra import Array, Index, Mask
from models.dead_reckoning.drop_outs import longest_step, losses
from nls.missions.folder.report import MissionReport
from nls.missions.folder.table import Table

__all__ = ["holes_of"]
ROUNDING = 1e-9  # of a step: times that are told apart


@dataclass(frozen=True)
class Holes:
    """The holes of one log and the poses in them.

    Attributes
    ----------
    inside : (n,) whether a pose is in a hole.
    density : (m, c) beta after each of m rows and for each of c values, 0 where no hole follows.
    sigma : (n, c) standard deviation of a value at each pose by the hole it is in, 0 outside.
    """

    inside: Mask
    density: Array
    sigma: Array


def holes_of(table: Table, t: Array, y: Array, b: Array, effect: str, report: MissionReport) -> Holes:
    """The holes of a log that poses lie in or beside, each known as well as the rest of the log allows.

    Parameters
    ----------
    table : for messages, with its m rows at t (m,), s, and their values y (m, c), no turn missing in angles.
    b : (n,) times of the poses, rising, s.
    effect : what a note says of the poses in a hole.
    report : that gets the note.

    Raises
    ------
    GraphFileError
        A hole so long that no time as long without one is left to judge it by.
    """
    a = np.flatnonzero(losses(t, np.ones(len(t), dtype=bool)) & (t < b[-1]))
    a = a[t[a + 1] > b[0]]
    T, density = t[a + 1] - t[a], np.zeros_like(y)
    step = longest_step(t) / 2
    length = np.ceil(T / step - ROUNDING) * step
    for L in np.unique(length):
        d = _from_the_middle(t, y, float(L))
        rows = a[length == L]
        if not len(d):
            raise table.at(
                int(rows[0]) + 1,
                f"no row in the {t[rows[0] + 1] - t[rows[0]]:.6g} s before this one, and no time as long without such "
                "a hole to tell how far the vehicle turns or dives in it; cut the log in two here",
            )
        most = np.maximum(np.sqrt(np.square(d).mean(axis=0)), np.abs(y[rows + 1] - y[rows]) / 2)
        density[rows] = 2 * most / np.sqrt(t[rows + 1] - t[rows])[:, None]

    hole = np.searchsorted(t[a], b, side="right") - 1  # the last one that began before, -1 for none
    since = b - t[a][hole] if len(a) else np.zeros_like(b)
    inside = (hole >= 0) & (since > 0) & (b < t[a + 1][hole]) if len(a) else np.zeros(len(b), dtype=bool)
    sigma = np.zeros((len(b), y.shape[1]))
    sigma[inside] = density[a[hole[inside]]] * np.sqrt(_shared(since[inside], T[hole[inside]], hole[inside]))[:, None]
    if len(a):
        k = int(np.argmax(T))
        many = f"{len(a)} holes, {T.sum():.6g} s in all, the longest" if len(a) > 1 else "a hole"
        report.notes.append(
            f"{table.place(int(a[k]) + 1)}: {many} between {t[a[k]]:.6g} and {t[a[k] + 1]:.6g} s: "
            f"{int(inside.sum())} of {len(b)} poses {effect}"
        )
    return Holes(inside, density, sigma)


def _from_the_middle(t: Array, y: Array, length: float) -> Array:
    """Values (k, c) in the middle of times of this length without a hole, less the mean of the values at their ends."""
    a = np.flatnonzero(losses(t, np.ones(len(t), dtype=bool)))
    slack = ROUNDING * length
    begin, end = t - length / 2 + slack, t + length / 2 - slack
    clear = np.searchsorted(t[a + 1], begin, side="right") == np.searchsorted(t[a], end, side="left")
    clear &= (begin >= t[0]) & (end <= t[-1])
    ends = [np.column_stack([np.interp(s[clear], t, column) for column in y.T]) for s in (begin, end)]
    return np.asarray(y[clear] - 0.5 * (ends[0] + ends[1]))


def _shared(since: Array, T: Array, hole: Index) -> Array:
    """Sum over all poses l in the same hole of s (T - t) / T, s and t the earlier and later of the poses k and l.

    Parameters
    ----------
    since : (m,) times since the hole began, rising within a hole; T : (m,) its length; hole : (m,) rising.
    """
    first = np.searchsorted(hole, hole)
    last = np.searchsorted(hole, hole, side="right") - 1

    def up_to(x: Array) -> Array:
        """Sum of x over the poses of the hole up to each."""
        total = np.cumsum(x)
        return np.asarray(total - (total - x)[first])

    after = T - since
    later = up_to(after)[last] - up_to(after)
    return np.asarray((after * up_to(since) + since * later) / T)
