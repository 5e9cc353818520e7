"""A small mission whose vehicle is positioned: its truth is dead reckoning of a log, moved; tables measure that."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

import nls
from models import SE3, euler
from nls.missions.folder.table import csv_text
from tests.nls.missions.folder.mission_files import NOISE, folder, tables

__all__ = ["BEACONS", "SHIFT", "Positioned", "csv"]

Array = npt.NDArray[np.float64]
BEACONS = {3: (40.0, -20.0, 25.0), 5: (80.0, 45.0, 18.0), 9: (120.0, -60.0, 22.0)}
SHIFT = (100.0, -50.0)  # of the truth from dead reckoning, m
(x,) = nls.kinds("x")


def csv(names: str, *columns: npt.ArrayLike) -> str:
    """A file of these columns."""
    return csv_text(names.split(","), *(np.asarray(column) for column in columns)).decode()


class Positioned:
    """A log of 80 s, and where its vehicle is at any time: ahead and to the side on a winding course, up and down.

    Parameters
    ----------
    path : a folder for the mission whose dead reckoning is the truth.
    t : times of poses beside those each second.
    """

    def __init__(self, path: Path, t: npt.ArrayLike = ()) -> None:
        s = np.arange(0.0, 80.01, 0.25)
        zero, one = np.zeros(len(s)), np.ones(len(s))
        yaw = 0.3 + 1.2 * np.sin(s / 12)
        dvl = s, one, 0.1 * one, 2 / 9 * np.cos(s / 9), one.astype(int)
        self.files = tables(dvl=dvl, ahrs=(s, zero, zero, yaw), depth=(s, 4 + 2 * np.sin(s / 9)), noise=NOISE)
        self.t = np.union1d(np.arange(0.0, 80.5), t)
        self.poses = csv("i,time_s", np.arange(len(self.t)), self.t)
        _, values, _ = nls.load(folder(path, self.files, poses=self.poses))
        self.X = SE3.compose(euler.to_se3([0.0, 0.0, 0.0, *SHIFT, 0.0]), values[x])

    def at(self, t: npt.ArrayLike) -> Array:
        """True poses (n, 7)."""
        return np.asarray(self.X[np.searchsorted(self.t, np.asarray(t) - 1e-6)])

    def places(self, t: npt.ArrayLike, arm: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Array:
        """True places (n, 3) of an antenna."""
        return np.asarray(SE3.act(self.at(t), np.asarray(arm, dtype=float)))

    def ranges(self, t: npt.ArrayLike, beacon: npt.ArrayLike, arm: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Array:
        """True distances (n,) to beacons."""
        return np.asarray(np.linalg.norm(self.places(t, arm) - [BEACONS[k] for k in np.ravel(beacon).tolist()], axis=1))
