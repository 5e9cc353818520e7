"""Checks of one sensor each: from the numbers of a log to findings. None needs another sensor to be right."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from models.algebra import Array, Index, Mask, wrap
from nls.missions.checks.findings import Cause, Implausible, Reading
from nls.missions.checks.log import DEGREES, SPEED_UNITS, Log, middle
from nls.missions.folder.columns import ANGLES, VELOCITY
from nls.missions.folder.table import Table

FASTEST = 10.0  # m/s, of a vehicle under water
USUAL_SPEED = 0.05, 5.0  # m/s
STEEPEST = np.radians(30.0)  # of a log, but for a fifth of it
FEW_ROWS = 20
FAR = 10.0  # sigmas from which a row is an outlier
ROBUST = 1.4826  # standard deviation of normal numbers, over the median of their sizes
DAY = 86400.0  # s


def alone(log: Log) -> Iterator[Implausible]:
    """All checks of the sensors of a raw log."""
    for file, t in (("dvl.csv", log.t_v), ("ahrs.csv", log.t_a), ("depth.csv", log.t_z)):
        yield from step_of(file, t)
    yield from _speeds(log)
    yield from _locks(log)
    yield from attitude_of("ahrs.csv", log.t_a, log.rpy)
    yield from depth_of("depth.csv", log.z, log.t_z)
    if np.ptp(log.thinned().way()[:, 2]) > 1.0:
        yield from stuck_of("depth.csv", "z_m", log.z)
    rows, of = np.flatnonzero(log.valid), log.sigmas
    yield from outliers_of("dvl.csv", VELOCITY, log.v[rows], [of["sigma_v_m_s"]] * 3, rows)
    yield from outliers_of("ahrs.csv", ANGLES, log.rpy, [of[f"sigma_{name}"] for name in ANGLES])
    yield from outliers_of("depth.csv", ("z_m",), log.z[:, None], [of["sigma_z_m"]])
    for k, name in enumerate(ANGLES):
        yield from scatter_of("ahrs.csv", name, log.rpy[:, k], of)
    yield from scatter_of("depth.csv", "z_m", log.z, of)
    yield from scatter_of("dvl.csv", "vx_m_s", log.v[rows, 0], of, "sigma_v_m_s")


def attitude_of(file: str, t: Array, rpy: Array) -> Iterator[Implausible]:
    """Roll and pitch, turns, and a heading that never changes, of angles (n, 3) at times (n,)."""
    for k, column in enumerate(ANGLES[:2]):
        yield from tilt_of(file, column, rpy[:, k])
    yield from turn_of(file, t, rpy[:, 2])
    if np.ptp(rpy[:, :2], axis=0).any():  # which stand still with it where a course is made up
        yield from stuck_of(file, "yaw_rad", rpy[:, 2])


def _speeds(log: Log) -> Iterator[Implausible]:
    """The middle speed is above that of any vehicle: mm/s or cm/s."""
    speed = np.linalg.norm(log.v[log.valid], axis=1)
    if len(speed) and (median := float(np.median(speed))) > FASTEST:
        units = [f for f in SPEED_UNITS if USUAL_SPEED[0] < median / f < USUAL_SPEED[1]] or SPEED_UNITS[:1]
        causes = [Reading(Cause.UNIT, "dvl.csv", ", ".join(VELOCITY), f) for f in units]
        row = int(np.flatnonzero(log.valid)[np.argmax(speed > FASTEST)])
        column = VELOCITY[int(np.argmax(np.abs(log.v[row])))]
        yield replace(Implausible.of("speed", median, FASTEST, "m/s", *causes, row=row), column=column)


def _locks(log: Log) -> Iterator[Implausible]:
    """Most rows have no bottom lock, and they are the smooth ones: 0 and 1 are exchanged."""
    if log.valid.mean() < 0.5 and (~log.valid).sum() > FEW_ROWS:
        speed = np.linalg.norm(log.v[~log.valid], axis=1)
        usual = float(np.median(speed))
        if usual > USUAL_SPEED[0] and np.median(np.abs(np.diff(speed))) < 0.2 * usual:
            cause = Reading(Cause.INVERTED, "dvl.csv", "valid")
            yield Implausible.of("bottom lock", log.valid.mean(), 0.5, "of the rows", cause, row=np.argmin(log.valid))


def tilt_of(file: str, column: str, angles: Array) -> Iterator[Implausible]:
    """Roll or pitch are beyond 30 degrees for long: degrees in a column of radians, or another frame.

    A vehicle that never turns over may glide at up to 60 degrees.
    """
    size, part = np.abs(angles), 0.2
    limit = STEEPEST if size.max() > np.pi / 2 else 2 * STEEPEST
    if (steep := size > limit).mean() > part:
        upside = abs(float(np.median(size)) - np.pi) < STEEPEST and np.std(size) < STEEPEST
        cause = Reading(Cause.AXES, file, column) if upside else Reading(Cause.UNIT, file, column, DEGREES)
        yield Implausible.of("tilt", float(np.quantile(size, 1 - part)), limit, "rad", cause, row=np.argmax(steep))


def turn_of(file: str, t: Array, yaw: Array, fastest: float = 1.5) -> Iterator[Implausible]:
    """A tenth of the headings turns faster, rad/s, than a vehicle: degrees in a column of radians, or hundredths."""
    if len(t) < FEW_ROWS:
        return
    rate = np.abs(np.diff(np.unwrap(yaw)) / np.diff(t))
    if (fast := float(np.quantile(rate, 0.9))) > fastest:
        cause = Reading(Cause.UNIT, file, "yaw_rad", DEGREES * (100 if np.abs(yaw).max() > 360 else 1))
        yield Implausible.of("turn rate", fast, fastest, "rad/s", cause, row=np.argmax(rate > fastest) + 1)


def air_in(top: float) -> float | None:
    """The unit, in a decibar, of a shallowest depth that is the pressure of the air; None where it is none."""
    air, weather = 10.1325, 0.06  # dbar at the surface, about m of water, and how much it changes
    units = (1.0, 10.0, 100.0, 1e4)  # dbar, kPa, hPa and Pa in a dbar
    return next((unit for unit in units if abs(top / (unit * air) - 1) < weather), None)


def depth_of(file: str, z: Array, t: Array | None = None) -> Iterator[Implausible]:
    """Depths (n,) above the surface, below any sea, or that change too fast, where their times (n,) are given."""
    deepest, fastest = 11_000.0, 2.0  # m, m/s
    smooth = middle(z)
    air = air_in(float(smooth.min()))
    if np.median(z) < -2.0 and np.mean(smooth < 0) > 0.9:  # beyond waves, and a zero that is not the surface
        cause = Reading(Cause.SIGN, file, "z_m", -1.0)
        yield Implausible.of("depth", float(np.median(z)), 0.0, "m", cause, row=np.argmax(z < 0))
    steps = max(1, int(5.0 / float(np.median(np.diff(t))))) if t is not None and len(z) > 1 else len(z)
    rate = np.zeros(1)
    if t is not None and len(z) > 2 * steps:
        rate = np.abs((smooth[steps:] - smooth[:-steps]) / (t[steps:] - t[:-steps]))
    fast = float(np.quantile(rate, 0.99))
    units = [100.0, 1e3, 10.0, 1e4]  # cm, mm, kPa and Pa in a meter of water; vehicles dive at 0.01 to 2 m/s
    units = sorted(units, key=lambda f: abs(np.log(fast / f / 0.14))) if fast else units[1:2]
    causes = [Reading(Cause.UNIT, file, "z_m", f) for f in units if np.abs(smooth).max() < f * deepest][:2]
    causes = causes or [Reading(Cause.UNKNOWN, file, "z_m")]
    causes = [Reading(Cause.PRESSURE, file, "z_m", air)] if air else causes
    if np.max(np.abs(smooth)) > deepest:
        size, row = np.abs(smooth).max(), np.argmax(np.abs(z) > deepest)
        yield Implausible.of("depth", size, deepest, "m", *causes, row=row)
    elif fast > fastest:
        yield Implausible.of("depth rate", fast, fastest, "m/s", *causes, row=np.argmax(rate > fastest))


def stuck_of(file: str, column: str, y: Array) -> Iterator[Implausible]:
    """All numbers y (n,) of a column are one, of a vehicle that moves."""
    if len(y) > FEW_ROWS and np.ptp(y) == 0:
        unit = "m" if column == "z_m" else "rad"
        yield Implausible.of("stuck", y[0], 0.0, unit, Reading(Cause.STUCK, file, column))


def step_of(file: str, t: Array) -> Iterator[Implausible]:
    """Times between rows that are no seconds."""
    slowest, fastest = 20.0, 1e-4  # s between rows
    step = float(np.median(np.diff(t))) if len(t) > FEW_ROWS else 1.0
    if step > slowest:
        factor = next((f for f in (1e3, 1e6, 1e9) if step / f < slowest), 1e9)
        yield Implausible.of("time step", step, slowest, "s", Reading(Cause.UNIT, file, "time_s", factor), row=1)
    elif step < fastest:
        days = 1e-3 < step * DAY < slowest
        cause = Reading(Cause.UNIT, file, "time_s", 1 / DAY) if days else Reading(Cause.UNKNOWN, file, "time_s")
        yield Implausible.of("time step", step, fastest, "s", cause, row=1)


def outliers_of(
    file: str, columns: Sequence[str], y: Array, sigmas: Sequence[float], rows: Index | None = None
) -> Iterator[Implausible]:
    """Single rows of y (n, k) far from their neighbors, more of them than a sensor has; rows (n,) of the table.

    Where there are so many, those that stand side by side, and lesser ones, are found when the first ones are out.
    """
    if len(y) < FEW_ROWS:
        return
    wild: Mask = np.zeros(y.shape, dtype=bool)
    for limit in (FAR, FAR, FAR, FAR / 2, FAR / 2, FAR / 2):
        calm = 0.3 * (limit / FAR) ** 2  # m/s, rad and m: deviations that are no outliers
        for k, (column, sigma) in enumerate(zip(columns, sigmas, strict=True)):
            kept = np.flatnonzero(~wild.any(axis=1))
            away, spread = _deviation(y[kept, k], column.endswith("_rad"))
            wild[kept, k] = away > max(limit * spread, limit * sigma, calm)
        if (share := float(wild.mean(axis=0).max())) <= (most := 0.015):
            return
    names = ", ".join(column for k, column in enumerate(columns) if wild[:, k].any())
    at = (np.arange(len(y)) if rows is None else rows)[wild.any(axis=1)]
    yield Implausible.of("outliers", share, most, "of the rows", Reading(Cause.OUTLIERS, file, names), lines=at)


def _deviation(y: Array, turns: bool) -> tuple[Array, float]:
    """How far each number is from the median of itself and its neighbors, and the standard deviation of that."""
    both = np.stack([y[1:-1] - y[:-2], y[1:-1] - y[2:]])
    both = wrap(both) if turns else both
    away = np.zeros(len(y))
    away[1:-1] = np.where((both > 0).all(axis=0) | (both < 0).all(axis=0), np.abs(both).min(axis=0), 0.0)
    inner: Mask = away > 0
    return away, ROBUST * float(np.median(away[inner])) if inner.any() else 0.0


def roughness(y: Array) -> float:
    """Standard deviation of the noise of numbers y (n,), from third differences: 1 + 9 + 9 + 1 times its square."""
    third = np.abs(y[3:] - 3 * y[2:-1] + 3 * y[1:-2] - y[:-3])
    return float(ROBUST * float(np.median(third)) / np.sqrt(20.0))


def scatter_of(file: str, column: str, y: Array, sigmas: dict[str, float], sigma: str = "") -> Iterator[Implausible]:
    """The numbers y (n,) of a column scatter by 8 times the sigma that is stated by its name, and more."""
    sigma, rough = sigma or f"sigma_{column}", 8.0
    if len(y) < FEW_ROWS or not sigmas.get(sigma, 0.0) > 0:
        return
    measured = roughness(np.unwrap(y) if column.endswith("_rad") else y)
    if (ratio := measured / sigmas[sigma]) > rough:
        cause = Reading(Cause.SIGMA, "noise.csv", sigma, ratio)
        yield Implausible("scatter", file, 0, column, measured, rough * sigmas[sigma], "", (cause,))


def sound_speeds(table: Table) -> Iterator[Implausible]:
    """Speeds of sound that water does not have."""
    low, high = 1400.0, 1600.0  # m/s, in fresh water at 0 deg C, and in the Red Sea or the deepest trench
    c = table.floats("sound_speed_m_s")[:, 0]
    if (out := (c < low) | (c > high)).any():
        row = int(np.argmax(out))
        units = (3.2808, 1e3, 100.0, 1e-3)  # ft/s, mm/s, cm/s and km/s in a m/s
        factor = next((f for f in units if low < c[row] / f < high), None)
        cause = (Cause.UNKNOWN, 1.0) if factor is None else (Cause.UNIT, factor)
        reading = Reading(cause[0], "sound-speed.csv", "sound_speed_m_s", cause[1])
        yield Implausible.of("sound speed", c[row], low if c[row] < low else high, "m/s", reading, row=row)
