"""Other readings of a raw log: each a mistake that is made with units, signs, frames and clocks, undone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from nls.io.mission.checks.findings import Cause, Reading
from nls.io.mission.checks.log import Log

__all__ = ["SPEED_UNITS", "Alternative", "alternatives"]
SPEED_UNITS = (1000.0, 100.0, 1.9438, 3.2808, 3.6)  # mm/s, cm/s, knots, ft/s and km/h in a m/s
LENGTH_UNITS = (100.0, 3.2808, 10.0, 0.001, 0.1, 0.01)  # cm, feet, kPa (of a depth), km, bar, kPa to dm
DEGREES = 180 / np.pi
LAGS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0)  # s


@dataclass(frozen=True)
class Alternative:
    """A reading, and the log that was meant."""

    reading: Reading
    apply: Callable[[Log], Log]


def alternatives(log: Log) -> list[Alternative]:
    """All that are tried for a log."""
    return [*_of_velocities(), *_of_angles(), *_of_depths(), *_of_clocks(log), *(_of_fixes() if log.fixes else [])]


def _of_velocities() -> list[Alternative]:
    def velocity(cause: Cause, columns: str, factor: float, A: npt.ArrayLike) -> Alternative:
        return Alternative(Reading(cause, "dvl.csv", columns, factor), partial(_velocities, np.asarray(A, dtype=float)))

    names = ("vx_m_s", "vy_m_s", "vz_m_s")
    out = [velocity(Cause.UNIT, ", ".join(names), f, np.eye(3) / f) for f in SPEED_UNITS]
    out += [velocity(Cause.SIGN, name, -1.0, _other_sign(k)) for k, name in enumerate(names)]
    for a, b in ((0, 1), (0, 2), (1, 2)):
        order = np.arange(3)
        order[[a, b]] = b, a
        out.append(velocity(Cause.SWAPPED, f"{names[a]}, {names[b]}", 1.0, np.eye(3)[order]))
    out.append(velocity(Cause.AXES, ", ".join(names), 1.0, np.diag([1.0, -1.0, -1.0])))
    for turn in (90.0, -90.0, 180.0, 45.0, -45.0, 135.0, -135.0):
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        out.append(velocity(Cause.TURNED, "vx_m_s, vy_m_s", turn, [[c, -s, 0], [s, c, 0], [0, 0, 1]]))
    return out


def _of_angles() -> list[Alternative]:
    def angle(cause: Cause, columns: str, factor: float, A: npt.ArrayLike, yaw: float = 0.0) -> Alternative:
        apply = partial(_angles, np.asarray(A, dtype=float), yaw)
        return Alternative(Reading(cause, "ahrs.csv", columns, factor), apply)

    names, same = ("roll_rad", "pitch_rad", "yaw_rad"), np.eye(3)
    out = [angle(Cause.SIGN, name, -1.0, _other_sign(k)) for k, name in enumerate(names)]
    out.append(angle(Cause.SWAPPED, "roll_rad, pitch_rad", 1.0, same[[1, 0, 2]]))
    out.append(angle(Cause.NORTH, "yaw_rad", 90.0, _other_sign(2), np.pi / 2))
    out += [angle(Cause.TURNED, "yaw_rad", turn, same, -np.radians(turn)) for turn in (90.0, -90.0, 180.0)]
    for columns in ((2,), (1,), (0,), (0, 1)):
        scale = np.diag([1 / DEGREES if k in columns else 1.0 for k in range(3)])
        out.append(angle(Cause.UNIT, ", ".join(names[k] for k in columns), DEGREES, scale))
    return out


def _of_depths() -> list[Alternative]:
    factors = [(Cause.SIGN, -1.0), *((Cause.UNIT, factor) for factor in LENGTH_UNITS)]
    return [Alternative(Reading(cause, "depth.csv", "z_m", f), partial(_depths, f)) for cause, f in factors]


def _of_clocks(log: Log) -> list[Alternative]:
    """Each sensor late by up to ten seconds, or early."""
    sensors = {"ahrs.csv": "t_a", "depth.csv": "t_z", "dvl.csv": "t_v"} | ({"fixes.csv": "fixes"} if log.fixes else {})
    return [
        Alternative(Reading(Cause.CLOCK, file, "time_s", lag), partial(_earlier, name, lag))
        for lag in (*LAGS, *(-lag for lag in LAGS))
        for file, name in sensors.items()
    ]


def _of_fixes() -> list[Alternative]:
    """North and east of the fixes."""

    def fix(cause: Cause, columns: str, factor: float, A: npt.ArrayLike) -> Alternative:
        return Alternative(Reading(cause, "fixes.csv", columns, factor), partial(_fixes, np.asarray(A, dtype=float)))

    return [
        fix(Cause.SWAPPED, "x_m, y_m", 1.0, [[0, 1], [1, 0]]),
        fix(Cause.SIGN, "x_m", -1.0, [[-1, 0], [0, 1]]),
        fix(Cause.SIGN, "y_m", -1.0, [[1, 0], [0, -1]]),
        *(fix(Cause.UNIT, "x_m, y_m", f, np.eye(2) / f) for f in (1000.0, 100.0, 3.2808, 0.001)),
    ]


def _other_sign(k: int) -> Array:
    return np.diag(np.where(np.arange(3) == k, -1.0, 1.0))


def _velocities(A: Array, log: Log) -> Log:
    return replace(log, v=log.v @ A.T)


def _angles(A: Array, yaw: float, log: Log) -> Log:
    return replace(log, rpy=log.rpy @ A.T + np.array([0.0, 0.0, yaw]))


def _depths(factor: float, log: Log) -> Log:
    return replace(log, z=log.z / factor)


def _earlier(name: str, lag: float, log: Log) -> Log:
    if name != "fixes":
        return replace(log, **{name: getattr(log, name) - lag})
    assert log.fixes is not None
    return replace(log, fixes=replace(log.fixes, t=log.fixes.t - lag))


def _fixes(A: Array, log: Log) -> Log:
    assert log.fixes is not None
    return replace(log, fixes=replace(log.fixes, p=log.fixes.p @ A.T))
