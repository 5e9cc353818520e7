r"""The track of a mission: its poses and the factors between and at them, and which files say them.

`path.csv` holds poses that a program or a vehicle has reckoned, which drift. What it says are the steps between them,

    XYH = h(X_i, X_i+1),    ZPR = (z, pitch, roll),

with the standard deviations of a step in the row it leads to. Columns that are not there are held at 0: a vehicle on
the surface, or at a depth that does not matter.
"""

from __future__ import annotations

import numpy as np

from factors import XYH, ZPR, Diagonal, Heading
from factors.keys import kinds
from models import euler
from models.algebra import Array, Numbers, wrap
from models.sensors import levelled
from nls.missions.folder.columns import ANGLES, COMPASS, LEVEL, PLACE, TILT, UPRIGHT, suffixed
from nls.missions.folder.motion import walking
from nls.missions.folder.rows import Assembly, columns_together
from nls.missions.folder.table import Table
from nls.missions.folder.timeline import poses_of_rows, united
from nls.sparse.elimination import connected

__all__ = ["track"]

LEVEL_SIGMA = 1e-3  # m and rad, of a depth and a tilt that the file takes to be 0
(x,) = kinds("x")


def track(mission: Assembly) -> Numbers:
    """Numbers of the poses, rising; adds the factors between and at them, from the files that say them.

    Raises
    ------
    GraphFileError
    """
    if "odometry" in mission.tables:
        return _odometry(mission)
    if "path" in mission.tables:
        return _reckoned(mission)
    if "motion" in mission.tables:
        return walking(mission)
    from nls.missions.folder.log import integrated

    return integrated(mission)


def _odometry(mission: Assembly) -> Numbers:
    """Numbers of the poses, rising; adds the factors of odometry.csv and zpr.csv."""
    tables, report = mission.tables, mission.report
    odometry, zpr = tables["odometry"], tables["zpr"]
    i, j = odometry.integers("i"), odometry.integers("j")
    odometry.refuse_rows(i == j, lambda k: f"the step joins pose {i[k]} to itself")
    numbers = np.unique(np.concatenate([i, j]))
    pieces = np.unique(connected(numbers.searchsorted(i), numbers.searchsorted(j), len(numbers)))
    if len(pieces) > 1:
        report.warn(
            f"odometry.csv leaves the track in {len(pieces)} pieces, the second begins at pose {numbers[pieces[1]]}: "
            "only landmarks that both saw, or an anchor of each, say where they are to each other; is a row missing?"
        )
    again = len(i) - len(np.unique(np.stack([i, j]), axis=1).T)
    if again:
        report.notes.append(f"odometry.csv measures {again} steps more than once: all of them count")
    tilted = zpr.unique("i", "pose")
    zpr.known("i", numbers, "odometry.csv has no such pose")
    if len(bare := np.setdiff1d(numbers, tilted)):
        report.warn(f"{len(bare)} poses have no row in zpr.csv, the first is {bare[0]}: their depth and tilt are free")
    if "poses" in tables:
        report.vertex_times["x"] = _times(tables["poses"], numbers)
    steps = XYH(x[i], x[j], odometry.measured(*LEVEL), Diagonal(odometry.positive(*suffixed(LEVEL))))
    mission.add(steps, odometry.source())
    mission.add(ZPR(x[tilted], zpr.attitude(*TILT), Diagonal(zpr.positive(*suffixed(TILT)))), zpr.source())
    if columns_together(zpr, *COMPASS):
        yaw, sigma = wrap(zpr.attitude(COMPASS[0])), Diagonal(zpr.positive(COMPASS[1]))
        mission.add(Heading(x[tilted], yaw, sigma), zpr.source())
    return numbers


def _times(poses: Table, numbers: Numbers) -> Array:
    """Times (n,) of the poses, s, in the order of their numbers."""
    ids, t = poses.unique("i", "pose"), poses.rising("time_s")
    poses.known("i", numbers, "nothing measures this pose; leave it out")
    if len(missing := np.setdiff1d(numbers, ids)):
        raise poses.at(
            len(poses) - 1, f"this is the last row, and pose {missing[0]} has none; give a time for every pose"
        )
    return t[np.argsort(ids)]


def _reckoned(mission: Assembly) -> Numbers:
    """Numbers of the poses, at the times of path.csv and of other files; adds `XYH` and `ZPR` between and at them.

    Between two rows the path is straight, and the variance of its step grows evenly.

    Raises
    ------
    GraphFileError
        Times that do not rise, one pose, numbers that cannot be.
    """
    path, report = mission.tables["path"], mission.report
    t_p = path.rising("time_s")
    if len(t_p) < 2:
        raise path.at(0, "one pose; a track has at least two")
    absent = [name for name in UPRIGHT if not path.has(name)]
    if absent:
        report.unmeasured = tuple(name.split("_")[0] for name in absent)
        report.notes.append(f"path.csv has no {', '.join(absent)}: taken as 0 and empty in the results")
    t = united(t_p, float(t_p[-1]), mission.times, mission.tables)
    numbers = np.arange(len(t))
    row = np.searchsorted(t_p, t)  # the first one that is not before
    state = {name: np.interp(t, t_p, _column(path, name, 0.0)) for name in (*ANGLES, *PLACE)}
    part = np.sqrt(np.diff(t) / np.diff(t_p)[row[1:] - 1])[:, None]
    X = euler.to_se3(np.column_stack([state[name] for name in (*ANGLES, *PLACE)]))
    step, _ = levelled(X[:-1], X[1:])
    sigmas = np.column_stack([_column(path, f"sigma_{name}", LEVEL_SIGMA)[row] for name in TILT])
    sigmas *= poses_of_rows(t_p, t)[:, None]
    report.vertex_times["x"] = t
    spread = Diagonal(path.positive(*suffixed(LEVEL))[row[1:]] * part)
    mission.add(XYH(x[numbers[:-1]], x[numbers[1:]], step, spread), path.source(row[1:]))
    tilts = np.column_stack([state[name] for name in TILT])
    mission.add(ZPR(x[numbers], tilts, Diagonal(sigmas)), path.source(row))
    return numbers


def _column(path: Table, name: str, absent: float) -> Array:
    """A column (n,) of the path: an angle without turns, a standard deviation above 0; a number where it is absent."""
    if not path.has(name):
        return np.full(len(path), absent)
    if name.startswith("sigma_"):
        return path.positive(name)[:, 0]
    column = path.attitude(name)[:, 0]
    return np.unwrap(column) if name in ANGLES else column
