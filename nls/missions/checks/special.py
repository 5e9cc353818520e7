r"""Numbers that stand for none, as -32768, 9999, or 0 and 0 of a fix; and sensors that repeat one number.

A number s of a column y is special where it is one that loggers write for none, in any unit, and is far from the rows
around it:

    |s - y_before|, |s - y_after| > 4 max(q(|step|), |y_after - y_before|)

with a quantile q of the steps between other rows; or where s is beyond all others by their range. Vehicles have 0, too:
it is special between two rows only.
"""

from collections.abc import Iterator

import numpy as np

from models.algebra import Array, Index, Mask, wrap
from nls.missions.checks.alone import FASTEST, roughness
from nls.missions.checks.findings import Cause, Implausible, Reading
from nls.missions.checks.log import Fixes, Log
from nls.missions.folder.columns import ANGLES, GEODETIC, SENTINELS, VELOCITY
from nls.missions.folder.dvl import bottom_lock
from nls.missions.folder.table import Table

LOG_UNITS = (1.0, 10.0, 100.0, 1000.0, 1e7, 3.28084, 1.943844, 3.6, 180 / np.pi)  # of the log in one of the mission
JUMPS = {"_m_s": 0.3, "_rad": 0.1, "_deg": 1e-4, "_m": 3.0, "_s": 1e-3, "_pa": 1e4}  # the least, by the end of a name
SINGLE = ("z_m", "pressure_pa", "range_m", "travel_time_s", "azimuth_rad", "bearing_rad", "elevation_rad")
RATES = ("wx_rad_s", "wy_rad_s", "wz_rad_s")
GROUPS = (VELOCITY, RATES, ANGLES, ("x_m", "y_m"), GEODETIC, *((name,) for name in SINGLE))  # measured together
SENSORS = ("dvl", "ahrs", "gyro", "depth", "pressure")
TABLES = (*SENSORS, "fixes", "path", "zpr", "odometry", "ranges", "usbl", "contacts", "ship")
POSITIVE = ("range_m", "travel_time_s")
OFTEN, MANY = 3, 15  # rows of one number: of a fix or of the largest range, of a sensor
SLOW = 0.05  # m/s of a vehicle that moves


def special_values(tables: dict[str, Table]) -> list[Implausible]:
    """Numbers that stand for none, by table, columns and number; lines are rows of the table."""
    return [entry for name in TABLES if name in tables for entry in _of_table(name, tables[name])]


def without(tables: dict[str, Table], findings: list[Implausible]) -> dict[str, Table]:
    """The tables without the rows of findings."""
    out = dict(tables)
    for name in {entry.file.removesuffix(".csv") for entry in findings}:
        rows = np.concatenate([entry.lines for entry in findings if entry.file == f"{name}.csv"])
        out[name] = tables[name].part(np.delete(np.arange(len(tables[name])), rows))
    return out


def _of_table(name: str, table: Table) -> Iterator[Implausible]:
    measured: Mask = bottom_lock(table, []) if name == "dvl" else np.ones(len(table), dtype=bool)
    for group in GROUPS:
        columns = [column for column in group if table.has(column)]
        if not columns or not np.abs(y := table.floats(*columns)).max() < 1e12:
            continue  # a larger number is refused by the reader
        listed = np.column_stack([_listed(y_k, column) for column, y_k in zip(columns, y.T, strict=True)])
        listed &= measured[:, None]
        none = listed.any(axis=1)
        may_be_none = (len(columns) > 1 or group == ("z_m",)) and name != "odometry"
        zero: Mask = (y == 0).all(axis=1) & measured & np.array(may_be_none)
        for special, cells, cause in ((none, listed, Cause.NONE), (zero, y == 0, Cause.ZEROS)):
            for value in np.unique(y[special][cells[special]]):
                rows = special & (cells & (y == value)).any(axis=1)
                far = _far(y, rows, measured & ~none & ~zero, columns, special is zero)
                if columns[0] in POSITIVE and value <= 0:
                    far = rows
                if far.any():
                    here = [column for column, y_k in zip(columns, y.T, strict=True) if (y_k[far] == value).any()]
                    reading = Reading(cause, f"{name}.csv", ", ".join(here), float(value))
                    yield Implausible.of("special value", value, 0.0, "", reading, lines=np.flatnonzero(far))


