"""Which pose a row is of: rows have a pose, ``i``, or a time, ``time_s``, which is late by ``delay_s`` and by a clock.

    t = time_s - delay_s - clock

A raw log without poses.csv gets a pose at every such time (`united`); elsewhere a time must be that of a pose. Times
closer than `SAME_TIME` are one.

**Clocks** of fixes, ranges and directions that are late by an unknown time: a variable of calibration.csv.
A row measured c before its time belongs to the pose at t - c. The pose of the row is that at t_0 = t - c_0, with c_0 of
calibration.csv, so to first order in c - c_0

    h(X(t - c)) = h(X(t_0)) + G (c - c_0),   G = -dh/dt = -sum H_k xi_k

with the twist xi of the vehicle by dead reckoning, that of the ship by ship.csv. With z + G c_0 instead of z this is a
`factors.Shifted`.
"""

import numpy as np

from factors.base import Factor
from factors.keys import kinds
from models import SE3
from models.algebra import Array, Mask, Numbers, apply
from models.errors import GraphFileError
from nls.missions.folder.calibration import NAMES as CALIBRATIONS
from nls.missions.folder.calibration import Calibrations
from nls.missions.folder.folder import MissionReport
from nls.missions.folder.rows import Assembly, Times
from nls.missions.folder.table import Table
from nls.values import Values

SAME_TIME = 1e-3  # s: 2 mm at 2 m/s
TIMED = ("fixes", "ranges", "usbl", "closures", "contacts")
CLOCKED = ("fixes", "ranges", "usbl")
x, s = kinds("x", "s")


def measured_times(tables: dict[str, Table], calibrations: Calibrations) -> Times:
    """The times of files whose rows have times, less delay and clock.

    Raises
    ------
    GraphFileError
        Times and poses both, or neither; a delay of a row that is of a pose.
    """
    times: Times = {}
    for name, table in ((name, tables[name]) for name in TIMED if name in tables):
        timed, numbered = (("time_i_s", "time_j_s"), ("i", "j")) if name == "closures" else (("time_s",), ("i",))
        if not one_of(table, timed, numbered):
            if table.has("delay_s"):
                raise table.at_names("has delay_s and no time_s: the pose i gives the time; leave delay_s out")
            continue
        t = table.measured(*timed)
        if table.has("delay_s"):
            t = t - table.measured("delay_s")
        if (clock := f"{name}_clock_s") in CALIBRATIONS:
            calibrations.variable(clock)  # which counts it as used
            t = t - calibrations.value(clock)
        times[name] = t
    return times


def one_of(table: Table, columns: tuple[str, ...], others: tuple[str, ...]) -> bool:
    """Whether a file has the first of two alternatives.

    Raises
    ------
    GraphFileError
        It has both, a part of one, or none.
    """
    some = [[name for name in names if table.has(name)] for names in (columns, others)]
    if all(some) or not any(some):
        both = f"has {some[0][0]} and {some[1][0]}" if all(some) else "has neither"
        raise table.at_names(f"{both}; expected either {' and '.join(columns)} or {' and '.join(others)}")
    whole = columns if some[0] else others
    if missing := [name for name in whole if not table.has(name)]:
        raise table.at_names(f"no column {missing[0]!r}; expected either {' and '.join(whole)} or none of these")
    return bool(some[0])


def united(b: Array, end: float, times: Times, tables: dict[str, Table]) -> Array:
    """The times of the poses (n,) of a raw log: those on the grid b, and those of rows from its begin to the end.

    Raises
    ------
    GraphFileError
        Times beside a file that names poses by number: numbers would shift.
    """
    if not times:
        return b
    for name in ("anchor", "truth", *TIMED):  # files that may name poses
        if (table := tables.get(name)) is not None and table.has("i"):
            cure = "write poses.csv, with i and time_s of every pose"
            raise table.at_names(f"names poses by i, but the times of {next(iter(times))}.csv add poses; {cure}")
    t = np.sort(np.concatenate([b, *(rows.ravel() for rows in times.values())]))
    t = t[(t >= b[0]) & (t <= end)]
    close = np.flatnonzero(np.diff(t) < SAME_TIME)
    keep, last = np.ones(len(t), dtype=bool), -1
    for k in close.tolist():  # t[k + 1] is close to t[k]; to the last one that is kept?
        last = k if keep[k] else last
        keep[k + 1] = t[k + 1] - t[last] >= SAME_TIME
    return np.asarray(t[keep])


