"""Checks of one sensor each: from the numbers of a log to findings. None needs another sensor to be right."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from models.algebra import Array, Mask
from nls.io.mission.checks.findings import Cause, Implausible, Reading
from nls.io.mission.checks.log import Log, middle
from nls.io.mission.checks.readings import DEGREES, SPEED_UNITS

__all__ = ["ALONE"]
FASTEST = 10.0  # m/s, of a vehicle under water
USUAL = 0.05, 5.0  # m/s
STEEPEST, LONG = np.radians(30.0), 0.2  # rad, and the part of a log that may be beyond
FASTEST_TURN = 1.5  # rad/s, exceeded by a tenth of the log
DEEPEST, FASTEST_DIVE = 11_000.0, 3.0  # m, m/s
HIGHEST = -2.0  # m: waves, and a zero that is not the surface
SLOWEST_LOG, FASTEST_LOG = 20.0, 1e-4  # s between rows
SHARE, FAR = 0.015, 10.0  # part of the rows that may be outliers, and sigmas from which one is
CALM = 0.3  # m/s and m: deviations that are no outliers
ROUGH = 8.0  # times the stated sigma
FEW_ROWS = 20


def _at(check: str, column: str, row: int, measured: float, limit: float, unit: str, *causes: Reading) -> Implausible:
    """A finding; `line` holds the row until the table is known."""
    return Implausible(check, causes[0].file, row, column, float(measured), float(limit), unit, causes)


def speeds(log: Log) -> Iterator[Implausible]:
    """The middle speed is above that of any vehicle: mm/s or cm/s."""
    speed = np.linalg.norm(log.v[log.valid], axis=1)
    if len(speed) and (median := float(np.median(speed))) > FASTEST:
        units = [f for f in SPEED_UNITS if USUAL[0] < median / f < USUAL[1]] or SPEED_UNITS[:1]
        names = ("vx_m_s", "vy_m_s", "vz_m_s")
        causes = [Reading(Cause.UNIT, "dvl.csv", ", ".join(names), f) for f in units]
        row = int(np.flatnonzero(log.valid)[np.argmax(speed > FASTEST)])
        yield _at("speed", names[int(np.argmax(np.abs(log.v[row])))], row, median, FASTEST, "m/s", *causes)


def zeros(log: Log) -> Iterator[Implausible]:
    """Rows of zeros that count as valid, between rows of a vehicle that moves."""
    speed = np.linalg.norm(log.v, axis=1)
    zero = (speed == 0) & log.valid
    moving = np.flatnonzero(~zero & log.valid)
    if not zero.any() or len(moving) < FEW_ROWS:
        return
    usual = float(np.median(speed[moving]))
    rows = np.flatnonzero(zero)
    after = np.searchsorted(moving, rows)
    inside = rows[(after > 0) & (after < len(moving))]
    after = np.searchsorted(moving, inside)
    inside = inside[np.minimum(speed[moving[after - 1]], speed[moving[after]]) > usual / 2]
    if len(inside) and usual > USUAL[0]:
        cause = Reading(Cause.ZEROS, "dvl.csv", "valid")
        yield _at("zeros", "valid", int(inside[0]), len(inside), 0, "rows", cause)


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
    """Roll or pitch are beyond 30 degrees for long: degrees in a column of radians, or another frame."""
    for k, column in enumerate(("roll_rad", "pitch_rad")):
        steep = np.abs(log.rpy[:, k]) > STEEPEST
        if steep.mean() > LONG:
            median = float(np.median(np.abs(log.rpy[:, k])))
            degrees = Reading(Cause.UNIT, "ahrs.csv", column, DEGREES)
            axes = Reading(Cause.AXES, "ahrs.csv", column)
            upside = abs(median - np.pi) < STEEPEST and np.std(np.abs(log.rpy[:, k])) < STEEPEST
            size = float(np.quantile(np.abs(log.rpy[:, k]), 1 - LONG))
            yield _at("tilt", column, int(np.argmax(steep)), size, STEEPEST, "rad", axes if upside else degrees)


def turns(log: Log) -> Iterator[Implausible]:
    """The heading turns faster than a vehicle for long: degrees in a column of radians."""
    if len(log.t_a) < FEW_ROWS:
        return
    rate = np.abs(np.diff(np.unwrap(log.rpy[:, 2])) / np.diff(log.t_a))
    if (fast := float(np.quantile(rate, 0.9))) > FASTEST_TURN:
        cause = Reading(Cause.UNIT, "ahrs.csv", "yaw_rad", DEGREES)
        yield _at("turn rate", "yaw_rad", int(np.argmax(rate > FASTEST_TURN)) + 1, fast, FASTEST_TURN, "rad/s", cause)


def depths(log: Log) -> Iterator[Implausible]:
    """Depths above the surface, below any sea, that change too fast, or never."""
    z, smooth = log.z, middle(log.z)
    if np.median(z) < HIGHEST and np.mean(smooth < 0) > 0.9:
        cause = Reading(Cause.SIGN, "depth.csv", "z_m", -1.0)
        yield _at("depth", "z_m", int(np.argmax(z < 0)), np.median(z), 0.0, "m", cause)
    if np.max(np.abs(smooth)) > DEEPEST:
        causes = [Reading(Cause.UNIT, "depth.csv", "z_m", f) for f in (1e4, 1e3, 100.0)]  # Pa, mm, cm
        yield _at("depth", "z_m", int(np.argmax(np.abs(z) > DEEPEST)), np.abs(smooth).max(), DEEPEST, "m", *causes)
    steps = max(1, int(5.0 / float(np.median(np.diff(log.t_z))))) if len(z) > 1 else len(z)
    if len(z) > 2 * steps:
        rate = np.abs((smooth[steps:] - smooth[:-steps]) / (log.t_z[steps:] - log.t_z[:-steps]))
        if (fast := float(np.quantile(rate, 0.99))) > FASTEST_DIVE:
            causes = [Reading(Cause.UNIT, "depth.csv", "z_m", f) for f in (100.0, 1000.0)]
            yield _at("depth rate", "z_m", int(np.argmax(rate > FASTEST_DIVE)), fast, FASTEST_DIVE, "m/s", *causes)
    if len(z) > FEW_ROWS and np.ptp(z) == 0 and np.ptp(log.thinned().way()[:, 2]) > 1.0:
        yield _at("depth", "z_m", 0, 0.0, 1.0, "m", Reading(Cause.STUCK, "depth.csv", "z_m"))


def steps(log: Log) -> Iterator[Implausible]:
    """Times between rows that are no seconds."""
    for file, t in (("dvl.csv", log.t_v), ("ahrs.csv", log.t_a), ("depth.csv", log.t_z)):
        step = float(np.median(np.diff(t))) if len(t) > FEW_ROWS else 1.0
        if step > SLOWEST_LOG:
            factor = next((f for f in (1e3, 1e6, 1e9) if step / f < SLOWEST_LOG), 1e9)
            yield _at("time step", "time_s", 1, step, SLOWEST_LOG, "s", Reading(Cause.UNIT, file, "time_s", factor))
        elif step < FASTEST_LOG:
            yield _at("time step", "time_s", 1, step, FASTEST_LOG, "s", Reading(Cause.UNKNOWN, file, "time_s"))


def outliers(log: Log) -> Iterator[Implausible]:
    """Single rows far from their neighbors, more of them than a sensor has."""
    rows = np.flatnonzero(log.valid)
    series = [
        ("dvl.csv", name, log.v[rows, k], rows, log.sigmas["sigma_v_m_s"])
        for k, name in enumerate(("vx_m_s", "vy_m_s", "vz_m_s"))
    ]
    series.append(("depth.csv", "z_m", log.z, np.arange(len(log.z)), log.sigmas["sigma_z_m"]))
    for file, column, y, places, sigma in series:
        if len(y) < FEW_ROWS:
            continue
        away, spread = _deviation(y)
        wild = away > max(FAR * spread, FAR * sigma, CALM)
        if wild.mean() > SHARE:
            cause = Reading(Cause.OUTLIERS, file, column)
            yield _at("outliers", column, int(places[np.argmax(wild)]), wild.mean(), SHARE, "of the rows", cause)


def _deviation(y: Array) -> tuple[Array, float]:
    """How far each number is from the middle one of itself and its neighbors, and 1.48 times the median of that."""
    away = np.abs(y - middle(y))
    inner: Mask = away > 0
    return away, 1.4826 * float(np.median(away[inner])) if inner.any() else 0.0


def scatter(log: Log) -> Iterator[Implausible]:
    """Rows scatter far more than the noise that noise.csv states."""
    for file, column, sigma, y in (
        ("ahrs.csv", "roll_rad", "sigma_roll_rad", log.rpy[:, 0]),
        ("ahrs.csv", "pitch_rad", "sigma_pitch_rad", log.rpy[:, 1]),
        ("ahrs.csv", "yaw_rad", "sigma_yaw_rad", np.unwrap(log.rpy[:, 2])),
        ("depth.csv", "z_m", "sigma_z_m", log.z),
        ("dvl.csv", "vx_m_s", "sigma_v_m_s", log.v[log.valid, 0]),
    ):
        if len(y) < FEW_ROWS or not log.sigmas[sigma] > 0:
            continue
        third = np.abs(y[3:] - 3 * y[2:-1] + 3 * y[1:-2] - y[:-3])
        measured = 1.4826 * float(np.median(third)) / np.sqrt(20.0)  # 1 + 9 + 9 + 1
        if (ratio := measured / log.sigmas[sigma]) > ROUGH:
            cause = Reading(Cause.SIGMA, "noise.csv", sigma, ratio)
            yield Implausible("scatter", file, 0, column, measured, ROUGH * log.sigmas[sigma], "", (cause,))


ALONE = (steps, speeds, locks, zeros, tilts, turns, depths, outliers, scatter)
