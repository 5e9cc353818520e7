r"""Checks of a mission of any kind: depths, tilts and turns of its tables, steps of odometry, where a vehicle heads.

A vehicle goes ahead most of the time: the directions c of its way, less its headings, have a mean of length

    R = |sum w exp(i (c - yaw))| / sum w

near 1. Where R is not, and one of its columns read otherwise makes it so, that reading is named.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from models.algebra import Array
from nls.io.mission.checks.alone import FASTEST, FEW_ROWS, depth_of, step_of, tilt_of, turn_of
from nls.io.mission.checks.findings import Cause, Implausible, Reading
from nls.io.mission.checks.log import Log
from nls.io.mission.columns import VELOCITY
from nls.io.mission.table import Table

__all__ = ["of_heading", "of_track"]
LARGEST = 1e9  # m, as the reader has it
AHEAD, ASIDE = 0.95, 0.8  # R of a vehicle that goes ahead; at most that of one that does not
STRAIGHT = np.radians(20.0)  # the middle direction of one that goes ahead


def of_track(tables: dict[str, Table]) -> list[Implausible]:
    """Implausible numbers in the tables of a mission without a raw log; lines are rows of the table."""
    out: list[Implausible] = []
    for name in ("path", "zpr", "fixes", "ahrs", "depth"):
        if (table := tables.get(name)) is None:
            continue
        file, t = f"{name}.csv", None
        if table.has("time_s") and name != "fixes":
            t = table.rising("time_s")
            if steps := list(step_of(file, t)):
                return steps
            out += turn_of(file, t, table.floats("yaw_rad")[:, 0]) if table.has("yaw_rad") else ()
        if table.has("z_m"):
            out += depth_of(file, table.floats("z_m")[:, 0], t)
        for column in ("roll_rad", "pitch_rad"):
            out += tilt_of(file, column, table.floats(column)[:, 0]) if table.has(column) else ()
    if not out and "path" in tables:
        out += _course(tables["path"])
    return [*out, *_steps(tables["odometry"], tables.get("poses"))] if "odometry" in tables else out


def _course(path: Table) -> Iterator[Implausible]:
    """The path goes elsewhere than its heading says: a column of its places has another sign, or two are exchanged."""
    step, yaw = np.diff(path.floats("x_m", "y_m"), axis=0), path.floats("yaw_rad")[1:, 0]
    columns, course = "x_m, y_m", np.arctan2(step[:, 1], step[:, 0])
    others = {
        Reading(Cause.SIGN, "path.csv", "y_m", -1.0): -course,
        Reading(Cause.SIGN, "path.csv", "x_m", -1.0): np.pi - course,
        Reading(Cause.SWAPPED, "path.csv", columns): np.pi / 2 - course,
    }
    yield from _heads(course - yaw, {reading: c - yaw for reading, c in others.items()}, np.linalg.norm(step, axis=1))


def of_heading(log: Log) -> list[Implausible]:
    """Velocities of a DVL along north and east, or east and north: they turn with the heading of the vehicle."""
    v, yaw = log.v[log.valid], np.interp(log.t_v[log.valid], log.t_a, np.unwrap(log.rpy[:, 2]))
    course = np.arctan2(v[:, 1], v[:, 0])
    others = {
        Reading(Cause.EARTH, "dvl.csv", ", ".join(VELOCITY)): course - yaw,
        Reading(Cause.EARTH, "dvl.csv", ", ".join(VELOCITY), -1.0): np.pi / 2 - course - yaw,
    }
    return list(_heads(course, others, np.linalg.norm(v[:, :2], axis=1)))


def _heads(angles: Array, others: dict[Reading, Array], weights: Array) -> Iterator[Implausible]:
    """The reading that lets a vehicle go ahead, which does not as its tables are read; angles (n,) off ahead."""
    if len(angles) < FEW_ROWS or not weights.sum() > 0:
        return
    mean = abs(np.average(np.exp(1j * angles), weights=weights))
    for reading, other in others.items():
        r = np.average(np.exp(1j * other), weights=weights)
        if mean < ASIDE and abs(r) > AHEAD and abs(np.angle(r)) < STRAIGHT:
            column = reading.column.split(", ")[0]
            yield Implausible("heading", reading.file, 0, column, float(mean), AHEAD, "", (reading,))


def _steps(odometry: Table, poses: Table | None) -> Iterator[Implausible]:
    """Steps that are faster than a vehicle, where the poses have times."""
    if poses is None:
        return
    ids, t = poses.integers("i"), poses.floats("time_s")[:, 0]
    i, j = (np.searchsorted(np.sort(ids), odometry.integers(name)) for name in ("i", "j"))
    t = t[np.argsort(ids)]
    if max(i.max(), j.max()) >= len(t) or not (t[j] != t[i]).all():
        return  # the reader names these
    way = odometry.floats("x_m", "y_m")
    if not np.abs(way).max() < LARGEST:
        return
    speed = np.linalg.norm(way, axis=1) / np.abs(t[j] - t[i])
    if (middle := float(np.median(speed))) > FASTEST:
        units = [f for f in (1000.0, 100.0) if middle / f < FASTEST / 2]
        causes = [Reading(Cause.UNIT, "odometry.csv", "x_m, y_m", f) for f in units]
        causes += [Reading(Cause.UNIT, "poses.csv", "time_s", 1e-3)] * (not causes)
        row = int(np.argmax(speed > FASTEST))
        yield Implausible("speed", "odometry.csv", row, "x_m", middle, FASTEST, "m/s", tuple(causes))