def poses_of_log(
    tables: dict[str, Table], times: Times, logs: dict[str, Array], locked: Array, notes: list[str]
) -> tuple[Numbers, Array]:
    """Numbers and times (n,) of the poses, rising in time: those of poses.csv, or one a second while all logs run and
    one at each of the times of other files.

    The log of the DVL runs from its first to its last time with bottom lock: nothing is extrapolated.

    Parameters
    ----------
    tables, times : of the mission, see `measured_times`.
    logs : times of the rows by the names of their files.
    locked : times of the DVL with bottom lock.
    notes : get one where that is not all of the DVL's.

    Raises
    ------
    GraphFileError
        Logs that have less than a second in common, or more than a graph holds; a pose that is not within all logs.
    """
    t_v = logs["dvl.csv"]
    late, early = float(locked[0] - t_v[0]), float(t_v[-1] - locked[-1])
    if late or early:
        logs = {"dvl.csv with bottom lock": locked} | {name: t for name, t in logs.items() if name != "dvl.csv"}
    begin, end = max(t[0] for t in logs.values()), min(t[-1] for t in logs.values())
    ranges = ", ".join(f"{name} {float(t[0])!r} to {float(t[-1])!r} s" for name, t in logs.items())
    if (table := tables.get("poses")) is None:
        if end - begin > 10_000_000:  # s: four months, or times that are no seconds
            rest = f"a second too many for a graph: {ranges}; are these seconds? poses.csv says when there are poses"
            raise GraphFileError(f"the logs last {end - begin:.6g} s, with a pose {rest}", tables["dvl"].path)
        b = begin + np.arange(max(0, int(end - begin) + 2))
        b = b[b <= end]  # 12.46 + 68.0 is more than 80.46 by a rounding
        if len(b) < 2:
            raise GraphFileError(f"the logs have less than a second in common: {ranges}", tables["dvl"].path)
        if late or early:
            notes.append(f"the DVL has no bottom lock in its first {late:.6g} s and its last {early:.6g} s: left out")
        b = united(b, end, times, tables)
        return np.arange(len(b)), b
    numbers, b = table.unique("i", "pose"), table.rising("time_s")
    out = (b < begin) | (b > end)
    table.refuse_rows(out, lambda k: f"pose {numbers[k]} is at {float(b[k])!r} s, not within all logs: {ranges}")
    if len(b) < 2:
        raise table.at(0, "one pose; a track has at least two")
    return numbers, b


def poses_of_rows(t: Array, b: Array) -> Array:
    """Root of how many poses (n,) at times b there are for a row of a log at rising times t, 1 or more.

    Poses between rows are interpolated, and each counts as a measurement of its own. Where they are denser than the
    rows, counted over five of these, their sigmas grow by this. Together they say no more than the rows do.
    """
    reach = 2.5 * float(np.median(np.diff(t))) if len(t) > 1 else np.inf
    rows, poses = (
        np.searchsorted(times, b + reach, side="right") - np.searchsorted(times, b - reach) for times in (t, np.sort(b))
    )
    return np.asarray(np.sqrt(np.maximum(1.0, poses / np.maximum(rows, 1))))


class Timeline:
    """The poses of a mission and their times.

    Parameters
    ----------
    mission : whose report has the times of the poses, where a file says them, and gets notes on rows left out.
    numbers : (n,) of the poses, rising.

    Attributes
    ----------
    times : (n,) of the poses, s, in the order of their numbers; None where no file says them.
    """

    def __init__(self, mission: Assembly, numbers: Numbers) -> None:
        self._mission, self.numbers = mission, numbers
        self.times = mission.report.vertex_times.get("x")

    def poses(self, name: str, table: Table) -> tuple[Numbers, Mask]:
        """Poses (n, 1 or 2) of the rows of a file, and which rows (n,) have some; the others are left out.

        Rows outside the track are left out of a raw log without poses.csv, and elsewhere refused.

        Raises
        ------
        GraphFileError
            No such pose; no pose at that time; no row within the track.
        """
        if name not in self._mission.times:
            columns = ("i", "j") if name == "closures" else ("i",)
            problem = "no such pose in the track"
            numbers = np.stack([table.known(column, self.numbers, problem) for column in columns], axis=1)
            return numbers, np.ones(len(table), dtype=bool)
        if self.times is None:
            raise table.at_names("has times, but no pose has one; add poses.csv, with i and time_s of every pose")
        t, order, tables = self._mission.times[name], np.argsort(self.times), self._mission.tables
        rising, numbers = self.times[order], self.numbers[order]
        nearest = _nearest(rising, t)
        far = np.abs(rising[nearest] - t) >= SAME_TIME
        if (away := np.any(far, axis=1)).any():
            k = int(np.argmax(away))
            time = round(float(t[k][far[k]][0]), 6)
            if {"odometry", "poses"} & tables.keys():
                near = int(_nearest(rising, np.array([time]))[0])
                cure = "Add a pose at this time to poses.csv"
                cure += "" if "odometry" in tables else ", or leave poses.csv out"
                pose = f"the nearest is pose {numbers[near]} at {float(rising[near])!r} s"
                raise table.at(k, f"no pose is at {time!r} s; {pose}. {cure}")
            span = f"the track, {float(rising[0])!r} to {float(rising[-1])!r} s"
            leave_out(table, away, bool(away.all()), time, span, self._mission.report)
        return numbers[nearest], ~away

    def at(self, numbers: Numbers) -> Array:
        """Times (n,) of poses, s; a GraphFileError where there are none."""
        if self.times is None:
            problem = "no pose has a time; add poses.csv, with i and time_s of every pose"
            raise GraphFileError(problem, self._mission.report.path)
        return self.times[np.searchsorted(self.numbers, numbers)]


