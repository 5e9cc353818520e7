"""Scans of consecutive keyframes matched with each other: how the sensor moved over a step, whatever the reckoning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models import SE2
from models.algebra import Array, Index
from nls.sonar.scans.field import Field
from nls.sonar.scans.matching import match
from nls.sonar.scans.scans import Scans
from nls.sonar.scans.verdicts import ACCEPTED, verdicts

__all__ = ["Neighbors", "neighbors"]

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
    count = np.diff(scans.starts)
    i = np.flatnonzero((count[:-1] >= POINTS) & (count[1:] >= POINTS))
    i = _chosen(i, np.abs(SE2.between(poses[i], poses[i + 1])[:, 2]))
    S = SE2.between(poses[i], poses[i + 1])
    fits = [match(Field(scans[k]), scans[k + 1], T, WINDOW) for k, T in zip(i.tolist(), S, strict=True)]
    score, ratio, edge, spread = np.array([(f.score, f.ratio, f.edge, f.spread) for f in fits]).reshape(-1, 4).T
    good = verdicts(score, ratio, edge, spread, np.full(len(fits), WINDOW[0])) == ACCEPTED
    pose = np.array([f.pose for f in fits]).reshape(-1, 3)[good]
    covariance = 2 * np.array([f.covariance for f in fits]).reshape(-1, 3, 3)[good]  # a scan is in two matches
    return Neighbors(i[good], i[good] + 1, pose, covariance)


def _chosen(i: Index, turn: Array) -> Index:
    """Of steps i (n,) at most `STEPS`: half those of the largest turns (n,), the others evenly among the rest."""
    if len(i) <= STEPS:
        return i
    order = np.argsort(-turn, kind="stable")
    rest = np.sort(order[STEPS // 2 :])
    evenly = rest[np.linspace(0, len(rest) - 1, STEPS - STEPS // 2).astype(np.intp)]
    return np.sort(i[np.append(order[: STEPS // 2], evenly)])
