"""raw/: a survey as the loggers of its instruments write it, and the mapping that `nls import` needs to read that.

Each instrument has its own file with its own stamps, units, signs and words. Numbers have the digits that such a logger
has. What no instrument knows, noise, mountings and calibrations, is in the mapping.
Contacts of a sonar are of numbered poses, which no logger has: they are in the mission alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from nls.missions.folder.table import csv_text
from sim.survey_log import SurveyLog

__all__ = ["raw_files"]

EPOCH = np.datetime64("2026-05-12T08:00:00", "ns")  # UTC at time 0 of the mission
KNOT = 1852.0 / 3600.0  # m/s
MAPPED = """\
# Which column of which log is which column of the mission, for: nls import *.csv --map mapping.toml -o mission
# Units are read off the names of the columns: v_fwd_mm_s is in mm/s.
time_zero = "2026-05-12T08:00:00Z"

[dvl]
file = "dvl.csv"
time_s = "stamp_ns"
vx_m_s = "v_fwd_mm_s"
vy_m_s = "v_stbd_mm_s"
vz_m_s = { column = "v_up_mm_s", sign = -1 }
valid = "bottom_lock"
altitude_m = "altitude_cm"

[ahrs]
file = "ahrs.csv"
time_s = "utc"
attitude = ["roll_deg", "pitch_deg", "heading_deg"]

[depth]
file = "depth.csv"
time_s = "unix_s"
z_m = { column = "height_m", up = true }

[fixes]
file = "gps.csv"
time_s = "stamp_ns"
lat_deg = "latitude_deg"
lon_deg = "longitude_deg"
sigma_x_m = "std_m"
sigma_y_m = "std_m"

[beacons]
file = "transponders.csv"
beacon = "transponder"
lat_deg = "latitude_deg"
lon_deg = "longitude_deg"
z_m = "depth_m"
sigma_position = ["std_m", "std_m", "std_m"]

[ranges]
file = "lbl.csv"
time_s = "stamp_ns"
beacon = "transponder"
travel_time_s = "round_trip_ms"
sigma_travel_time_s = "std_ms"
turn_around_s = "turn_around_ms"
delay_s = "age_ms"

[usbl]
file = "usbl.csv"
time_s = "utc"
range_m = "slant_range_m"
bearing_rad = "bearing_deg"
elevation_rad = "depression_deg"
sigma_range_m = "std_range_m"
sigma_bearing_rad = "std_angle_deg"
sigma_elevation_rad = "std_angle_deg"

