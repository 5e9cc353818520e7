"""Scans of consecutive keyframes matched with each other: how the sensor moved over a step, whatever the reckoning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models import SE2
from models.algebra import Array, Index
from nls.missions.scans.correlation import Field, match
from nls.missions.scans.matches import ACCEPTED, MatchTable, verdicts
from nls.missions.scans.scans import Scans

__all__ = ["Neighbors", "match_steps", "neighbors", "steps"]

POINTS = 30  # least points of a scan
STEPS = 400  # matched at most: half of them those that turn most, which show a lever arm and a late clock
WINDOW = (2.0, 0.35)  # m, rad: a clock that is 3 s late at 7 deg/s


@dataclass(frozen=True)
class Neighbors:
    """Steps as the scans show them.

    Attributes
    ----------
    i, j : (n,) keyframes of a step.
    pose : (n, 3) of j in the frame of i, x, y, m, and yaw, rad; of vehicle frames that belong to the assumed mounting.
    covariance : (n, 3, 3) in the frame of j.
    """

    i: Index
    j: Index
    pose: Array
    covariance: Array

    def __len__(self) -> int:
        return len(self.i)


def neighbors(poses: Array, scans: Scans) -> Neighbors:
    """Matched scans of consecutive keyframes, from poses (count, 3); those that are ambiguous are left out."""
    i = _chosen(*steps(poses, scans))
    fits = match_steps(poses, scans, i, WINDOW)
    good = verdicts(fits.score, fits.ratio, fits.edge, fits.spread, np.full(len(i), WINDOW[0])) == ACCEPTED
    covariance = 2 * fits.covariance[good]  # a scan is in two matches
    return Neighbors(i[good], i[good] + 1, fits.pose[good], covariance)


def steps(poses: Array, scans: Scans) -> tuple[Index, Array]:
    """Keyframes i (n,) whose scan and the next one have points enough, and the turns (n,) to i + 1, rad, 0 or above."""
    enough = np.diff(scans.starts) >= POINTS
    i = np.flatnonzero(enough[:-1] & enough[1:])
    return i, np.abs(SE2.between(poses[i], poses[i + 1])[:, 2])


def match_steps(poses: Array, scans: Scans, i: Index, window: tuple[float, float]) -> MatchTable:
    """Scans of keyframes i + 1 matched with those of keyframes i (n,), around the steps of poses (count, 3)."""
    S = SE2.between(poses[i], poses[i + 1])
    return MatchTable.of([match(Field(scans[k]), scans[k + 1], T, window) for k, T in zip(i.tolist(), S, strict=True)])


def _chosen(i: Index, turn: Array) -> Index:
    """Of steps i (n,) at most `STEPS`: half those of the largest turns (n,), the others evenly among the rest."""
    if len(i) <= STEPS:
        return i
    order = np.argsort(-turn, kind="stable")
    rest = np.sort(order[STEPS // 2 :])
    evenly = rest[np.linspace(0, len(rest) - 1, STEPS - STEPS // 2).astype(np.intp)]
    return np.sort(i[np.append(order[: STEPS // 2], evenly)])
