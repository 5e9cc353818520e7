r"""A cruising AUV at sea, 400 s a trajectory at 1 Hz: its DVL, and position and attitude of a post-processed INS.

Files ``DVL_trajectoryN.csv`` and ``GT_trajectoryN.csv``. Latitudes and longitudes become meters north and east of the
first in its plane (`models.geodesy.LocalPlane`); down is the fall of the altitude.

Source of the data: N. Cohen, I. Klein, "Adaptive Kalman-informed transformer", Engineering Applications of Artificial
Intelligence 146, 2025.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.algebra import Array
from models.errors import GraphFileError
from models.geodesy import LocalPlane

from .table import columns

__all__ = ["AuvDvl", "read_auv_dvl"]

INS = (
    "Longitude [rad],Latitude [rad],Altitude [m],V North [m/s],V East [m/s],V Down [m/s],"
    "Roll [rad],Pitch [rad],Yaw [rad]"
)


@dataclass(frozen=True)
class AuvDvl:
    """One trajectory; world north, east, down; body forward, starboard, down.

    Attributes
    ----------
    t : (n,) s.
    v_d : (n, 3) velocity of the DVL in body axes, m/s, as measured: with the lever arm, which is not given.
    p : (n, 3) true position from the first, m.
    v : (n, 3) true velocity in the world, m/s.
    rpy : (n, 3) true roll, pitch, yaw, rad.
    """

    t: Array
    v_d: Array
    p: Array
    v: Array
    rpy: Array


def read_auv_dvl(folder: str | Path, number: int) -> AuvDvl:
    """Trajectory of a number.

    Raises
    ------
    GraphFileError
        A file that cannot be read, or two whose times differ.
    """
    dvl, ins = (Path(folder) / f"{prefix}_trajectory{number}.csv" for prefix in ("DVL", "GT"))
    measured = columns(dvl, ("Time [s]", "DVL X [m/s]", "DVL Y [m/s]", "DVL Z [m/s]"))
    true = columns(ins, ("Time [s]", *INS.split(",")))
    if not np.array_equal(measured[:, 0], true[:, 0]):
        raise GraphFileError(f"its times are not those of {ins.name}", str(dvl))
    lon, lat = np.degrees(true[:, 1:3].T)
    altitude = true[:, 3]
    p = np.column_stack([LocalPlane(lat[0], lon[0]).local(lat, lon), altitude[0] - altitude])
    return AuvDvl(true[:, 0], measured[:, 1:], p, true[:, 4:7], true[:, 7:])
