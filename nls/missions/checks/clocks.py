r"""Checks of the times of the tables beside each other, and of fixes under water.

The track (B, E) is that of the table with which the others have most time in common. The times of a table (b, e)
beside it are in another unit where (e - b) / (E - B) is a thousand or so. They are late by whole weeks, days or hours
where only that brings them over the track. A sensor that begins some seconds after the others and ends by as much after
them is late by these.

A receiver of satellites has no fix under water. Where fixes are deep at their times, and all at the surface some leap
seconds earlier, or the time by which both b and e are late, their clock is off. Fixes by sound stay deep at any time.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from models.algebra import Array, Mask
from nls.missions.checks.alone import DAY, air_in
from nls.missions.checks.findings import Cause, Implausible, Reading
from nls.missions.folder.table import Table

TRACK = ("dvl", "ahrs", "depth", "pressure", "gyro", "path")
TIMED = (*TRACK, "fixes", "ranges", "usbl", "contacts", "ship")
LEAPS = {18.0: "GPS time and not UTC", 37.0: "TAI and not UTC", 19.0: "TAI and not GPS time"}  # s
PERIODS = {7 * DAY: "week", DAY: "day", 3600.0: "hour", 1800.0: "half-hour"}  # between clocks of two zones
SAME_CLOCK = 3.0  # s by which two clocks may differ


def clocks_by_spans(tables: dict[str, Table]) -> list[Implausible]:
    """Tables whose clock is off, and a depth that has the pressure of the air; lines are rows of the table."""
    timed = [name for name in TIMED if name in tables and tables[name].has("time_s")]
    times = {name: tables[name].floats("time_s")[:, 0] for name in timed}
    every = np.array([[t.min(), t.max()] for t in times.values()])
    track = every[: len(times.keys() & {*TRACK})]  # its tables come first
    if not len(track):
        return []
    span = max([np.sort(track, axis=0)[len(track) // 2], *track], key=lambda span: _agreement(every, span))
    out = [entry for name, t in times.items() for entry in _apart(f"{name}.csv", t, span)]
    if len(track) > 2:
        out = out or [entry for name in TRACK if name in times for entry in _shifted(f"{name}.csv", times[name], span)]
    file = next((name for name in ("depth", "path") if name in times and tables[name].has("z_m")), None)
    if not out and "fixes" in times and file is not None:
        out += _at_depth(times["fixes"], span, f"{file}.csv", times[file], tables[file].floats("z_m")[:, 0])
    return out


def _agreement(spans: Array, span: Array) -> float:
    """Of spans (n, 2) with one: the parts that both have of what either has, in all."""
    both = np.minimum(spans[:, 1], span[1]) - np.maximum(spans[:, 0], span[0])
    either = np.maximum(spans[:, 1], span[1]) - np.minimum(spans[:, 0], span[0])
    return float(np.sum(np.maximum(both, 0.0) / np.maximum(either, 1e-9)))


def _apart(file: str, t: Array, span: Array) -> Iterator[Implausible]:
    """Times (n,) that have another unit than the track, or another zone."""
    own, length = np.array([t.min(), t.max()]), max(float(span[1] - span[0]), 1e-9)
    ratio = float(np.ptp(own)) / length
    if factor := next((f for f in (1e3, 1e6, 1e9, 1e-3, 1 / DAY) if abs(ratio / f - 1) < 0.05), None):
        yield Implausible.of("span", ratio, 1.0, "", Reading(Cause.UNIT, file, "time_s", factor))
        return
    if own[0] < span[1] and own[1] > span[0] and np.abs(np.diff(own - span)) > SAME_CLOCK:
        return
    for period in PERIODS:
        late = float(np.round(np.mean(own - span) / period) * period)
        overlap = min(own[1] - late, span[1]) - max(own[0] - late, span[0])
        apart = np.abs(own - span - late).max() < SAME_CLOCK or own[0] > span[1] or own[1] < span[0]
        if late and apart and overlap >= 0.9 * min(np.ptp(own), length):
            yield Implausible.of("late", own[0] - span[0], 0.0, "s", Reading(Cause.ZONE, file, "time_s", late))
            return


def _shifted(file: str, t: Array, span: Array) -> Iterator[Implausible]:
    """Times (n,) of a sensor that begin and end later than those of most others, by the same time."""
    apart = np.array([t.min(), t.max()]) - span
    leaps = (s * leap for leap in LEAPS for s in (1, -1) if np.abs(apart - s * leap).max() <= np.ptp(apart))
    late = next(leaps, float(apart.mean()))
    if abs(late) > 15.0 and np.ptp(apart) <= 0.15 * abs(late):  # less: sensors switched on one after the other
        yield Implausible.of("late", late, 0.0, "s", Reading(Cause.ZONE, file, "time_s", late))


def _at_depth(t: Array, span: Array, file: str, t_z: Array, z: Array) -> Iterator[Implausible]:
    """Fixes that are under water at their times (n,), and at the surface earlier or later; or all of them at 10 m."""
    top, few, wet_from, dry_to = float(z.min()), 3, 2.0, 1.0  # m below it: no satellite is seen; it is the surface

    def deep(late: float) -> tuple[Mask, Array]:
        inside = (t - late >= t_z[0]) & (t - late <= t_z[-1])
        return inside, np.interp(t - late, t_z, z) - top

    inside, depth = deep(0.0)
    unit, enough = air_in(top), inside.sum() >= few
    if unit and enough and (depth[inside] < dry_to * unit).all() and (z - top > wet_from * unit).mean() > 0.2:
        yield Implausible.of("surface", top, dry_to, "m", Reading(Cause.PRESSURE, file, "z_m", unit))
    wet = inside & (depth > wet_from)
    own = np.array([t.min(), t.max()]) - span
    step = float(np.median(np.diff(np.sort(t)))) if len(t) > 1 else 0.0
    lags = [*LEAPS, *(-leap for leap in LEAPS)] + [float(own.mean())] * bool(np.ptp(own) <= min(2 * step, SAME_CLOCK))
    rows = {}
    for late in lags:
        shifted, below = deep(late)
        dry = shifted & (below < dry_to)
        enough = dry.sum() >= max(few, inside.sum()) or (dry.sum() >= few and 2 * wet.sum() >= inside.sum())
        if enough and not (shifted & ~dry).any():
            rows[late] = int(dry.sum())
    if wet.sum() >= few and rows:
        late = max(rows, key=lambda late: (rows[late], -abs(late)))
        at = np.flatnonzero(wet)
        of_depth = np.abs(np.array([t_z.min(), t_z.max()]) - span + late).max() < SAME_CLOCK  # it is that clock
        reading = Reading(Cause.ZONE, *((file, "time_s", -late) if of_depth else ("fixes.csv", "time_s", late)))
        yield Implausible.of("under water", len(at), 0.0, "", reading, row=0 if of_depth else at[0])
