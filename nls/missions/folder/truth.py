"""truth.csv and landmarks.csv: the true poses and landmarks of a mission, which a solution is judged by."""

from __future__ import annotations

import numpy as np

from factors.keys import kinds
from models import SE3, Manifold, R, euler
from models.algebra import Array, Numbers
from nls.missions.folder.calibration import Spaces
from nls.missions.folder.columns import ANGLES, PLACE
from nls.missions.folder.report import MissionReport
from nls.missions.folder.table import Table
from nls.values import Values

x, l = kinds("x", "l")


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
            raise table.at(0, f"pose {ids[0]} and all others are none of the track's, {numbers[0]} to {numbers[-1]}")
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
    """Say which landmarks cannot be judged by landmarks.csv, and which of its rows judge none."""
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