def _listed(y: Array, column: str) -> Mask:
    """Which numbers (n,) are among those that loggers write for none."""
    out = np.zeros(len(y), dtype=bool)
    for unit in LOG_UNITS:
        out |= np.isclose(np.abs(y[:, None]) * unit, SENTINELS, rtol=1e-7, atol=0).any(axis=1)
    if column.endswith("_rad"):
        out |= np.isclose(np.abs(y[:, None]), np.abs(wrap(np.radians(SENTINELS))), rtol=0, atol=1e-9).any(axis=1)
    if column in POSITIVE and (y == y.max()).sum() >= OFTEN:
        out |= y == y.max()
    return np.asarray(out | (y <= 0) if column in POSITIVE else out)


def meant(column: str, value: float) -> list[float]:
    """A number and those that it may be in the log, where this has another unit.

    Examples
    --------
    >>> meant("vx_m_s", -32.768), meant("z_m", -9999.0)
    ([-32.768, -32768.0], [-9999.0])
    """
    whole = [n for unit in LOG_UNITS for n in SENTINELS if np.isclose(abs(value) * unit, n, rtol=1e-7, atol=0)]
    if column.endswith("_rad") and not whole and value:
        return [s * n for n in SENTINELS for s in (-1, 1) if abs(wrap(np.radians(s * n)) - value) < 1e-9]
    return list(dict.fromkeys([value, *(float(np.copysign(n, value)) for n in whole)]))


def _far(y: Array, rows: Mask, others: Mask, columns: list[str], zero: bool) -> Mask:
    """Which of some rows (n,) are far from the other ones before and after, in a column or more."""
    known, index = np.flatnonzero(others), np.arange(len(y))
    if len(known) < 2:
        return np.zeros(len(y), dtype=bool)
    place = np.searchsorted(known, index)
    before, after = known[np.maximum(place - 1, 0)], known[np.minimum(place, len(known) - 1)]
    step = _between(y[known[1:]], y[known[:-1]], columns)[np.diff(known) == 1]
    usual = np.quantile(step, 0.95, axis=0) if len(step) else np.zeros(len(columns))
    least = [next((jump for end, jump in JUMPS.items() if name.endswith(end)), 0.0) for name in columns]
    jump = np.minimum(_between(y, y[before], columns), _between(y, y[after], columns))
    far = (jump > 4.0 * np.maximum(usual, _between(y[after], y[before], columns))) & (jump > least)
    if not zero or columns[0] in GEODETIC:
        low, high = y[known].min(axis=0), y[known].max(axis=0)
        return np.asarray(rows & (far | (np.maximum(low - y, y - high) > np.maximum(high - low, least))).any(axis=1))
    if columns[0] in ANGLES and rows.sum() >= OFTEN and y[known].all():
        far |= True  # an attitude that is 0 at no other time is never 0 three times over
    return np.asarray(rows & far.any(axis=1) & (before < index) & (index < after))


def _between(a: Array, b: Array, columns: list[str]) -> Array:
    """Distances (n, k) of numbers of columns; of angles the shorter way around."""
    return np.abs(wrap(a - b) if columns[0].endswith("_rad") else a - b)


def stale(log: Log | None, fixes: Fixes | None, path: tuple[Array, Array] | None) -> list[Implausible]:
    """Fixes, velocities and headings that are repeated row after row while the vehicle moves; lines are rows.

    Parameters
    ----------
    log : the raw log, None of other missions.
    fixes : None where there are none.
    path : times (n,) and places (n, 2 or 3) of the vehicle by another sensor; None where there is none.
    """
    out = [] if fixes is None else list(_of_fixes(fixes, path))
    if log is not None:
        rows = np.flatnonzero(log.valid)
        speed, yaw = np.linalg.norm(log.v[rows], axis=1), np.unwrap(log.rpy[:, 2:], axis=0)
        for file, columns, t, y, sigma, places in (
            ("dvl.csv", VELOCITY, log.t_v[rows], log.v[rows], "sigma_v_m_s", rows),
            ("ahrs.csv", ("yaw_rad",), log.t_a, yaw, "sigma_yaw_rad", np.arange(len(yaw))),
            ("depth.csv", ("z_m",), log.t_z, log.z[:, None], "sigma_z_m", np.arange(len(log.z))),
        ):
            stuck = _stuck(t, y, log.sigmas[sigma])
            if (stuck & (np.interp(t, log.t_v[rows], speed) > SLOW)).any():
                reading, seconds = Reading(Cause.STALE, file, ", ".join(columns)), float(np.ptp(t[stuck]))
                out.append(Implausible.of("repeated", seconds, 0.0, "s", reading, lines=places[stuck]))
    return out


