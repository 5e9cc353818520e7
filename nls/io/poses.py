"""Poses of a trajectory with their times or numbers, of any file that holds them: TUM, KITTI, and CSV with a head.

A CSV file has the columns of a mission's ``truth.csv`` and ``trajectory.csv``: x_m, y_m, z_m, roll_rad, pitch_rad,
yaw_rad. It has i (numbers of the poses), time_s, or both. Other columns are not read but standard deviations of these.
Poses of the plane have x_m, y_m and yaw_rad alone; positions alone are poses without headings. A column of empty cells
is none, as of what nothing measures. A scan mission calls its
columns keyframe, time, x, y and yaw.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from models import euler
from models.algebra import Array, Numbers
from models.errors import GraphFileError, OptionError
from models.options import did_you_mean
from nls.io.files import read_text
from nls.io.mission.columns import ANGLES, PLACE, suffixed
from nls.io.trajectory import TRAJECTORIES, load_trajectory
from nls.values import Values

__all__ = ["Poses", "read_poses"]

NEEDED = (*PLACE, *ANGLES)
OF_SPACE = ("z_m", "roll_rad", "pitch_rad")  # 0 where a file has none of them
SIGMAS = suffixed(PLACE)
ALIASES = {"keyframe": "i", "time": "time_s", "x": "x_m", "y": "y_m", "yaw": "yaw_rad"}


@dataclass(frozen=True)
class Poses:
    """The poses of a file, in the order of its rows.

    Attributes
    ----------
    path : the file.
    X : (n, 7) SE3.
    times : (n,) s; None where the file has none.
    numbers : (n,) of the poses; None where the file has none.
    sigmas : (n, 3) standard deviations of x, y and z, m, nan in empty cells; None without these columns.
    oriented : whether the file has headings; without them the rotations are those of 0.
    """

    path: str
    X: Array = field(repr=False)
    times: Array | None = field(default=None, repr=False)
    numbers: Numbers | None = field(default=None, repr=False)
    sigmas: Array | None = field(default=None, repr=False)
    oriented: bool = True


def read_poses(path: str | Path) -> Poses:
    """The poses of a trajectory, ``*.tum``, ``*.kitti`` or ``*.csv``, which may be gzip-compressed.

    Raises
    ------
    OptionError
        A name that says no such format.
    GraphFileError
        No such file, a column that is missing, a cell that is no number, a number given twice: with file and line.
    SingularGeometryError
        Euler angles at gimbal lock.
    """
    form = Path(str(path).lower().removesuffix(".gz")).suffix[1:]
    if form in TRAJECTORIES:
        values, report = load_trajectory(path, form)
        return Poses(str(path), np.asarray(values.stack("x").X), _times(values, report.vertex_times))
    if form != "csv":
        raise OptionError(
            "file of poses", str(path), "a file ending in .tum, .kitti or .csv; nls convert writes the first two"
        )
    return _table(path)


def _times(values: Values, times: dict[str, Array]) -> Array | None:
    return times.get("x") if len(values) else None


def _table(path: str | Path) -> Poses:
    """The poses of a CSV file."""
    lines = read_text(path).splitlines()
    rows = [(k + 1, line) for k, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    if len(rows) < 2:
        raise GraphFileError("has no poses; expected a line of names and a row for each pose", str(path))
    head, *body = ([cell.strip() for cell in cells] for cells in csv.reader(line for _, line in rows))
    place = {ALIASES.get(name, name): k for k, name in enumerate(head)}
    plane = place.keys().isdisjoint(OF_SPACE)
    for name in NEEDED:
        if plane and name in (*OF_SPACE, "yaw_rad"):
            continue
        if name not in place:
            raise GraphFileError(
                f"no column {name!r}{did_you_mean(name, head)}; expected {', '.join(NEEDED)}", str(path), 1
            )
    if "i" not in place and "time_s" not in place:
        raise GraphFileError("no column 'i' and none 'time_s': one of the two says which pose a row is", str(path), 1)
    where = [line for line, _ in rows[1:]]
    for line, cells in zip(where, body, strict=True):
        if len(cells) != len(head):
            raise GraphFileError(f"{len(cells)} cells, expected {len(head)}: {','.join(head)}", str(path), line)

    measured = {name for name in NEEDED if name in place and any(cells[place[name]] for cells in body)}

    def numbers(name: str, optional: bool = False) -> Array:
        return np.array(
            [
                _number(str(path), line, name, cells[place[name]], optional)
                for line, cells in zip(where, body, strict=True)
            ]
        )

    state = np.column_stack([numbers(name) if name in measured else np.zeros(len(body)) for name in (*ANGLES, *PLACE)])
    times = numbers("time_s") if "time_s" in place else None
    ids = numbers("i") if "i" in place else None
    if ids is not None and len(unique := np.unique(ids, return_index=True)[1]) < len(ids):
        k = int(np.setdiff1d(np.arange(len(ids)), unique)[0])
        raise GraphFileError(f"pose {ids[k]:.0f} was given before", str(path), where[k])
    known = set(SIGMAS) <= set(place)
    sigmas = np.column_stack([numbers(name, optional=True) for name in SIGMAS]) if known else None
    whole = None if ids is None else ids.astype(np.int64)
    return Poses(str(path), euler.to_se3(state), times, whole, sigmas, "yaw_rad" in measured)


def _number(path: str, line: int, name: str, cell: str, optional: bool) -> float:
    """A finite number; nan of an empty cell that may be empty."""
    if optional and not cell:
        return float("nan")
    try:
        number = float(cell)
    except ValueError:
        number = float("nan")
    if not math.isfinite(number) or (name == "i" and (number != round(number) or abs(number) > 2**53)):
        kind = "a whole number" if name == "i" else "a finite number"
        raise GraphFileError(f"{name} is {cell!r:.60}; expected {kind}", path, line)
    return number
