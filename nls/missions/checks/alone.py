"""Checks of one sensor each: from the numbers of a log to findings. None needs another sensor to be right."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from models.algebra import Array, Index, Mask, wrap
from nls.missions.checks.findings import Cause, Implausible, Reading
from nls.missions.checks.log import Log, middle
from nls.missions.checks.readings import DEGREES, SPEED_UNITS
from nls.missions.folder.columns import ANGLES, VELOCITY
from nls.missions.folder.table import Table

__all__ = ["depth_of", "outliers_of", "scatter_of", "sound_speeds", "step_of", "stuck_of", "tilt_of", "turn_of"]
FASTEST = 10.0  # m/s, of a vehicle under water
USUAL = 0.05, 5.0  # m/s
STEEPEST, LONG = np.radians(30.0), 0.2  # rad, and the part of a log that may be beyond
GLIDING = np.radians(60.0)  # rad, of a vehicle that never turns over
FASTEST_TURN = 1.5  # rad/s, exceeded by a tenth of the log
DEEPEST, FASTEST_DIVE = 11_000.0, 2.0  # m, m/s
SLOW_DIVE = 0.14  # m/s, the middle of what vehicles have, 0.01 to 2
DEPTH_UNITS = (100.0, 1e3, 10.0, 1e4)  # cm, mm, kPa and Pa in a meter of water
HIGHEST = -2.0  # m: waves, and a zero that is not the surface
SLOWEST_LOG, FASTEST_LOG = 20.0, 1e-4  # s between rows
SHARE, FAR = 0.015, 10.0  # part of the rows that may be outliers, and sigmas from which one is
CALM = 0.3  # m/s, rad and m: deviations that are no outliers
SIDE_BY_SIDE = 3  # rounds, each of which finds outliers that stood beside others
ROUGH = 8.0  # times the stated sigma
FEW_ROWS = 20
DAY = 86400.0  # s
AIR, WEATHER = 10.1325, 0.06  # dbar at the surface, about m of water, and how much it changes
PRESSURES = (1.0, 10.0, 100.0, 1e4)  # dbar, kPa, hPa and Pa in a dbar
SOUND = 1400.0, 1600.0  # m/s, in fresh water at 0 deg C, and in the Red Sea or the deepest trench
SOUND_UNITS = (3.2808, 1e3, 100.0, 1e-3)  # ft/s, mm/s, cm/s and km/s in a m/s


def _at(check: str, column: str, row: int, measured: float, limit: float, unit: str, *causes: Reading) -> Implausible:
    """A finding; `line` holds the row until the table is known."""
    return Implausible(check, causes[0].file, row, column, float(measured), float(limit), unit, causes)


def speeds(log: Log) -> Iterator[Implausible]:
    """The middle speed is above that of any vehicle: mm/s or cm/s."""
    speed = np.linalg.norm(log.v[log.valid], axis=1)
    if len(speed) and (median := float(np.median(speed))) > FASTEST:
        units = [f for f in SPEED_UNITS if USUAL[0] < median / f < USUAL[1]] or SPEED_UNITS[:1]
        causes = [Reading(Cause.UNIT, "dvl.csv", ", ".join(VELOCITY), f) for f in units]
        row = int(np.flatnonzero(log.valid)[np.argmax(speed > FASTEST)])
        yield _at("speed", VELOCITY[int(np.argmax(np.abs(log.v[row])))], row, median, FASTEST, "m/s", *causes)


def locks(log: Log) -> Iterator[Implausible]:
    """Most rows have no bottom lock, and they are the smooth ones: 0 and 1 are exchanged."""
    if log.valid.mean() < 0.5 and (~log.valid).sum() > FEW_ROWS:
        speed = np.linalg.norm(log.v[~log.valid], axis=1)
        usual = float(np.median(speed))
        if usual > USUAL[0] and np.median(np.abs(np.diff(speed))) < 0.2 * usual:
            row = int(np.argmin(log.valid))
            cause = Reading(Cause.INVERTED, "dvl.csv", "valid")
            yield _at("bottom lock", "valid", row, log.valid.mean(), 0.5, "of the rows", cause)


def tilts(log: Log) -> Iterator[Implausible]:
    """Roll and pitch of ahrs.csv."""
    for k, column in enumerate(("roll_rad", "pitch_rad")):
        yield from tilt_of("ahrs.csv", column, log.rpy[:, k])


def tilt_of(file: str, column: str, angles: Array) -> Iterator[Implausible]:
    """Roll or pitch are beyond 30 degrees for long: degrees in a column of radians, or another frame."""
    size = np.abs(angles)
    limit = STEEPEST if size.max() > np.pi / 2 else GLIDING
    if (steep := size > limit).mean() > LONG:
        upside = abs(float(np.median(size)) - np.pi) < STEEPEST and np.std(size) < STEEPEST
        cause = Reading(Cause.AXES, file, column) if upside else Reading(Cause.UNIT, file, column, DEGREES)
        yield _at("tilt", column, int(np.argmax(steep)), np.quantile(size, 1 - LONG), limit, "rad", cause)


def turns(log: Log) -> Iterator[Implausible]:
    """The heading of ahrs.csv, also one that never changes."""
    yield from turn_of("ahrs.csv", log.t_a, log.rpy[:, 2])
    if np.ptp(log.rpy[:, :2], axis=0).any():  # which stand still with it where a course is made up
        yield from stuck_of("ahrs.csv", "yaw_rad", log.rpy[:, 2])


def turn_of(file: str, t: Array, yaw: Array) -> Iterator[Implausible]:
    """The heading turns faster than a vehicle for long: degrees, or hundredths of one, in a column of radians."""
    if len(t) < FEW_ROWS:
        return
    rate = np.abs(np.diff(np.unwrap(yaw)) / np.diff(t))
    if (fast := float(np.quantile(rate, 0.9))) > FASTEST_TURN:
        cause = Reading(Cause.UNIT, file, "yaw_rad", DEGREES * (100 if np.abs(yaw).max() > 360 else 1))
        yield _at("turn rate", "yaw_rad", int(np.argmax(rate > FASTEST_TURN)) + 1, fast, FASTEST_TURN, "rad/s", cause)


def depths(log: Log) -> Iterator[Implausible]:
    """The depth of depth.csv, also one that never changes."""
    yield from depth_of("depth.csv", log.z, log.t_z)
    if np.ptp(log.thinned().way()[:, 2]) > 1.0:
        yield from stuck_of("depth.csv", "z_m", log.z)


def depth_of(file: str, z: Array, t: Array | None = None) -> Iterator[Implausible]:
    """Depths (n,) above the surface, below any sea, or that change too fast, where their times (n,) are given."""
    smooth = middle(z)
    top = float(smooth.min())
    air = [Reading(Cause.PRESSURE, file, "z_m", unit) for unit in PRESSURES if abs(top / (unit * AIR) - 1) < WEATHER]
    if np.median(z) < HIGHEST and np.mean(smooth < 0) > 0.9:
        cause = Reading(Cause.SIGN, file, "z_m", -1.0)
        yield _at("depth", "z_m", int(np.argmax(z < 0)), np.median(z), 0.0, "m", cause)
    steps = max(1, int(5.0 / float(np.median(np.diff(t))))) if t is not None and len(z) > 1 else len(z)
    rate = np.zeros(1)
    if t is not None and len(z) > 2 * steps:
        rate = np.abs((smooth[steps:] - smooth[:-steps]) / (t[steps:] - t[:-steps]))
    fast = float(np.quantile(rate, 0.99))
    units = sorted(DEPTH_UNITS, key=lambda f: abs(np.log(fast / f / SLOW_DIVE))) if fast else DEPTH_UNITS[1:2]
    causes = air or [Reading(Cause.UNIT, file, "z_m", f) for f in units if np.abs(smooth).max() < f * DEEPEST][:2]
    causes = causes or [Reading(Cause.UNKNOWN, file, "z_m")]
    if np.max(np.abs(smooth)) > DEEPEST:
        yield _at("depth", "z_m", int(np.argmax(np.abs(z) > DEEPEST)), np.abs(smooth).max(), DEEPEST, "m", *causes)
    elif fast > FASTEST_DIVE:
        yield _at("depth rate", "z_m", int(np.argmax(rate > FASTEST_DIVE)), fast, FASTEST_DIVE, "m/s", *causes)


def stuck_of(file: str, column: str, y: Array) -> Iterator[Implausible]:
    """All numbers y (n,) of a column are one, of a vehicle that moves."""
    if len(y) > FEW_ROWS and np.ptp(y) == 0:
        yield _at(
            "stuck", column, 0, float(y[0]), 0.0, "m" if column == "z_m" else "rad", Reading(Cause.STUCK, file, column)
        )


def steps(log: Log) -> Iterator[Implausible]:
    """Times between rows of dvl.csv, ahrs.csv and depth.csv."""
    for file, t in (("dvl.csv", log.t_v), ("ahrs.csv", log.t_a), ("depth.csv", log.t_z)):
        yield from step_of(file, t)


def step_of(file: str, t: Array) -> Iterator[Implausible]:
    """Times between rows that are no seconds."""
    step = float(np.median(np.diff(t))) if len(t) > FEW_ROWS else 1.0
    if step > SLOWEST_LOG:
        factor = next((f for f in (1e3, 1e6, 1e9) if step / f < SLOWEST_LOG), 1e9)
        yield _at("time step", "time_s", 1, step, SLOWEST_LOG, "s", Reading(Cause.UNIT, file, "time_s", factor))
    elif step < FASTEST_LOG:
        days = 1e-3 < step * DAY < SLOWEST_LOG
        cause = Reading(Cause.UNIT, file, "time_s", 1 / DAY) if days else Reading(Cause.UNKNOWN, file, "time_s")
        yield _at("time step", "time_s", 1, step, FASTEST_LOG, "s", cause)


def outliers(log: Log) -> Iterator[Implausible]:
    """Single rows of dvl.csv, ahrs.csv and depth.csv far from their neighbors."""
    rows, of = np.flatnonzero(log.valid), log.sigmas
    yield from outliers_of("dvl.csv", VELOCITY, log.v[rows], [of["sigma_v_m_s"]] * 3, rows)
    yield from outliers_of("ahrs.csv", ANGLES, log.rpy, [of[f"sigma_{name}"] for name in ANGLES])
    yield from outliers_of("depth.csv", ("z_m",), log.z[:, None], [of["sigma_z_m"]])


def outliers_of(
    file: str, columns: Sequence[str], y: Array, sigmas: Sequence[float], rows: Index | None = None
) -> Iterator[Implausible]:
    """Single rows of y (n, k) far from their neighbors, more of them than a sensor has; rows (n,) of the table.

    Where there are so many, those that stand side by side, and lesser ones, are found when the first ones are out.
    """
    if len(y) < FEW_ROWS:
        return
    wild: Mask = np.zeros(y.shape, dtype=bool)
    for limit in (FAR,) * SIDE_BY_SIDE + (FAR / 2,) * SIDE_BY_SIDE:
        for k, (column, sigma) in enumerate(zip(columns, sigmas, strict=True)):
            kept = np.flatnonzero(~wild.any(axis=1))
            away, spread = _deviation(y[kept, k], column.endswith("_rad"))
            wild[kept, k] = away > max(limit * spread, limit * sigma, CALM * (limit / FAR) ** 2)
        if (share := float(wild.mean(axis=0).max())) <= SHARE:
            return
    names = ", ".join(column for k, column in enumerate(columns) if wild[:, k].any())
    at = tuple((np.arange(len(y)) if rows is None else rows)[wild.any(axis=1)].tolist())
    cause = Reading(Cause.OUTLIERS, file, names)
    yield Implausible("outliers", file, at[0], names.split(", ")[0], share, SHARE, "of the rows", (cause,), at)


def _deviation(y: Array, turns: bool) -> tuple[Array, float]:
    """How far each number is from the middle one of itself and its neighbors, and 1.48 times the median of that."""
    both = np.stack([y[1:-1] - y[:-2], y[1:-1] - y[2:]])
    both = wrap(both) if turns else both
    away = np.zeros(len(y))
    away[1:-1] = np.where((both > 0).all(axis=0) | (both < 0).all(axis=0), np.abs(both).min(axis=0), 0.0)
    inner: Mask = away > 0
    return away, 1.4826 * float(np.median(away[inner])) if inner.any() else 0.0


def scatter(log: Log) -> Iterator[Implausible]:
    """Rows of ahrs.csv, depth.csv and dvl.csv scatter far more than noise.csv states."""
    for k, name in enumerate(ANGLES):
        yield from scatter_of("ahrs.csv", name, log.rpy[:, k], log.sigmas)
    yield from scatter_of("depth.csv", "z_m", log.z, log.sigmas)
    yield from scatter_of("dvl.csv", "vx_m_s", log.v[log.valid, 0], log.sigmas, "sigma_v_m_s")


def scatter_of(file: str, column: str, y: Array, sigmas: dict[str, float], sigma: str = "") -> Iterator[Implausible]:
    """The numbers y (n,) of a column scatter far more than the sigma that is stated by its name."""
    sigma = sigma or f"sigma_{column}"
    if len(y) < FEW_ROWS or not sigmas.get(sigma, 0.0) > 0:
        return
    y = np.unwrap(y) if column.endswith("_rad") else y
    third = np.abs(y[3:] - 3 * y[2:-1] + 3 * y[1:-2] - y[:-3])
    measured = 1.4826 * float(np.median(third)) / np.sqrt(20.0)  # 1 + 9 + 9 + 1
    if (ratio := measured / sigmas[sigma]) > ROUGH:
        cause = Reading(Cause.SIGMA, "noise.csv", sigma, ratio)
        yield Implausible("scatter", file, 0, column, measured, ROUGH * sigmas[sigma], "", (cause,))


def sound_speeds(table: Table | None) -> list[Implausible]:
    """Speeds of sound that water does not have."""
    if table is None:
        return []
    c = table.floats("sound_speed_m_s")[:, 0]
    if not (out := (c < SOUND[0]) | (c > SOUND[1])).any():
        return []
    row = int(np.argmax(out))
    low, high = SOUND
    factor = next((f for f in SOUND_UNITS if low < c[row] / f < high), None)
    file, column = "sound-speed.csv", "sound_speed_m_s"
    cause = Reading(Cause.UNIT, file, column, factor) if factor else Reading(Cause.UNKNOWN, file, column)
    return [_at("sound speed", column, row, c[row], low if c[row] < low else high, "m/s", cause)]


ALONE = (steps, speeds, locks, tilts, turns, depths, outliers, scatter)
