r"""Checks of a mission of any kind: depths, tilts and turns of its tables, steps of odometry, where a vehicle heads.

A vehicle goes ahead most of the time: the directions c of its way, less its headings, have a mean of length

    R = |sum w exp(i (c - yaw))| / sum w

near 1. Where R is not, and one of its columns read otherwise makes it so, that reading is named. From fix to fix the
heading is that of a way at an even speed. A heading counted counterclockwise and a longitude of the other side turn c
against the heading alike, so both are named.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from models.algebra import Array, Mask
from nls.missions.checks.alone import (
    FAR,
    FASTEST,
    FEW_ROWS,
    depth_of,
    outliers_of,
    scatter_of,
    step_of,
    stuck_of,
    tilt_of,
    turn_of,
)
from nls.missions.checks.findings import Cause, Implausible, Reading
from nls.missions.checks.log import Fixes, Log, middle
from nls.missions.folder.columns import ANGLES, VELOCITY
from nls.missions.folder.table import Table

LARGEST = 1e9  # m, as the reader has it


def of_track(tables: dict[str, Table], fixes: Fixes | None) -> list[Implausible]:
    """Implausible numbers in the tables of a mission without a raw log, and its fixes; lines are rows of the table."""
    out: list[Implausible] = []
    moves = fixes is not None and np.ptp(fixes.p, axis=0).max() > FAR * np.median(fixes.sigma)
    noise = tables.get("noise")
    sigmas = dict(zip(noise.names, noise.floats(*noise.names)[0].tolist(), strict=True)) if noise else {}
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
            z = table.floats("z_m")[:, 0]
            out += depth_of(file, z, t)
            out += outliers_of(file, ("z_m",), z[:, None], [sigmas.get("sigma_z_m", 0.0)])
        for column in ("roll_rad", "pitch_rad"):
            out += tilt_of(file, column, table.floats(column)[:, 0]) if table.has(column) else ()
        for column in (*ANGLES, "z_m") if name in ("ahrs", "depth") and not out else ():
            y = table.floats(column)[:, 0] if table.has(column) else np.zeros(0)
            y = y[np.abs(y) < LARGEST]
            out += scatter_of(file, column, y, sigmas)
            out += stuck_of(file, column, y) if moves and np.any(y) else ()
    if not out and "path" in tables:
        out += _course(tables["path"])
    if not out and fixes is not None and "ahrs" in tables and tables["ahrs"].has("yaw_rad"):
        out += _between_fixes(fixes, tables["ahrs"])
    return [*out, *_steps(tables["odometry"], tables.get("poses"))] if "odometry" in tables else out


def of_ship(ship: Table) -> Iterator[Implausible]:
    """Attitude of a ship: roll and pitch, turns, and a heading that never changes."""
    file, t, (roll, pitch, yaw) = "ship.csv", ship.rising("time_s"), ship.floats(*ANGLES).T
    yield from tilt_of(file, "roll_rad", roll)
    yield from tilt_of(file, "pitch_rad", pitch)
    yield from turn_of(file, t, yaw)
    if np.ptp([roll, pitch], axis=1).any():
        yield from stuck_of(file, "yaw_rad", yaw)


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


def _between_fixes(fixes: Fixes, ahrs: Table) -> Iterator[Implausible]:
    """The way from fix to fix turns against the heading: one of the two has another sign, or begins at east."""
    t, file, (north, east) = ahrs.rising("time_s"), "fixes.csv", fixes.columns
    ahead = np.exp(1j * ahrs.floats("yaw_rad")[:, 0])
    way = np.append(0.0, np.cumsum((ahead[1:] + ahead[:-1]) / 2 * np.diff(t)))
    inside = np.flatnonzero((fixes.t >= t[0]) & (fixes.t <= t[-1]))
    while len(inside) > FEW_ROWS:
        steps = np.diff(fixes.p[inside], axis=0) @ [1, 1j]
        if np.median(np.abs(steps)) > 6.0 * np.median(fixes.sigma):
            break
        inside = inside[::2]
    else:
        return
    course = np.angle(steps)
    yaw = np.angle(np.diff(np.interp(fixes.t[inside], t, way)))
    if np.abs(np.diff(np.unwrap(yaw[:: len(yaw) // 40 + 1]))).sum() < 2 * np.pi:  # of at most 40: less is by chance
        return
    others = {
        Reading(Cause.SIGN, "ahrs.csv", "yaw_rad", -1.0): course + yaw,
        Reading(Cause.SIGN, file, east, -1.0): -course - yaw,
        Reading(Cause.NORTH, "ahrs.csv", "yaw_rad", 90.0): course + yaw - np.pi / 2,
        Reading(Cause.SWAPPED, file, f"{north}, {east}"): np.pi / 2 - course - yaw,
        Reading(Cause.SIGN, file, north, -1.0): np.pi - course - yaw,
    }
    yield from _heads(course - yaw, others, np.abs(steps))


def of_fixes(fixes: Fixes | None, wild: Mask) -> list[Implausible]:
    """Implausible fixes, of which some (n,) are `jumping`; lines are rows of the table.

    All may be beyond the plane: another origin, latitude and longitude exchanged, or the letter of a side lost. So many
    may leave those before and after that a robust kernel is needed.
    """
    if fixes is None:
        return []
    away, out = np.linalg.norm(fixes.p, axis=1), []
    farthest, wild_share = 1e5, 0.02  # m, where the plane is no map any more; a voyage may be longer
    low, high = np.quantile(fixes.p, [0.05, 0.95], axis=0)
    if (distance := float(np.median(away))) > max(farthest, float(np.linalg.norm(high - low))):
        near = [reading for reading, p in fixes.others if np.median(np.linalg.norm(p, axis=1)) < farthest]
        reading = next(iter(near), Reading(Cause.FAR, "fixes.csv", ", ".join(fixes.columns)))
        row = int(fixes.rows[np.argmax(away > farthest)])
        out.append(Implausible("far away", "fixes.csv", row, fixes.columns[0], distance, farthest, "m", (reading,)))
    if wild.any() and (share := wild.mean()) > wild_share:
        row, reading = int(fixes.rows[np.argmax(wild)]), Reading(Cause.OUTLIERS, "fixes.csv", ", ".join(fixes.columns))
        column, unit = fixes.columns[0], "of the rows"
        out.append(Implausible("jumps", "fixes.csv", row, column, share, wild_share, unit, (reading,)))
    return out


def jumping(log: Log) -> Mask:
    """Single fixes (n,) of a thinned log that leave those before and after, which the DVL joins; none of a few."""
    fixes = log.fixes
    if fixes is None or len(fixes.t) < 10:
        return np.zeros(0 if fixes is None else len(fixes.t), dtype=bool)
    d = np.column_stack([np.interp(fixes.t, log.t_v, column) for column in log.way()[:, :2].T])
    off = fixes.p - d
    away = np.linalg.norm(off - middle(off), axis=1)
    step = np.linalg.norm(np.diff(d, axis=0), axis=1)
    allowed = FAR * fixes.sigma + 0.1 * (np.append(step, 0.0) + np.append(0.0, step))  # a drift of the way
    wild = away > np.maximum(allowed, 3 * float(np.median(away)))
    return np.asarray(wild & (fixes.t >= log.t_v[0]) & (fixes.t <= log.t_v[-1]))


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
    ahead, aside, straight = 0.9, 0.8, np.radians(20.0)  # R and middle direction of a vehicle that goes ahead, or not
    r, *rs = (np.average(np.exp(1j * c), weights=weights) for c in (angles, *others.values()))
    near = [k for k, r_k in zip(others, rs, strict=True) if abs(r_k) > ahead and abs(np.angle(r_k)) < straight]
    if near and abs(r) < aside:
        yield Implausible("heading", near[0].file, 0, near[0].columns[0], float(abs(r)), ahead, "", tuple(near))


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
    if (usual := float(np.median(speed))) > FASTEST:
        units = [f for f in (1000.0, 100.0) if usual / f < FASTEST / 2]
        causes = [Reading(Cause.UNIT, "odometry.csv", "x_m, y_m", f) for f in units]
        causes += [Reading(Cause.UNIT, "poses.csv", "time_s", 1e-3)] * (not causes)
        row = int(np.argmax(speed > FASTEST))
        yield Implausible("speed", "odometry.csv", row, "x_m", usual, FASTEST, "m/s", tuple(causes))
