"""Files of missions: a folder small enough to read, which a page shows, a raw log, a vehicle with positions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

import nls
from models import SE3, euler
from nls.missions.folder.columns import COLUMNS, POSE
from nls.missions.folder.table import csv_text

__all__ = ["BEACONS", "NOISE", "RAW", "SHIFT", "TINY", "Positioned", "csv", "folder", "raw", "tables"]
RAW = {
    **COLUMNS,
    "truth": POSE,
    "contacts": tuple(name for name in COLUMNS["contacts"] if name != "time_s"),
    "zpr": COLUMNS["zpr"][:7],
    "dvl": COLUMNS["dvl"][:5],
    "noise": COLUMNS["noise"][:7],
}  # without what may be left out
NOISE = ([[0.01, 0.002, 0.05, 0.002, 0.002, 0.01, 0.05]],)

TINY = {
    "sonar": """\
name,beams,bins,fan_rad,aperture_rad,range_min_m,range_max_m,x_m,y_m,z_m,roll_rad,pitch_rad,yaw_rad
"DIDSON, high frequency",96,512,0.5027,0.2443,1.0,6.0,0.3,0.0,0.1,0.0,-0.5236,0.0
""",
    "contacts": """\
i,landmark,range_m,azimuth_rad,sigma_range_m,sigma_azimuth_rad
0,11,4.7457,0.0625,0.01,0.004
0,12,5.239,-0.0114,0.01,0.004
0,14,5.5399,0.1603,0.01,0.004
1,11,4.2673,0.0435,0.01,0.004
1,12,4.7486,-0.0613,0.01,0.004
1,14,5.0227,0.1522,0.01,0.004
2,11,3.7637,-0.0599,0.01,0.004
2,12,4.2289,-0.1587,0.01,0.004
2,14,4.5338,0.067,0.01,0.004
3,12,3.9747,-0.1361,0.01,0.004
3,14,4.2282,0.1078,0.01,0.004
""",
    "odometry": """\
i,j,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad
0,1,0.5408,-0.0311,0.0521,0.02,0.02,0.005
1,2,0.491,0.0259,0.0489,0.02,0.02,0.005
2,3,0.4143,0.0201,-0.0043,0.02,0.02,0.005
""",
    "zpr": """\
i,z_m,pitch_rad,roll_rad,sigma_z_m,sigma_pitch_rad,sigma_roll_rad
0,5.0332,0.0005,-0.0007,0.01,0.002,0.002
1,5.0972,-0.0313,0.0479,0.01,0.002,0.002
2,5.2461,0.041,-0.0405,0.01,0.002,0.002
3,5.0596,-0.0004,0.03,0.01,0.002,0.002
""",
    "anchor": """\
i,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad
0,0.0,0.0,0.0,0.001,0.001,0.0001
""",
    "truth": """\
i,roll_rad,pitch_rad,yaw_rad,x_m,y_m,z_m
0,0.0,0.0,0.0,0.0,0.0,5.0
1,0.05,-0.03,0.05,0.5,0.02,5.1
2,-0.04,0.04,0.1,1.0,0.08,5.25
3,0.03,0.0,0.1,1.45,0.15,5.05
""",
    "landmarks": """\
landmark,x_m,y_m,z_m
11,4.5,0.3,7.3
12,5.0,-0.1,7.4
14,5.2,0.9,7.5
""",
}


def folder(path: Path, files: dict[str, str] | None = None, **changed: str | None) -> Path:
    """A folder of files by their name without .csv, some of them changed, left out (None) or added."""
    path.mkdir(exist_ok=True)
    for name, text in {**(TINY if files is None else files), **changed}.items():
        if text is not None:
            (path / f"{name}.csv").write_text(text, encoding="utf-8")
    return path


def raw(lost: tuple[float, float] = (0.0, 0.0)) -> dict[str, str]:
    """The log of a vehicle that goes 1 m/s on a heading of 0.3 rad for 20 s while it sinks, then turns on the spot.

    The DVL has no bottom between the times of `lost`, and reports nonsense there.
    """
    t, deep = np.arange(0.0, 30.01, 0.25), np.arange(-1.0, 40.0)
    blind, zero = (t > lost[0]) & (t < lost[1]), 0 * t
    yaw = np.where(t <= 20.0, 0.3, 0.3 + 0.05 * (t - 20.0))
    dvl = t, np.where(blind, 99.0, t <= 20.0), zero, zero, 1 * ~blind
    return tables(dvl=dvl, ahrs=(t, zero, zero, yaw), depth=(deep, 2.0 + 0.1 * deep), noise=NOISE)


def tables(**rows: Sequence[npt.ArrayLike]) -> dict[str, str]:
    """Files with the columns of `RAW`."""
    return {name: csv_text(RAW[name], *columns).decode() for name, columns in rows.items()}


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