def repeated(tables: dict[str, Table]) -> Iterator[Implausible]:
    """Directions of usbl.csv, places and headings of ship.csv that are repeated, where others hardly ever are."""
    for name, columns, often in (
        ("usbl", ("range_m", "bearing_rad", "elevation_rad"), OFTEN),
        ("ship", ("x_m", "y_m"), MANY),
        ("ship", GEODETIC, MANY),
        ("ship", ("yaw_rad",), MANY),
    ):
        if (table := tables.get(name)) is None or not table.has(*columns, "time_s"):
            continue
        y, t = table.floats(*columns), table.floats("time_s")[:, 0]
        same = _held(t, y, often)
        if same.any() and len(np.unique(y[~same, 0])) > max(len(y) - same.sum(), MANY) / 2:
            reading = Reading(Cause.STALE, f"{name}.csv", ", ".join(columns))
            yield Implausible.of("repeated", np.ptp(t[same]), 0.0, "s", reading, lines=np.flatnonzero(same))


def _runs(y: Array) -> tuple[Index, Index]:
    """The first and the last rows (k,) of two or more equal ones of y (n, d)."""
    same = (np.diff(y, axis=0) == 0).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same, [0]])))
    return edges[::2], edges[1::2]


def _repeats(first: Index, last: Index, count: int) -> Mask:
    """Which of the rows (count,) repeat the first one of a run."""
    edges = np.zeros(count + 1, dtype=int)
    edges[first + 1], edges[last + 1] = 1, -1
    return np.cumsum(edges[:-1]) > 0


def _held(t: Array, y: Array, often: int) -> Mask:
    """Which rows of y (n, d) at times (n,) repeat one that so many others do, for long."""
    first, last = _runs(y)
    many = (last - first >= often) & (t[last] - t[first] >= 5.0)
    return _repeats(first[many], last[many], len(y))


def _of_fixes(fixes: Fixes, path: tuple[Array, Array] | None) -> Iterator[Implausible]:
    first, last = _runs(fixes.p)
    if path is None:  # the next fix is nearer than a vehicle can have gone, or this one is old
        first, last = first[last < len(fixes.t) - 1], last[last < len(fixes.t) - 1]
        moved, limit = np.linalg.norm(fixes.p[last + 1] - fixes.p[last], axis=1), FASTEST
        dt = fixes.t[last + 1] - fixes.t[last]
    else:
        d = [np.column_stack([np.interp(fixes.t[k], path[0], c) for c in path[1][:, :2].T]) for k in (first, last)]
        moved, dt, limit = np.linalg.norm(d[1] - d[0], axis=1), fixes.t[last] - fixes.t[first], SLOW
    old = (last - first >= OFTEN - 1) & (moved > 5.0 * fixes.sigma[first]) & (moved > limit * dt)
    if old.any():
        rows = np.sort(fixes.rows[_repeats(first[old], last[old], len(fixes.t))])
        reading = Reading(Cause.STALE, "fixes.csv", ", ".join(fixes.columns))
        yield Implausible.of("stale", moved[old].max(), 0.0, "m", reading, lines=rows)


def _stuck(t: Array, y: Array, sigma: float) -> Mask:
    """Many equal rows (n,) of a sensor y (n, d) whose others scatter as stated, and hardly ever are the same."""
    stuck = _held(t, y, MANY)
    others = y[~stuck, 0]
    rough = len(others) > MANY and roughness(others) > sigma / 10.0
    return stuck & bool(rough and len(np.unique(others)) > len(others) / 2)
