"""raw/: a survey as the loggers of its instruments write it, and the mapping that `nls import` needs to read that.

Each instrument has its own file with its own stamps, units, signs and words. Numbers have the digits that such a logger
has. What no instrument knows, noise, mountings, beacons and calibrations, is in the mission alone.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from nls.io.mission.table import csv_text
from sim.survey_log import SurveyLog

__all__ = ["raw_files"]

EPOCH = np.datetime64("2026-05-12T08:00:00", "ns")  # UTC at time 0 of the mission
KNOT = 1852.0 / 3600.0  # m/s


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
            "altitude_cm": np.round(1e2 * log.altitude).astype(int),
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
            "latitude": fixes["lat_deg"],
            "longitude": fixes["lon_deg"],
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
            "latitude": ship["lat_deg"],
            "longitude": ship["lon_deg"],
            "heading_deg": degrees(ship["yaw_rad"]),
            "roll_deg": degrees(ship["roll_rad"]),
            "pitch_deg": degrees(ship["pitch_rad"]),
            "draught_m": ship["z_m"],
        },
        "transponders.csv": {
            "transponder": beacons["beacon"],
            "latitude": beacons["lat_deg"],
            "longitude": beacons["lon_deg"],
            "depth_m": np.round(beacons["z_m"], 3),
            "std_m": beacons["sigma_z_m"],
        },
    }
    raw = {f"raw/{name}": csv_text(list(columns), *columns.values()) for name, columns in files.items()}
    raw["raw/dvl.csv"] = raw["raw/dvl.csv"].replace(b",", b";")
    return raw


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
