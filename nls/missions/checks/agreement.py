r"""Do the sensors of a vehicle agree, DVL with depth and course with heading? If not, how must one of them be read?

Over windows of time the way down by the DVL, turned by the attitude, repeats the depth. No graph compares the two. The
misfit of a log is, relative to the way itself and to the noise,

    m = rms(r - mean r) / rms(dz - mean dz),    r = dz - dD        n = max(sqrt(2) sigma_z / rms dz, FLOOR)

(The mean of r is the error of a pitch.) A log that does not dive beyond its noise says nothing. Where (m / n)^2 is
above `DOUBT`, every reading of the log, with another unit, sign, frame or clock, is tried. Those that bring it below a
`CURED` part, and are not much above the best of them, are named.

A clock that is late by dt looks like a lever arm of v dt. Where that is below `ARM`, which a vehicle may have, no cause
is named.

A vehicle goes ahead most of the time: the directions c of its way, less its headings, have a mean of length

    R = |sum w exp(i (c - yaw))| / sum w

near 1. Where R is not, and one of its columns read otherwise makes it so, that reading is named. From fix to fix the
heading is that of a way at an even speed. A heading counted counterclockwise and a longitude of the other side turn c
against the heading alike, so both are named.

**Clocks**: the times of the tables beside each other, and fixes under water.
The track (B, E) is that of the table with which the others have most time in common. The times of a table (b, e)
beside it are in another unit where (e - b) / (E - B) is a thousand or so. They are late by whole weeks, days or hours
where only that brings them over the track. A sensor that begins some seconds after the others and ends by as much after
them is late by these.

A receiver of satellites has no fix under water. Where fixes are deep at their times, and all at the surface some leap
seconds earlier, or the time by which both b and e are late, their clock is off. Fixes by sound stay deep at any time.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from models.algebra import Array, Mask
from models.dead_reckoning.drop_outs import longest_step
from nls.missions.checks import alone
from nls.missions.checks.findings import Cause, Implausible, Reading
from nls.missions.checks.log import Alternative, Fixes, Log, alternatives, corrected, middle, times_of_poses
from nls.missions.folder.columns import ANGLES, VELOCITY
from nls.missions.folder.table import Table

TRACK = ("dvl", "ahrs", "depth", "pressure", "gyro", "path")
TIMED = (*TRACK, "fixes", "ranges", "usbl", "contacts", "ship")
LEAPS = {18.0: "GPS time and not UTC", 37.0: "TAI and not UTC", 19.0: "TAI and not GPS time"}  # s
PERIODS = {7 * alone.DAY: "week", alone.DAY: "day", 3600.0: "hour", 1800.0: "half-hour"}  # between clocks of two zones
SAME_CLOCK = 3.0  # s by which two clocks may differ
LARGEST = 1e9  # m, as the reader has it
WINDOW = 10.0  # s
FLOOR = 0.04  # relative misfit of a right log: scale, mounting, drop-outs, lever arms
DOUBT, CURED, TIE = 3.5, 1 / 3, 1.6
ARM = 5.0  # m
SCALED = 0.2  # relative misfit that a reading leaves: a right log had 0.16, by a DVL whose mounting is off


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
    if factor := next((f for f in (1e3, 1e6, 1e9, 1e-3, 1 / alone.DAY) if abs(ratio / f - 1) < 0.05), None):
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
    unit, enough = alone.air_in(top), inside.sum() >= few
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


def of_way_down(log: Log) -> list[Implausible]:
    """The errors where DVL, attitude and depth do not fit each other; lines are rows, counted from 0."""
    named, wrong = 0.1, 0.5  # relative misfits from which it is named with a reading, and without one
    windows, noise = _windows(log)
    m = _misfit(log, windows)
    readings = _explained(log, windows, m, noise) if m > named else []
    limit = max(named, float(np.sqrt(DOUBT) * noise))
    if not readings and m > wrong:
        readings, limit = [Reading(Cause.UNKNOWN, "depth.csv", "z_m")], wrong
    return [Implausible.of("way down", m, limit, "of the way", *readings[:3])] if readings else []


def _windows(log: Log) -> tuple[Array, float]:
    """Times of the windows (k, 2), none where the depth does not change; and n."""
    begin, end = (f(log.t_v[k], log.t_z[k], log.t_a[k]) for f, k in ((max, 0), (min, -1)))
    if not 0 < end - begin < np.inf:
        return np.zeros((0, 2)), 1.0
    edges = begin + WINDOW * np.arange(min(int((end - begin) / WINDOW), 20_000) + 1)
    both = np.stack([edges[:-1], edges[1:]], axis=1)
    holes = [(log.t_v, 0.5 * WINDOW), *((t, max(longest_step(t), 1.0)) for t in (log.t_a, log.t_z))]
    for t, longest in holes:  # s without bottom lock, attitude or depth
        both = both[~_over_a_hole(both, t, longest)]
    if len(both) < 4:
        return both[:0], 1.0
    rms, sigma = float(np.std(_ways(both, log.t_z, log.z))), np.sqrt(2) * log.sigmas["sigma_z_m"]
    if rms < max(4.0 * sigma, 0.2):  # m: the vehicle does not dive
        return both[:0], 1.0
    return both, max(sigma / rms, FLOOR)


def _over_a_hole(windows: Array, t: Array, longest: float) -> Mask:
    """Windows (k, 2) with more time than the longest between two of the times t (n,)."""
    holes = np.concatenate([[0], np.cumsum(np.diff(t) > longest), [0]])
    holes[-1] = holes[-2]
    begin = np.searchsorted(t, windows[:, 0], side="right") - 1
    return np.asarray(holes[np.searchsorted(t, windows[:, 1])] > holes[np.maximum(begin, 0)])


def _ways(windows: Array, t: Array, z: Array) -> Array:
    """Ways (k,) down over the windows."""
    return np.asarray(np.diff(np.interp(windows, t, z), axis=1)[:, 0])


def _misfit(log: Log, windows: Array) -> float:
    """m; 0 where there are no windows."""
    if not len(windows):
        return 0.0
    dz = _ways(windows, log.t_z, log.z)
    return float(np.std(dz - _ways(windows, log.t_v, log.way()[:, 2])) / np.std(dz)) if np.std(dz) > 0 else np.inf


def _explained(log: Log, windows: Array, m: float, noise: float) -> list[Reading]:
    """The readings that explain a misfit."""
    S = (m / noise) ** 2
    if not S > DOUBT:
        return []

    def score(a: Alternative) -> float:
        return (_misfit(a.on_log(log), windows) / noise) ** 2

    ways = alternatives()
    clocks = [a for a in ways if a.reading.cause is Cause.CLOCK]
    scored = [(score(a), a.reading) for a in ways if a not in clocks]
    if not any(s <= TIE for s, _ in scored):  # nothing is left for a clock to explain
        scored += [(score(a), a.reading) for a in clocks]
    scored.sort(key=lambda pair: pair[0])
    best = scored[0][0]
    if best > CURED * S or np.sqrt(best) * noise > SCALED:  # the scale of the depth, where that explains it
        dz, dD = _ways(windows, log.t_z, log.z), _ways(windows, log.t_v, log.way()[:, 2])
        slope = float(dz @ dD) / max(float(dD @ dD), 1e-9)
        reading = Reading(Cause.SCALE, "depth.csv", "z_m", slope)
        scaled = 0.5 < slope < 2 and np.sqrt(S) * noise > SCALED and score(corrected(reading)) <= CURED * S
        return [reading] if scaled else []
    near: dict[tuple[str, ...], Reading] = {}
    for s, reading in scored:
        if s <= TIE * max(best, 1.0):
            near.setdefault((reading.cause, reading.file, reading.column), reading)
    arm = ARM / max(float(np.median(np.linalg.norm(log.v, axis=1))), 1e-9)
    first = next(iter(near.values()))
    return [] if first.cause is Cause.CLOCK and abs(first.factor) < arm else [*near.values()]


def of_track(tables: dict[str, Table], fixes: Fixes | None) -> list[Implausible]:
    """Implausible numbers in the tables of a mission without a raw log, and its fixes; lines are rows of the table."""
    out: list[Implausible] = []
    moves = fixes is not None and np.ptp(fixes.p, axis=0).max() > alone.FAR * np.median(fixes.sigma)
    noise = tables.get("noise")
    sigmas = dict(zip(noise.names, noise.floats(*noise.names)[0].tolist(), strict=True)) if noise else {}
    for name in ("path", "zpr", "fixes", "ahrs", "depth"):
        if (table := tables.get(name)) is None:
            continue
        file, t = f"{name}.csv", None
        if table.has("time_s") and name != "fixes":
            t = table.rising("time_s")
            if steps := list(alone.step_of(file, t)):
                return steps
            out += alone.turn_of(file, t, table.floats("yaw_rad")[:, 0]) if table.has("yaw_rad") else ()
        if table.has("z_m"):
            z = table.floats("z_m")[:, 0]
            out += alone.depth_of(file, z, t)
            out += alone.outliers_of(file, ("z_m",), z[:, None], [sigmas.get("sigma_z_m", 0.0)])
        for column in ("roll_rad", "pitch_rad"):
            out += alone.tilt_of(file, column, table.floats(column)[:, 0]) if table.has(column) else ()
        for column in (*ANGLES, "z_m") if name in ("ahrs", "depth") and not out else ():
            y = table.floats(column)[:, 0] if table.has(column) else np.zeros(0)
            y = y[np.abs(y) < LARGEST]
            out += alone.scatter_of(file, column, y, sigmas)
            out += alone.stuck_of(file, column, y) if moves and np.any(y) else ()
    if not out and "path" in tables:
        out += _course(tables["path"])
    if not out and fixes is not None and "ahrs" in tables and tables["ahrs"].has("yaw_rad"):
        out += _between_fixes(fixes, tables["ahrs"])
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


def _between_fixes(fixes: Fixes, ahrs: Table) -> Iterator[Implausible]:
    """The way from fix to fix turns against the heading: one of the two has another sign, or begins at east."""
    t, file, (north, east) = ahrs.rising("time_s"), "fixes.csv", fixes.columns
    ahead = np.exp(1j * ahrs.floats("yaw_rad")[:, 0])
    way = np.append(0.0, np.cumsum((ahead[1:] + ahead[:-1]) / 2 * np.diff(t)))
    inside = np.flatnonzero((fixes.t >= t[0]) & (fixes.t <= t[-1]))
    while len(inside) > alone.FEW_ROWS:
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
        row = fixes.rows[np.argmax(away > farthest)]
        out.append(Implausible.of("far away", distance, farthest, "m", reading, row=row))
    if wild.any() and (share := wild.mean()) > wild_share:
        reading, row = Reading(Cause.OUTLIERS, "fixes.csv", ", ".join(fixes.columns)), fixes.rows[np.argmax(wild)]
        out.append(Implausible.of("jumps", share, wild_share, "of the rows", reading, row=row))
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
    allowed = alone.FAR * fixes.sigma + 0.1 * (np.append(step, 0.0) + np.append(0.0, step))  # a drift of the way
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
    if len(angles) < alone.FEW_ROWS or not weights.sum() > 0:
        return
    ahead, aside, straight = 0.9, 0.8, np.radians(20.0)  # R and middle direction of a vehicle that goes ahead, or not
    r, *rs = (np.average(np.exp(1j * c), weights=weights) for c in (angles, *others.values()))
    near = [k for k, r_k in zip(others, rs, strict=True) if abs(r_k) > ahead and abs(np.angle(r_k)) < straight]
    if near and abs(r) < aside:
        yield Implausible.of("heading", abs(r), ahead, "", *near)


def _steps(odometry: Table, poses: Table | None) -> Iterator[Implausible]:
    """Steps that are faster than a vehicle, where the poses have times."""
    if poses is None:
        return
    dt = np.abs(times_of_poses(poses, odometry, "j") - times_of_poses(poses, odometry))
    if not dt.min() > 0:
        return  # the reader names these
    way = odometry.floats("x_m", "y_m")
    if not np.abs(way).max() < LARGEST:
        return
    speed = np.linalg.norm(way, axis=1) / dt
    if (usual := float(np.median(speed))) > alone.FASTEST:
        units = [f for f in (1000.0, 100.0) if usual / f < alone.FASTEST / 2]
        causes = [Reading(Cause.UNIT, "odometry.csv", "x_m, y_m", f) for f in units]
        causes += [Reading(Cause.UNIT, "poses.csv", "time_s", 1e-3)] * (not causes)
        row = int(np.argmax(speed > alone.FASTEST))
        entry = Implausible.of("speed", usual, alone.FASTEST, "m/s", *causes, row=row)
        yield replace(entry, file="odometry.csv", column="x_m")
