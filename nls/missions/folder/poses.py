r"""Poses of a trajectory with their times or numbers, of any file that holds them: TUM, KITTI, CSV with a head, graphs.

A CSV file has the columns of a mission's ``truth.csv`` and ``trajectory.csv``: x_m, y_m, z_m, roll_rad, pitch_rad,
yaw_rad. It has i (numbers of the poses), time_s, or both. Other columns are not read but standard deviations of these.
Poses of the plane have x_m, y_m and yaw_rad alone; positions alone are poses without headings. A column of empty cells
is none, as of what nothing measures. A scan mission calls its
columns keyframe, time, x, y and yaw.

**The truth** of a mission, truth.csv and landmarks.csv: the true poses and landmarks that a solution is compared with.
"""

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from factors.keys import kinds
from models import SE3, Manifold, R, euler
from models.algebra import Array, Numbers
from models.errors import OptionError
from models.options import did_you_mean
from nls.io import load
from nls.io.files import GRAPH_FILES
from nls.io.formats import Reading, suffix_of, suffixes
from nls.io.trajectory import lifted, track_of
from nls.missions.folder.calibration import Spaces
from nls.missions.folder.columns import ANGLES, PLACE, UPRIGHT, suffixed
from nls.missions.folder.folder import MissionReport
from nls.missions.folder.table import Table
from nls.values import Values

NEEDED = (*ANGLES, *PLACE)
SIGMAS = suffixed(PLACE)
OPTIONAL = ("i", "time_s", *UPRIGHT, "yaw_rad", *SIGMAS)
COLUMNS = ("x_m", "y_m", *OPTIONAL)
FILES = ("trajectory.csv",)  # of a solution
TRUE_FILES = ("truth.csv", "truth/truth.csv", "truth.npz", *FILES)  # of a mission; the second one as nls-sim writes it
ALIASES = {"keyframe": "i", "time": "time_s", "x": "x_m", "y": "y_m", "yaw": "yaw_rad"}
x, l = kinds("x", "l")


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


def read_poses(path: str | Path, folder_files: Sequence[str] = FILES) -> Poses:
    """The poses of a trajectory, ``*.tum``, ``*.kitti`` or ``*.csv``, or of a graph; files may be gzip-compressed.

    Parameters
    ----------
    path : the file; or a folder with one of `folder_files`, the first of which counts, or with a graph.
    folder_files : their names without ``.gz``.

    Raises
    ------
    OptionError
        A name that says no such format; a folder without such a file.
    GraphError
        A graph whose poses are none, or of several kinds.
    GraphFileError
        No such file, a column that is missing, a cell that is no number, a number given twice: with file and line.
    SingularGeometryError
        Euler angles at gimbal lock.
    """
    if os.path.isdir(path):
        names = (Path(path, name + end) for name in (*folder_files, *GRAPH_FILES) for end in ("", ".gz"))
        if (file := next((name for name in names if name.is_file()), None)) is None:
            cure = f"a folder with {' or '.join(folder_files)}, as nls solve {shlex.quote(str(path))} -o OUT writes"
            raise OptionError("folder of poses", str(path), cure)
        path = file
    row = suffixes().get(suffix_of(path))
    if row is not None and row.poses_alone:
        _, values, report = row.read(Reading(), path)
        return Poses(str(path), np.asarray(values.stack("x").X), report.vertex_times.get("x") if len(values) else None)
    if suffix_of(path) == ".csv":
        return _table(path)
    known = [name for name in suffixes() if name != ".ply"]
    if suffix_of(path) not in known:
        raise OptionError("file of poses", str(path), f"a folder, or a file ending in {', '.join(known)}")
    _, values, report = load(path)
    stack = track_of(path, values)
    return Poses(str(path), lifted(stack.X), report.vertex_times.get(stack.kind), stack.numbers)


def _table(path: str | Path) -> Poses:
    """The poses of a CSV file."""
    table = Table(path, COLUMNS, OPTIONAL, needed=True, others=ALIASES)
    if any(map(table.has, UPRIGHT)) and (missing := [name for name in NEEDED if not table.has(name)]):
        near = did_you_mean(missing[0], table.names)
        raise table.at_names(f"no column {missing[0]!r}{near}; expected {', '.join(NEEDED)}")
    if not (table.has("i") or table.has("time_s")):
        raise table.at_names("no column 'i' and none 'time_s': one of the two says which pose a row is")
    measured = [name for name in NEEDED if table.has(name) and table.filled(name).any()]
    table.refuse_empty([name for name in ("i", "time_s", *measured) if table.has(name)])
    state = np.zeros((len(table), len(NEEDED)))
    state[:, [NEEDED.index(name) for name in measured]] = table.floats(*measured)
    times = table.floats("time_s")[:, 0] if table.has("time_s") else None
    ids = _numbers(table) if table.has("i") else None
    sigmas = np.column_stack([_where_filled(table, name) for name in SIGMAS]) if table.has(*SIGMAS) else None
    return Poses(str(path), euler.to_se3(state), times, ids, sigmas, "yaw_rad" in measured)


