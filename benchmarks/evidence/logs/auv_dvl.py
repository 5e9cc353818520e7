r"""A cruising AUV at sea, 400 s a trajectory at 1 Hz: its DVL, and position and attitude of a post-processed INS.

Files ``DVL_trajectoryN.csv`` and ``GT_trajectoryN.csv``. `nls import` reads them by docs/missions/auv-dvl.toml.
Latitudes and longitudes become meters north and east of the first; down is the fall of the altitude.

Source of the data: N. Cohen, I. Klein, "Adaptive Kalman-informed transformer", Engineering Applications of Artificial
Intelligence 146, 2025.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.algebra import Array
from models.errors import GraphFileError

from .table import tables

__all__ = ["AuvDvl", "read_auv_dvl"]


@dataclass(frozen=True)
class AuvDvl:
    """One trajectory; world north, east, down; body forward, starboard, down.

    Attributes
    ----------
    t : (n,) s.
    v_d : (n, 3) velocity of the DVL in body axes, m/s, as measured: with the lever arm, which is not given.
    p : (n, 3) true position from the first, m.
    rpy : (n, 3) true roll, pitch, yaw, rad.
    """

    t: Array
    v_d: Array
    p: Array
    rpy: Array


def read_auv_dvl(folder: str | Path, number: int) -> AuvDvl:
    """Trajectory of a number.

    Raises
    ------
    GraphFileError
        A file that cannot be read, or two whose times differ.
    """
    logs = [Path(folder) / f"{prefix}_trajectory{number}.csv" for prefix in ("DVL", "GT")]
    mission = tables("auv-dvl", logs)
    dvl, true = mission["dvl"], mission["truth"]
    if not np.array_equal(dvl[:, 0], true[:, 0]):
        raise GraphFileError(f"its times are not those of {logs[1].name}", str(logs[0]))
    p = true[:, 4:] - [0, 0, true[0, 6]]
    return AuvDvl(dvl[:, 0], dvl[:, 1:4], p, true[:, 1:4])