def leave_out(table: Table, away: Mask, no_other: bool, time: float, span: str, report: MissionReport) -> None:
    """Say that rows (n,) away from a span of time are left out, the first of them at a time, s.

    Raises
    ------
    GraphFileError
        There is no other row.
    """
    k = int(np.argmax(away))
    if no_other:
        raise table.at(k, f"is at {time!r} s, and no row is within {span}; do the clocks agree?")
    count = f"the first row of {int(away.sum())} that are left out, of {len(table)}"
    report.notes.append(f"{table.place(k)}: {count}: not within {span}")


def _nearest(rising: Array, t: Array) -> Numbers:
    """The places of the nearest of rising times."""
    after = np.clip(np.searchsorted(rising, t), 1, max(len(rising) - 1, 1))
    return np.where(t - rising[after - 1] <= rising[np.minimum(after, len(rising) - 1)] - t, after - 1, after)


# --- clocks -----------------------------------------------------------------------------------------------------------


def shift_clocks(mission: Assembly, timeline: Timeline, start: Values, ship: Array) -> None:
    """Put the factors of every file whose clock is a variable under a `Shifted` of that variable, each in its place.

    Parameters
    ----------
    mission, timeline : whose factors are replaced.
    start : poses whose track gives the rates.
    ship : (k, 6) twists of the ship at its poses, in its own axes.
    """
    moving = {s.name: ship}
    for name in CLOCKED:
        clock = f"{name}_clock_s"
        if name not in mission.times or mission.calibrations.variable(clock) is None:
            continue
        if x.name not in moving:
            moving[x.name] = twists(start[x], timeline.at(start.stack(x).numbers))
        factors = mission.graph.factors
        for k in mission.of_table(name):
            G = -total(rates_by_time(factors[k], start, moving))
            factors[k] = mission.calibrations.shifted(factors[k], clock, G)


def rates_by_time(factor: Factor, values: Values, moving: dict[str, Array]) -> dict[str, Array]:
    """Rates dh/dt (n, m) of measurements, from each kind that moves with twists (k, 6)."""
    model, X = values.gather(factor)
    H = factor.predict(model.manifolds, *X)[1]
    assert H is not None
    return {
        keys.kind: apply(np.asarray(block), moving[keys.kind][values.stack(keys.kind).index(keys)])
        for keys, block in zip(factor.keys, H, strict=True)
        if keys.kind in moving
    }


def total(rates: dict[str, Array]) -> Array:
    """Rates (n, m) of measurements from all kinds."""
    return np.asarray(np.sum(list(rates.values()), axis=0))


def twists(X: Array, t: Array) -> Array:
    """Body twists (n, 6) of poses (n, 7) at times (n,), m/s and rad/s: over the legs before and after."""
    times, first, of = np.unique(t, return_index=True, return_inverse=True)
    if len(times) == 1:
        return np.zeros((len(t), SE3.dim))
    X, dt = X[first], np.diff(times)
    step = SE3.local(X[:-1], X[1:])
    zero = np.zeros((1, SE3.dim))
    both = np.concatenate([step, zero]) + np.concatenate([zero, step])
    return np.asarray((both / (np.append(dt, 0.0) + np.append(0.0, dt))[:, None])[of])