def _numbers(table: Table) -> Numbers:
    """Numbers (n,) of the poses, each once."""
    i = table.floats("i")[:, 0]  # also as a program writes them: 3.0
    table.refuse_rows((i != np.rint(i)) | (np.abs(i) > 2**53), lambda k: f"i is {i[k]:g}; expected a whole number")
    ids = i.astype(np.int64)
    table.once(ids, table.lines, "pose ")
    return ids


def _where_filled(table: Table, name: str) -> Array:
    """Numbers (n,) of a column, nan of its empty cells."""
    numbers, filled = np.full(len(table), np.nan), table.filled(name)[:, 0]
    numbers[filled] = table.part(filled).floats(name)[:, 0]
    return numbers


def true_values(tables: dict[str, Table], numbers: Numbers, report: MissionReport) -> Values:
    """True poses and landmarks, where there are files of them."""
    true: Spaces = {}
    if (table := tables.get("truth")) is not None and not table.has("i"):
        true[x] = _truth_at_times(table, numbers, report)
    elif table is not None:
        if table.has("time_s"):
            raise table.at(0, "truth.csv has both i and time_s; leave one of the two columns out")
        ids = table.unique("i", "pose")
        true[x] = (SE3, euler.to_se3(table.attitude(*ANGLES, *PLACE)), ids)
        if not np.isin(ids, numbers).any():
            raise table.at(0, f"pose {ids[0]} and all others are not in the track, {numbers[0]} to {numbers[-1]}")
        _compare("truth.csv", "poses", ids, numbers, report)
    if (table := tables.get("landmarks")) is not None:
        true[l] = (R(3), table.measured(*PLACE), table.unique("landmark", "landmark"))
    return Values(true)


def _truth_at_times(table: Table, numbers: Numbers, report: MissionReport) -> tuple[Manifold, Array, Numbers]:
    """True poses at the times of those of the track: on the line between two rows, position and angles."""
    if not table.has("time_s"):
        raise table.at(0, "truth.csv has neither i nor time_s; say of which pose, or of which time, each row is")
    if (times := report.vertex_times.get("x")) is None:
        raise table.at(0, "truth.csv has times and the poses have none; give i instead, or the times in poses.csv")
    t, state = table.rising("time_s"), table.attitude(*ANGLES, *PLACE)
    inside = (times >= t[0]) & (times <= t[-1])
    if not inside.any():
        rest = f"s and the poses of {float(times.min())!r} to {float(times.max())!r} s: no time in common"
        raise table.at(0, f"the truth is of {float(t[0])!r} to {float(t[-1])!r} {rest}")
    if outside := int((~inside).sum()):
        reason = f"errors are of {inside.sum()} poses, not of {outside} before or after it"
        report.notes.append(f"truth.csv does not last as long as the track: {reason}")
    state[:, :3] = np.unwrap(state[:, :3], axis=0)
    at_poses = np.column_stack([np.interp(times[inside], t, column) for column in state.T])
    return SE3, euler.to_se3(at_poses), numbers[inside]


def compare_landmarks(report: MissionReport, points: Numbers) -> None:
    """Say which landmarks have no row in landmarks.csv, and which of its rows have no landmark."""
    if "l" not in report.truth.stacks:
        return
    known = report.truth.stack("l").numbers
    if not len(points):
        report.notes.append("landmarks.csv is not used: there is no contacts.csv")
    elif not np.isin(points, known).any():
        rest = f"{known[0]} the first, is in contacts.csv, where {points[0]} is; their errors are not known"
        report.notes.append(f"landmarks.csv is not used: none of its landmarks, {rest}")
    else:
        _compare("landmarks.csv", "landmarks", known, points, report)


def _compare(file: str, noun: str, known: Numbers, measured: Numbers, report: MissionReport) -> None:
    """Say how many of those measured have no truth, and how many truths nothing measures."""
    if missing := len(np.setdiff1d(measured, known)):
        rest = "errors are of the others"
        report.notes.append(f"{file} has no row for {missing} of {len(measured)} {noun}: {rest}")
    if more := len(np.setdiff1d(known, measured)):
        report.notes.append(f"{file} has {more} {noun} nothing measures: not used")
