r"""Tracks without a raw log: the path of another program, and a vehicle whose motion no sensor measures.

`path.csv` holds poses that a program or a vehicle has reckoned, which drift. What it says are the steps between them,

    XYH = h(X_i, X_i+1),    ZPR = (z, pitch, roll),

with the standard deviations of a step in the row it leads to. Columns that are not there are 0 and known: a vehicle on
the surface, or at a depth that does not matter.

`motion.csv` is for a log of fixes or ranges alone. Between them the vehicle may be anywhere it can have gone: a random
walk of density s, m/sqrt(s), axes parallel to those of the world,

    X_i+1 = X_i Exp(d),    d ~ N(0, s^2 (t_i+1 - t_i))  in x, y and z.
"""

from __future__ import annotations

import numpy as np

from factors import XYH, ZPR, Between, Diagonal, Prior
from factors.base import Factor
from factors.keys import kinds
from models import SE3, euler
from models.algebra import Array, Numbers
from models.sensors import levelled
from nls.io.mission.columns import ANGLES, LEVEL, PLACE, TILT, suffixed
from nls.io.mission.report import MissionReport
from nls.io.mission.table import Table

__all__ = ["reckoned", "walking"]

LEVEL_SIGMA = 1e-3  # m and rad, of a depth and a tilt that the file takes to be 0
(x,) = kinds("x")


def reckoned(path: Table, report: MissionReport) -> tuple[Numbers, list[Factor]]:
    """Numbers of the poses of path.csv, rising in time, and `XYH` and `ZPR` between and at them.

    Raises
    ------
    GraphFileError
        Times that do not rise, one pose, numbers that cannot be.
    """
    t = path.rising("time_s")
    if len(t) < 2:
        raise path.at(0, "one pose; a track has at least two")
    absent = [name for name in (*PLACE, *ANGLES) if not path.has(name)]
    columns = [np.zeros(len(t)) if name in absent else path.attitude(name)[:, 0] for name in (*ANGLES, *PLACE)]
    X = euler.to_se3(np.column_stack(columns))
    if absent:
        report.notes.append(f"path.csv has no {', '.join(absent)}: taken as 0, within 1 mm and 1 mrad")
    numbers = np.arange(len(t))
    step, _ = levelled(X[:-1], X[1:])
    tilt = np.column_stack([columns[[*ANGLES, *PLACE].index(name)] for name in TILT])
    sigmas = [
        path.positive(f"sigma_{name}")[:, 0] if path.has(f"sigma_{name}") else np.full(len(t), LEVEL_SIGMA)
        for name in TILT
    ]
    report.vertex_times["x"] = t
    report.sources += [path.source(numbers[1:]), path.source()]
    return numbers, [
        XYH(x[numbers[:-1]], x[numbers[1:]], step, Diagonal(path.positive(*suffixed(LEVEL))[1:])),
        ZPR(x[numbers], tilt, Diagonal(np.column_stack(sigmas))),
    ]


def walking(motion: Table, t: Array, report: MissionReport) -> tuple[Numbers, list[Factor]]:
    """Numbers of the poses at times t (n,), rising, and the random walk between them, their axes those of the world.

    Raises
    ------
    GraphFileError
        A second row; one time.
    """
    if len(motion) > 1:
        raise motion.at(1, "a second row; expected one")
    if len(t) < 2:
        raise motion.at(0, "fewer than two times of fixes or ranges; a track has at least two poses")
    density = float(motion.positive("sigma_walk_m_sqrt_s")[0, 0])
    walk = density * np.sqrt(np.diff(t))[:, None]
    numbers, turn = np.arange(len(t)), np.full((len(t) - 1, 3), LEVEL_SIGMA)
    report.vertex_times["x"] = t
    report.sources += [motion.source(np.zeros(len(t) - 1, dtype=int)), motion.source(np.zeros(len(t), dtype=int))]
    report.notes.append(
        f"no sensor measures the motion: {len(t)} poses at the times of the measurements, each within {density:g} m "
        "times the root of the seconds since the one before; the vehicle is taken to head north and level"
    )
    stay = np.broadcast_to(SE3.identity(), (len(t) - 1, SE3.size))
    upright = Prior(x[numbers], SE3.identity(), Diagonal([LEVEL_SIGMA] * 3), components=ANGLES_OF_POSE)
    return numbers, [
        Between(x[numbers[:-1]], x[numbers[1:]], stay, Diagonal(np.hstack([np.repeat(walk, 3, axis=1), turn]))),
        upright,
    ]


ANGLES_OF_POSE = ("roll", "pitch", "yaw")
