r"""Checks of sound-speed.csv, and of ranges to beacons whose place is known.

A range r to a beacon at b is compared with the distance by dead reckoning, from where the fixes or the anchor put it:

    ratio = median r / |p + d(t) - b|
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array
from nls.io.mission.checks.findings import Cause, Implausible, Reading
from nls.io.mission.checks.log import Log
from nls.io.mission.table import Table

__all__ = ["of_ranges", "sound_speeds"]
SLOWEST, FASTEST = 1400.0, 1600.0  # m/s, of fresh water at 0 deg C and of the Red Sea or the deepest trench
FEET = 3.2808
SPEED, WAYS = 1500.0, 2.0  # of sound, m/s, and of a travel time, where nothing else is said
LOW, HIGH, FEW_ROWS = 0.8, 1.25, 5
FACTORS = (1000.0, 100.0, FEET, 2.0, 0.5, 0.001)  # of a range
TIMES = (1e3, 1e6, 2.0, 0.5)  # of a travel time
TELLING = 0.15  # of a factor


def sound_speeds(table: Table | None) -> list[Implausible]:
    """Speeds of sound that water does not have."""
    if table is None:
        return []
    c = table.floats("sound_speed_m_s")[:, 0]
    if not (out := (c < SLOWEST) | (c > FASTEST)).any():
        return []
    row = int(np.argmax(out))
    factor = next((f for f in (FEET, 1e3, 100.0, 1e-3) if SLOWEST < c[row] / f < FASTEST), None)
    column = "sound_speed_m_s"
    cause = Reading(Cause.UNKNOWN, "sound-speed.csv", column)
    if factor is not None:
        cause = Reading(Cause.UNIT, "sound-speed.csv", column, factor)
    limit = SLOWEST if c[row] < SLOWEST else FASTEST
    return [Implausible("sound speed", "sound-speed.csv", row, column, float(c[row]), limit, "m/s", (cause,))]


def of_ranges(tables: dict[str, Table], log: Log, start: Array) -> list[Implausible]:
    """Ranges that are a factor of the distances by dead reckoning.

    Parameters
    ----------
    tables : by name; ranges.csv with times, and beacons.csv with places in meters.
    log : the raw log.
    start : (2,) where dead reckoning begins, north and east, m.
    """
    ranges, beacons = tables.get("ranges"), tables.get("beacons")
    if ranges is None or beacons is None or not ranges.has("time_s") or not beacons.has("x_m", "y_m", "z_m"):
        return []
    t, ids, known = ranges.floats("time_s")[:, 0], ranges.integers("beacon"), beacons.integers("beacon")
    order = np.argsort(known)
    at = order[np.minimum(np.searchsorted(known[order], ids), len(known) - 1)]
    rows = np.flatnonzero((known[at] == ids) & (t >= log.t_v[0]) & (t <= log.t_v[-1]))
    if len(rows) < FEW_ROWS:
        return []
    way = log.way()
    p = np.column_stack([np.interp(t[rows], log.t_v, column) for column in way.T])
    p[:, :2] += start
    p[:, 2] = np.interp(t[rows], log.t_z, log.z)
    distance = np.linalg.norm(p - beacons.floats("x_m", "y_m", "z_m")[at[rows]], axis=1)
    r, column = _ranges(ranges)
    ratio = float(np.median(r[rows] / np.maximum(distance, 1e-3)))
    if LOW < ratio < HIGH:
        return []
    factors = TIMES if column == "travel_time_s" else FACTORS
    near = [f for f in factors if abs(ratio / f - 1) < TELLING]
    causes = tuple(Reading(Cause.UNIT if f > 2 or f < 0.5 else Cause.WAYS, "ranges.csv", column, f) for f in near)
    causes = causes or (Reading(Cause.UNKNOWN, "ranges.csv", column),)
    return [Implausible("range", "ranges.csv", int(rows[0]), column, ratio, HIGH if ratio > 1 else LOW, "", causes)]


def _ranges(table: Table) -> tuple[Array, str]:
    """Ranges (n,), m, and the column they are from."""
    if table.has("range_m"):
        return table.floats("range_m")[:, 0], "range_m"
    waiting = table.floats("turn_around_s")[:, 0] if table.has("turn_around_s") else 0.0
    ways = table.floats("ways")[:, 0] if table.has("ways") else WAYS
    return np.asarray(SPEED * (table.floats("travel_time_s")[:, 0] - waiting) / ways), "travel_time_s"
