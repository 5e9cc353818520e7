"""Missions whose truth is known, as the loggers of a vehicle write them: tables of text columns and a mapping.

`dive`: DVL, AHRS, depth, GPS in the first and the last six seconds. `usbl`: the same, and a ship that measures range,
bearing and elevation throughout. `rov`: no DVL; compass, depth and the positions of a USBL.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from models import SE3, SO3, euler
from models.algebra import Array, apply
from models.geodesy import LocalPlane
from models.manifolds.so3 import rotation3
from models.sensors import dvl_velocity, spherical

LENGTH, DT, BEFORE = 400.0, 0.1, 5.0  # s; the truth begins before the logs
START = 30_000.0  # s of the day
SITE = LocalPlane(54.2, -10.3)
DVL_ARM, ANTENNA, TRANSPONDER = (0.4, 0.0, 0.2), (-0.3, 0.0, -0.4), (-0.6, 0.0, -0.3)  # m, on the vehicle
SIGMA_V, SIGMA_Z, SIGMA_GPS, SIGMA_FIX = 0.02, 0.05, 0.5, 0.5
SIGMA_RPY = (0.005, 0.005, 0.01)  # rad
SIGMA_USBL = (0.3, 0.01, 0.01)  # m, rad, rad
YAW_BIAS, SCALE = 0.002, 0.001  # of a right sensor, 1 sigma
GPS_TIME = 6.0  # s at either end of a dive
LOSSES, LOST = 4, 6  # losses of bottom lock, and rows of one
DEG, WALK = 180 / np.pi, 0.7  # m/sqrt(s): half a meter a second, over two
TIME, DEPTH = "t [s]", "depth [m]"
VELOCITIES, ANGLES = ["vx [m/s]", "vy [m/s]", "vz [m/s]"], ["roll [deg]", "pitch [deg]", "heading [deg]"]
PLACES, SEEN = ["lat [deg]", "lon [deg]"], ["range [m]", "bearing [deg]", "elevation [deg]"]
Column = npt.NDArray[Any]


@dataclass
class Survey:
    """What the loggers wrote, and the answer.

    Attributes
    ----------
    mission : its name.
    logs : by table, then by the name of a column: numbers (n,) as they are written, or words.
    mapping : of `nls import`, as parsed.
    lines : by table, lines of text that stand between its header and its rows.
    t, p : (k,) and (k, 3) where the vehicle was, s of the day and m, in the axes of `SITE`.
    dated : whether times of the track are those of `t`; else its first one is the first of the logs.
    """

    mission: str
    logs: dict[str, dict[str, Column]]
    mapping: dict[str, Any]
    t: Array
    p: Array
    lines: dict[str, str] = field(default_factory=dict)
    dated: bool = True

    def copy(self) -> Survey:
        """One that may be spoiled."""
        return copy.deepcopy(self)

    def write(self, folder: Path) -> list[str]:
        """The logs and map.toml in a folder; the names of the logs."""
        for name, columns in self.logs.items():
            rows = zip(*(map(text, column) for column in columns.values()), strict=True)
            head = ",".join(columns) + "\n" + self.lines.get(name, "")
            (folder / log_of(name)).write_text(head + "".join(",".join(row) + "\n" for row in rows))
        (folder / "map.toml").write_text(toml(self.mapping))
        return [log_of(name) for name in self.logs]

    def error(self, track: Path, origin: Path) -> tuple[float, float]:
        """Root mean square error of the positions of a solution, m, and what it states."""
        rows = np.genfromtxt(track, delimiter=",", names=True, encoding="utf-8")
        t, p = rows["time_s"], np.column_stack([rows["x_m"], rows["y_m"], rows["z_m"]])
        if origin.exists():
            at = np.genfromtxt(origin, delimiter=",", names=True)
            plane = LocalPlane(float(at["lat_deg"]), float(at["lon_deg"]))
            p[:, :2] = SITE.local(*plane.geodetic(p[:, :2]))
        if not self.dated or any("date" in part for part in self.mapping.values() if isinstance(part, dict)):
            t = t - t[0] + self.t[0] + BEFORE
        true = np.column_stack([np.interp(t, self.t, column) for column in self.p.T])
        stated = np.sum([rows[f"sigma_{axis}_m"] ** 2 for axis in "xyz"], axis=0)
        return tuple(np.sqrt([np.mean(np.sum((p - true) ** 2, axis=1)), np.mean(stated)]).tolist())


def text(cell: Any) -> str:
    """A cell as a logger writes it."""
    return cell if isinstance(cell, str) else f"{cell:.9f}".rstrip("0").rstrip(".")


def toml(mapping: dict[str, Any]) -> str:
    """The text of a mapping."""
    above = {name: value for name, value in mapping.items() if not isinstance(value, dict)}
    sections = [(name, value) for name, value in mapping.items() if isinstance(value, dict)]
    lines = [f"{name} = {word(value)}" for name, value in above.items()]
    for name, section in sections:
        lines += [f"[{name}]", *(f"{key} = {word(value)}" for key, value in section.items())]
    return "\n".join(lines) + "\n"


def word(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {word(part)}" for key, part in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(word, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)


@dataclass(frozen=True)
class Vehicle:
    """A true track: times (n,), and roll, pitch, yaw, north, east and down (n, 6)."""

    t: Array
    X: Array

    @classmethod
    def sailing(cls, rng: np.random.Generator, speed: float, deep: float) -> Vehicle:
        """Lanes side by side with turns, from the surface down and up again."""
        t = np.arange(-BEFORE, LENGTH + BEFORE + DT / 2, DT)
        leg, lane = rng.uniform(40.0, 50.0), rng.uniform(-np.pi, np.pi)
        turns = np.array([0.0, 0.5, 1.0, 0.5]) * np.pi  # out, across, back, across
        yaw = smooth(lane + turns[((t + 15.0) // leg).astype(int) % 4], 10.0) + 0.1 * np.sin(t / 9.0)
        under = np.clip(np.minimum(t - GPS_TIME, LENGTH - GPS_TIME - t) / 60.0, 0.0, 1.0)
        z = smooth(deep * under + 2.0 * np.sin(2 * np.pi * t / 90.0) * (under == 1), 10.0)
        u, sway = speed * (1 + 0.15 * np.sin(t / 23.0)), 0.1 * np.sin(t / 31.0) - 0.5 * speed * np.gradient(yaw, DT)
        north, east = u * np.cos(yaw) - sway * np.sin(yaw), u * np.sin(yaw) + sway * np.cos(yaw)
        p = np.cumsum(np.column_stack([north, east]) * DT, axis=0)
        pitch, roll = -np.arctan2(np.gradient(z, DT), speed), 0.03 * np.sin(t / 2.3) + 0.2 * np.gradient(yaw, DT)
        return cls(t, np.column_stack([roll, pitch, yaw, p - p[np.searchsorted(t, 0.0)], z]))

    def at(self, t: Array) -> Array:
        """Roll, pitch, yaw, north, east and down (n, 6) at times (n,)."""
        return np.column_stack([np.interp(t, self.t, column) for column in self.X.T])

    def place(self, t: Array, arm: tuple[float, ...]) -> Array:
        """Where a point of the vehicle is, (n, 3)."""
        return SE3.act(euler.to_se3(self.at(t)), np.array([arm]))

    def velocity(self, t: Array) -> Array:
        """What a DVL measures, (n, 3)."""
        rates, rpy = (self.at(t + DT) - self.at(t - DT)) / (2 * DT), self.at(t)[:, :3]
        inward = rotation3(SO3.inverse(euler.quaternion_from_angles(rpy)))
        mount = euler.to_se3([[0.0, 0.0, 0.0, *DVL_ARM]])
        return dvl_velocity(apply(inward, rates[:, 3:]), apply(euler.rate_matrix(rpy), rates[:, :3]), mount)[0]


def smooth(y: Array, seconds: float) -> Array:
    """A running mean."""
    width = int(seconds / DT) | 1
    window = np.hanning(width + 2)[1:-1]
    return np.convolve(np.pad(y, width // 2, mode="edge"), window / window.sum(), mode="valid")


def every(period: float, begin: float = 0.0, end: float = LENGTH) -> Array:
    """Times (n,) of a sensor."""
    return np.round(np.arange(begin, end + period / 2, period), 6)


def table(t: Array, names: list[str], numbers: Array, digits: int) -> dict[str, Column]:
    """Columns of a log, the times first."""
    return {TIME: START + t} | dict(zip(names, np.round(numbers, digits).T, strict=True))


def heading(rpy: Array) -> Array:
    """Roll, pitch and heading, deg, as they are written."""
    return np.column_stack([np.degrees(rpy[:, :2]), np.degrees(rpy[:, 2]) % 360.0])


def ahrs(vehicle: Vehicle, rng: np.random.Generator, period: float, sigmas: tuple[float, ...]) -> dict[str, Column]:
    t = every(period, -1.0, LENGTH + 1.0)
    rpy = vehicle.at(t)[:, :3] + rng.normal(0, sigmas, (len(t), 3)) + [0, 0, rng.normal(0, YAW_BIAS)]
    return table(t, ANGLES, heading(rpy), 3)


def depth(vehicle: Vehicle, rng: np.random.Generator) -> dict[str, Column]:
    t = every(0.5)
    return table(t, [DEPTH], vehicle.at(t)[:, 5:] + rng.normal(0, SIGMA_Z, (len(t), 1)), 3)


def dive(seed: int) -> Survey:
    """DVL, AHRS and depth, 720 m; GPS in the first and the last six seconds."""
    rng = np.random.default_rng([1, seed])
    vehicle = Vehicle.sailing(rng, 1.8, 12.0)
    t, k = every(0.5), np.concatenate([every(1.0, 0.0, GPS_TIME), every(1.0, LENGTH - GPS_TIME)])
    v = vehicle.velocity(t) * (1 + rng.normal(0, SCALE)) + rng.normal(0, SIGMA_V, (len(t), 3))
    lost = np.zeros(len(t), dtype=int)
    for begin in rng.integers(60, len(t) - 60, LOSSES):
        lost[begin : begin + LOST] = 1
    v[lost == 1] = 0.0
    gps = vehicle.place(k, ANTENNA)[:, :2] + rng.normal(0, SIGMA_GPS, (len(k), 2))
    logs = {
        "dvl": table(t, VELOCITIES, v, 4) | {"lock": 1 - lost},
        "ahrs": ahrs(vehicle, rng, 0.25, SIGMA_RPY),
        "depth": depth(vehicle, rng),
        "fixes": table(k, PLACES, np.column_stack(SITE.geodetic(gps)), 8),
    }
    mapping: dict[str, Any] = {
        "time_s": TIME,
        "dvl": {"file": log_of("dvl"), **keyed("vx_m_s vy_m_s vz_m_s", VELOCITIES), "valid": "lock"},
        **angles_and_depth(),
        "fixes": positioned(SIGMA_GPS, ANTENNA),
        "dvl_mount": keyed("x_m y_m z_m roll_rad pitch_rad yaw_rad", (*DVL_ARM, 0, 0, 0)),
        "noise": {"sigma_v_m_s": SIGMA_V, "scale": 2 * SCALE, "sigma_bridge_m_s_sqrt_s": 0.05, **noise()},
    }
    return Survey("dive", logs, mapping, START + vehicle.t, vehicle.X[:, 3:])


def usbl(seed: int) -> Survey:
    """The dive, and a ship that measures range, bearing and elevation every four seconds."""
    survey, rng = dive(seed), np.random.default_rng([2, seed])
    t, k = every(4.0, 2.0, LENGTH - 2.0), every(1.0)
    anchor = survey.p[:, :2].mean(axis=0) + rng.normal(0, 30.0, 2)
    moving = every(DT, -BEFORE, LENGTH + BEFORE)
    swing = np.sin(moving[:, None] / [7.0, 5.0, 90.0, 70.0, 110.0, 6.0]) * [0.03, 0.02, 0.4, 4.0, 4.0, 0.2]
    middle = np.array([0, 0, rng.uniform(-np.pi, np.pi), *anchor, 3.0])
    ship = Vehicle(moving, middle + swing)
    there = np.column_stack([np.interp(START + t, survey.t, column) for column in survey.p.T])
    seen = spherical(SE3.act(SE3.inverse(euler.to_se3(ship.at(t))), there))[0] + rng.normal(0, SIGMA_USBL, (len(t), 3))
    survey.logs["usbl"] = table(t, SEEN, seen * [1, DEG, DEG], 3)
    X = ship.at(k)
    survey.logs["ship"] = table(
        k, [*PLACES, "z [m]", *ANGLES], np.column_stack([*SITE.geodetic(X[:, 3:5]), X[:, 5], heading(X[:, :3])]), 8
    )
    seen_keys = keyed("range_m bearing_rad elevation_rad", SEEN)
    sigmas = keyed("sigma_range_m sigma_bearing_rad sigma_elevation_rad", SIGMA_USBL)
    survey.mapping["usbl"] = {"file": log_of("usbl"), **seen_keys, **sigmas}
    where = keyed("lat_deg lon_deg", PLACES) | {"z_m": "z [m]"} | keyed("roll_rad pitch_rad yaw_rad", ANGLES)
    survey.mapping["ship"] = {"file": log_of("ship"), **where}
    survey.mission = "usbl"
    return survey


def rov(seed: int) -> Survey:
    """No DVL: a compass, a depth and the positions of a USBL every two seconds."""
    rng = np.random.default_rng([3, seed])
    vehicle = Vehicle.sailing(rng, 0.5, 12.0)
    k = every(2.0)
    place = vehicle.place(k, TRANSPONDER)[:, :2] + rng.normal(0, SIGMA_FIX, (len(k), 2))
    logs = {
        "ahrs": ahrs(vehicle, rng, 0.5, SIGMA_RPY),
        "depth": depth(vehicle, rng),
        "fixes": table(k, PLACES, np.column_stack(SITE.geodetic(place)), 8),
    }
    mapping: dict[str, Any] = {
        "time_s": TIME,
        "motion": {"sigma_walk_m_sqrt_s": WALK},
        **angles_and_depth(),
        "fixes": positioned(SIGMA_FIX, TRANSPONDER),
        "noise": noise(),
    }
    return Survey("rov", logs, mapping, START + vehicle.t, vehicle.X[:, 3:])


def log_of(name: str) -> str:
    """The file of a log."""
    return f"{name}.log.csv"


def keyed(names: str, values: Iterable[Any]) -> dict[str, Any]:
    """Keys of a mapping, and their values."""
    return dict(zip(names.split(), values, strict=True))


def positioned(sigma: float, arm: tuple[float, ...]) -> dict[str, Any]:
    """The section of positions."""
    keys = {"file": log_of("fixes"), **keyed("lat_deg lon_deg", PLACES), "sigma_x_m": sigma, "sigma_y_m": sigma}
    return keys | keyed("arm_x_m arm_y_m arm_z_m", arm)


def angles_and_depth() -> dict[str, dict[str, str]]:
    """The sections that every mission has."""
    attitude = keyed("roll_rad pitch_rad yaw_rad", ANGLES)
    return {"ahrs": {"file": log_of("ahrs"), **attitude}, "depth": {"file": log_of("depth"), "z_m": DEPTH}}


def noise() -> dict[str, float]:
    """The noise of these sections."""
    return keyed("sigma_roll_rad sigma_pitch_rad sigma_yaw_rad sigma_z_m", (*SIGMA_RPY, SIGMA_Z))


MISSIONS: dict[str, Callable[[int], Survey]] = {"dive": dive, "usbl": usbl, "rov": rov}
