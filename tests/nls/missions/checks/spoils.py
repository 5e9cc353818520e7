"""Ways to spoil a right log, each with the reading that a check must name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from models.algebra import Array
from nls.missions.checks.findings import Cause, Reading
from nls.missions.checks.log import Fixes, Log

__all__ = ["SPOILS"]
V = "vx_m_s, vy_m_s, vz_m_s"
DEG = 180 / np.pi
Change = Callable[[Log], Log]


def velocities(A: object) -> Change:
    return lambda log: replace(log, v=log.v @ np.array(A, dtype=float).T)


def angles(change: Callable[[Array], Array]) -> Change:
    return lambda log: replace(log, rpy=np.remainder(change(log.rpy) + np.pi, 2 * np.pi) - np.pi)


def depths(factor: float) -> Change:
    return lambda log: replace(log, z=factor * log.z)


def moved(log: Log, change: Callable[[Fixes], Fixes]) -> Log:
    assert log.fixes is not None
    return replace(log, fixes=change(log.fixes))


def late(name: str, lag: float) -> Change:
    return lambda log: replace(log, **{name: getattr(log, name) + lag})


def times(factor: float) -> Change:
    def scaled(log: Log) -> Log:
        return replace(log, **{name: factor * getattr(log, name) for name in ("t_v", "t_a", "t_z")})

    return lambda log: moved(scaled(log), lambda fixes: replace(fixes, t=factor * fixes.t))


def scattered(y: Array, size: float, every: int = 20) -> Array:
    """One of so many rows far off."""
    rng, y = np.random.default_rng(7), np.array(y)
    rows = rng.choice(len(y), len(y) // every, replace=False)
    y[rows] += rng.normal(0, size, y[rows].shape)
    return y


def sigma(name: str, factor: float) -> Change:
    return lambda log: replace(log, sigmas=log.sigmas | {name: factor * log.sigmas[name]})


def of(cause: Cause, file: str, column: str, factor: float = 1.0) -> Reading:
    return Reading(cause, file + ".csv", column, factor)


SPOILS: dict[str, tuple[Change, Reading]] = {
    "velocity in mm/s": (velocities(1000 * np.eye(3)), of(Cause.UNIT, "dvl", V, 1000.0)),
    "velocity in cm/s": (velocities(100 * np.eye(3)), of(Cause.UNIT, "dvl", V, 100.0)),
    "velocity in knots": (velocities(1.9438 * np.eye(3)), of(Cause.UNIT, "dvl", V, 1.9438)),
    "velocity in feet/s": (velocities(3.2808 * np.eye(3)), of(Cause.UNIT, "dvl", V, 3.2808)),
    "vx astern": (velocities(np.diag([-1, 1, 1])), of(Cause.SIGN, "dvl", "vx_m_s", -1.0)),
    "vz up": (velocities(np.diag([1, 1, -1])), of(Cause.SIGN, "dvl", "vz_m_s", -1.0)),
    "vx and vy swapped": (velocities([[0, 1, 0], [1, 0, 0], [0, 0, 1]]), of(Cause.SWAPPED, "dvl", "vx_m_s, vy_m_s")),
    "vx and vz swapped": (velocities([[0, 0, 1], [0, 1, 0], [1, 0, 0]]), of(Cause.SWAPPED, "dvl", "vx_m_s, vz_m_s")),
    "FLU": (velocities(np.diag([1, -1, -1])), of(Cause.AXES, "dvl", V)),
    "yaw in degrees": (lambda log: replace(log, rpy=log.rpy * [1, 1, DEG]), of(Cause.UNIT, "ahrs", "yaw_rad", DEG)),
    "roll and pitch swapped": (angles(lambda a: a[:, [1, 0, 2]]), of(Cause.SWAPPED, "ahrs", "roll_rad, pitch_rad")),
    "pitch with the bow down": (angles(lambda a: a * [1, -1, 1]), of(Cause.SIGN, "ahrs", "pitch_rad", -1.0)),
    "pitch in degrees": (lambda log: replace(log, rpy=log.rpy * [1, DEG, 1]), of(Cause.UNIT, "ahrs", "pitch_rad", DEG)),
    "roll in degrees": (lambda log: replace(log, rpy=log.rpy * [DEG, 1, 1]), of(Cause.UNIT, "ahrs", "roll_rad", DEG)),
    "roll upside down": (angles(lambda a: a + np.array([np.pi, 0, 0])), of(Cause.AXES, "ahrs", "roll_rad")),
    "depth negative": (depths(-1), of(Cause.SIGN, "depth", "z_m", -1.0)),
    "depth in feet": (depths(3.2808), of(Cause.UNIT, "depth", "z_m", 3.2808)),
    "depth in cm": (depths(100), of(Cause.UNIT, "depth", "z_m", 100.0)),
    "depth in kPa": (depths(10), of(Cause.UNIT, "depth", "z_m", 10.0)),
    "depth 30 % too large": (depths(1.3), of(Cause.SCALE, "depth", "z_m", 1.3)),
    "depth constant": (lambda log: replace(log, z=np.full_like(log.z, 12.0)), of(Cause.STUCK, "depth", "z_m")),
    "AHRS early by 6 s": (late("t_a", -6.0), of(Cause.CLOCK, "ahrs", "time_s", -6.0)),
    "AHRS late by 5 s": (late("t_a", 5.0), of(Cause.CLOCK, "ahrs", "time_s", 5.0)),
    "depth late by 5 s": (late("t_z", 5.0), of(Cause.CLOCK, "depth", "time_s", 5.0)),
    "times in ms": (times(1e3), of(Cause.UNIT, "dvl", "time_s", 1e3)),
    "times in ns": (times(1e9), of(Cause.UNIT, "dvl", "time_s", 1e9)),
    "valid inverted": (lambda log: replace(log, valid=~log.valid), of(Cause.INVERTED, "dvl", "valid")),
    "outliers of the DVL": (lambda log: replace(log, v=scattered(log.v, 3.0)), of(Cause.OUTLIERS, "dvl", V)),
    "outliers of the depth": (lambda log: replace(log, z=scattered(log.z, 20.0)), of(Cause.OUTLIERS, "depth", "z_m")),
    "outliers of the fixes": (
        lambda log: moved(log, lambda fixes: replace(fixes, p=scattered(fixes.p, 40.0, 15))),
        of(Cause.OUTLIERS, "fixes", "x_m, y_m"),
    ),
    "sigma of the yaw a variance": (sigma("sigma_yaw_rad", 0.01), of(Cause.SIGMA, "noise", "sigma_yaw_rad")),
    "sigma of the velocity too small": (sigma("sigma_v_m_s", 0.05), of(Cause.SIGMA, "noise", "sigma_v_m_s")),
    "sigma of the depth too small": (sigma("sigma_z_m", 0.05), of(Cause.SIGMA, "noise", "sigma_z_m")),
}