[ship]
file = "ship.csv"
time_s = "stamp_ns"
lat_deg = "latitude_deg"
lon_deg = "longitude_deg"
z_m = "draught_m"
attitude = ["roll_deg", "pitch_deg", "heading_deg"]
"""
ARM = ("arm_x_m", "arm_y_m", "arm_z_m")


def raw_files(log: SurveyLog) -> dict[str, bytes]:
    """The files by name, below raw/."""
    tables = log.tables
    dvl, ahrs, fixes, ship = (tables[name] for name in ("dvl", "ahrs", "fixes", "ship"))
    ranges, usbl, beacons = (tables[name] for name in ("ranges", "usbl", "beacons"))
    speed = np.linalg.norm(log.track.velocity(fixes["time_s"])[0], axis=1) / KNOT
    files: dict[str, dict[str, npt.ArrayLike]] = {
        "dvl.csv": {
            "stamp_ns": nanoseconds(dvl["time_s"]),
            "v_fwd_mm_s": np.round(1e3 * dvl["vx_m_s"], 1),
            "v_stbd_mm_s": np.round(1e3 * dvl["vy_m_s"], 1),
            "v_up_mm_s": np.round(-1e3 * dvl["vz_m_s"], 1) + 0.0,
            "bottom_lock": dvl["valid"],
            "altitude_cm": np.round(1e2 * dvl["altitude_m"]).astype(int),
        },
        "ahrs.csv": {
            "utc": iso(ahrs["time_s"]),
            "roll_deg": degrees(ahrs["roll_rad"]),
            "pitch_deg": degrees(ahrs["pitch_rad"]),
            "heading_deg": np.round(np.degrees(ahrs["yaw_rad"]) % 360.0, 4) % 360.0,
        },
        "depth.csv": {
            "unix_s": np.round(1e-9 * nanoseconds(tables["depth"]["time_s"]), 3),
            "height_m": np.round(-tables["depth"]["z_m"], 3) + 0.0,
        },
        "gps.csv": {
            "stamp_ns": nanoseconds(fixes["time_s"]),
            "latitude_deg": fixes["lat_deg"],
            "longitude_deg": fixes["lon_deg"],
            "std_m": fixes["sigma_x_m"],
            "speed_kn": np.round(speed, 1),
        },
        "lbl.csv": {
            "stamp_ns": nanoseconds(ranges["time_s"]),
            "transponder": ranges["beacon"],
            "round_trip_ms": np.round(1e3 * ranges["travel_time_s"], 4),
            "std_ms": np.round(1e3 * ranges["sigma_travel_time_s"], 4),
            "turn_around_ms": np.round(1e3 * ranges["turn_around_s"], 4),
            "age_ms": np.round(1e3 * ranges["delay_s"], 3),
        },
        "usbl.csv": {
            "utc": iso(usbl["time_s"]),
            "slant_range_m": np.round(usbl["range_m"], 3),
            "bearing_deg": degrees(usbl["bearing_rad"]),
            "depression_deg": degrees(usbl["elevation_rad"]),
            "std_range_m": usbl["sigma_range_m"],
            "std_angle_deg": degrees(usbl["sigma_bearing_rad"]),
        },
        "ship.csv": {
            "stamp_ns": nanoseconds(ship["time_s"]),
            "latitude_deg": ship["lat_deg"],
            "longitude_deg": ship["lon_deg"],
            "heading_deg": degrees(ship["yaw_rad"]),
            "roll_deg": degrees(ship["roll_rad"]),
            "pitch_deg": degrees(ship["pitch_rad"]),
            "draught_m": ship["z_m"],
        },
        "transponders.csv": {
            "transponder": beacons["beacon"],
            "latitude_deg": beacons["lat_deg"],
            "longitude_deg": beacons["lon_deg"],
            "depth_m": np.round(beacons["z_m"], 3),
            "std_m": beacons["sigma_z_m"],
        },
    }
    raw = {f"raw/{name}": csv_text(list(columns), *columns.values()) for name, columns in files.items()}
    raw["raw/dvl.csv"] = raw["raw/dvl.csv"].replace(b",", b";")
    return {**raw, "raw/mapping.toml": mapping(log).encode()}


def mapping(log: SurveyLog) -> str:
    """mapping.toml: the columns of the loggers, and constants that no logger writes."""
    tables = log.tables
    text = MAPPED
    for name in ("fixes", "ranges"):
        text = text.replace(f"[{name}]\n", f"[{name}]\n" + constants(tables[name], ARM))
    if "kernel" in tables["usbl"]:
        text = text.replace("[usbl]\n", f'[usbl]\nkernel = "{tables["usbl"]["kernel"][0]}"\n')
    for name in ("noise", "dvl_mount", "origin"):
        text += f"\n[{name}]\n" + constants(tables[name], tuple(tables[name]))
    for name, value, sigma in zip(*tables["calibration"].values(), strict=True):
        text += f'\n[[calibration]]\nname = "{name}"\nvalue = {float(value)!r}\nsigma = {float(sigma)!r}\n'
    return text


def constants(table: dict[str, npt.NDArray[Any]], columns: tuple[str, ...]) -> str:
    """Lines of a section for columns that have one number."""
    return "".join(f"{name} = {float(table[name][0])!r}\n" for name in columns)


def nanoseconds(t: Array) -> npt.NDArray[np.int64]:
    """Stamps (n,) since 1970, ns, of times of the mission (n,), s, to a microsecond.

    Examples
    --------
    >>> nanoseconds(np.array([0.25])).tolist()
    [1778572800250000000]
    """
    return np.asarray(EPOCH.astype(np.int64) + 1000 * np.round(1e6 * t).astype(np.int64))


def iso(t: Array) -> list[str]:
    """Stamps in the words of ISO 8601, to a microsecond, of times of the mission (n,), s.

    Examples
    --------
    >>> iso(np.array([-0.1, 61.5]))
    ['2026-05-12T07:59:59.900000Z', '2026-05-12T08:01:01.500000Z']
    """
    return [f"{stamp}Z" for stamp in np.datetime_as_string(nanoseconds(t).astype("datetime64[ns]"), unit="us")]


def degrees(angle: Array) -> Array:
    """Degrees of radians, to a ten-thousandth."""
    return np.asarray(np.round(np.degrees(angle), 4))
