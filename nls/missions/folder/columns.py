"""The files of a mission folder and the columns of each: names with their units, in the order they are written."""

import math
from collections.abc import Collection

PLACE = ("x_m", "y_m", "z_m")
VELOCITY = ("vx_m_s", "vy_m_s", "vz_m_s")
ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")
LEVEL = ("x_m", "y_m", "yaw_rad")
UPRIGHT = ("z_m", "roll_rad", "pitch_rad")  # what a vehicle at one depth, level, does not measure
TILT = ("z_m", "pitch_rad", "roll_rad")
CONTACT = ("range_m", "azimuth_rad")
COMPASS = ("yaw_rad", "sigma_yaw_rad")
USBL = ("range_m", "bearing_rad", "elevation_rad")
WHEN = ("time_s", "i")  # a measurement is of a time, or of a pose
GEODETIC = ("lat_deg", "lon_deg")
ARM = ("arm_x_m", "arm_y_m", "arm_z_m")
HOW = ("delay_s", *ARM, "kernel")
POSE = ("i", *ANGLES, *PLACE)
LOCK = ("beams", "altitude_m", "sigma_v_m_s")
WATER_TRACK = ("water_vx_m_s", "water_vy_m_s", "water_vz_m_s", "water_valid")
GYRO = ("sigma_w_rad_s_sqrt_hz", "sigma_bias_rad_s", "sigma_bias_walk_rad_s_sqrt_s")


def suffixed(names: tuple[str, ...]) -> tuple[str, ...]:
    """The columns of the standard deviations of columns."""
    return tuple(f"sigma_{name}" for name in names)


def maybe(*names: str) -> tuple[str, ...]:
    """Columns that may be left out; where one of two is needed, the reader says so."""
    return tuple(f"{name}?" for name in names)


SPATIAL = (*PLACE, *ANGLES)
RELATIVE = tuple(  # of a pose from another one; what a vehicle that is level does not measure may be left out
    name + "?" * (name.removeprefix("sigma_") in UPRIGHT) for name in (*SPATIAL, *suffixed(SPATIAL))
)
MARKED: dict[str, tuple[str, ...]] = {  # those with a question mark may be left out
    "sonar": ("name", "beams", "bins", "fan_rad", "aperture_rad", "range_min_m", "range_max_m", *PLACE, *ANGLES),
    "contacts": (*maybe(*WHEN[::-1], "landmark"), *CONTACT, *suffixed(CONTACT)),
    "odometry": ("i", "j", *LEVEL, *suffixed(LEVEL)),
    "zpr": ("i", *TILT, *suffixed(TILT), *maybe(*COMPASS)),
    "anchor": ("i", *LEVEL, *suffixed(LEVEL)),
    "truth": (*maybe(*WHEN[::-1]), *ANGLES, *PLACE),
    "landmarks": ("landmark", *PLACE),
    "dvl": ("time_s", *VELOCITY, *maybe("valid", *LOCK, *WATER_TRACK, "earth_axes")),
    "ahrs": ("time_s", *ANGLES[:2], "yaw_rad?"),
    "gyro": ("time_s", "wx_rad_s", "wy_rad_s", "wz_rad_s"),
    "depth": ("time_s", "z_m"),
    "pressure": ("time_s", "pressure_pa"),
    "water": maybe("density_kg_m3", "latitude_deg", "atmosphere_pa"),
    "tide": ("time_s", "tide_m"),
    "dvl_mount": (*PLACE, *ANGLES),
    "noise": (
        *("sigma_v_m_s", "scale", "sigma_bridge_m_s_sqrt_s", *suffixed(ANGLES[:2])),
        *("sigma_yaw_rad?", "sigma_z_m", *maybe("gate_v_m_s", *GYRO)),
    ),
    "poses": ("i", "time_s"),
    "origin": GEODETIC,
    "fixes": (*maybe(*WHEN, *PLACE, *GEODETIC), *suffixed(PLACE[:2]), *maybe("sigma_z_m", *HOW)),
    "beacons": ("beacon", *maybe("x_m", "y_m"), "z_m", *maybe(*GEODETIC, *suffixed(PLACE[:2])), "sigma_z_m"),
    "ranges": (
        *(*maybe(*WHEN), "beacon"),
        *maybe("range_m", "travel_time_s", "sigma_range_m", "sigma_travel_time_s", "turn_around_s", "ways", *HOW),
    ),
    "usbl": (*maybe(*WHEN, "beacon"), *USBL, *suffixed(USBL), *maybe(*HOW)),
    "ship": ("time_s", *maybe("x_m", "y_m"), "z_m", *maybe(*GEODETIC), *ANGLES),
    "closures": (*maybe("i", "j", "time_i_s", "time_j_s"), *RELATIVE, "kernel?"),
    "dive_closures": ("i", "dive", "j", *RELATIVE, "kernel?"),
    "path": ("time_s", *RELATIVE),
    "motion": ("sigma_walk_m_sqrt_s",),
    "sound-speed": ("z_m", "sound_speed_m_s"),
    "calibration": ("name", "value", "sigma"),
}
COLUMNS = {table: tuple(name.rstrip("?") for name in names) for table, names in MARKED.items()}
OPTIONAL = {table: tuple(name[:-1] for name in names if name[-1] == "?") for table, names in MARKED.items()}
BOUNDS = "1e-12", "1e12"  # of a standard deviation: its inverse square, times another, is a number still
SMALLEST, LARGEST = map(float, BOUNDS)
TURNS = 2 * math.pi  # rad
ANY = LARGEST, f"a number within {BOUNDS[1]}"
OF_ENDS = (  # the end of a name, its dimension and unit, how far from 0 its numbers may be, what they are
    ("_m_s_sqrt_s", "", "", *ANY),
    ("_kg_m3", "", "", *ANY),
    ("time_s", "time", "s", 1e15, "seconds, within 1e15"),
    ("_m_s", "velocity", "m/s", 1e9, "meters per second, within 1e9"),
    ("_rad_s", "rate", "rad/s", 100.0, "radians per second, within 100"),
    ("_deg_s", "rate", "deg/s", *ANY),
    ("_rad", "angle", "rad", TURNS, "radians, -2 pi to 2 pi"),
    ("_deg", "angle", "deg", 360.0, "degrees, -360 to 360"),
    ("_dbar", "pressure", "dbar", *ANY),
    ("_pa", "pressure", "Pa", *ANY),
    ("_m", "length", "m", 1e9, "meters, within 1e9"),  # the Moon is 4e8 m away
    ("_s", "time", "s", *ANY),
    ("", "", "", *ANY),
)
SENTINELS = (  # numbers that loggers write for none, of either sign
    *(999.0, 9999.0, 99999.0, 999999.0, 9999999.0),
    *(2.0**15 - 1, 2.0**15, 2.0**16 - 1, 2.0**31 - 1, 2.0**31),
)
MAY_BE_0 = ("scale", "sigma_bridge_m_s_sqrt_s")  # of noise.csv; its others are above 0
TRACK = ("odometry", "zpr")  # either these
LOG = ("dvl", "ahrs", "depth", "noise")  # or these must be there, all of them, and pressure may be in place of depth
ALONE: dict[str, tuple[str, ...]] = {  # or one of these, and files of the raw log that may be there with it
    "path": (),
    "motion": ("ahrs", "depth", "pressure", "water", "tide", "noise"),
}
BESIDE = ("dvl_mount", "gyro", "pressure", "water", "tide")  # files that are of use beside a raw log alone


def optional(table: str, tables: Collection[str]) -> tuple[str, ...]:
    """Columns of a table that may be left out in a mission with some tables.

    Without a DVL a compass may be alone, and noise.csv has what the tables need: the reader says which it is.
    """
    if table in ("ahrs", "noise") and not {"dvl", *TRACK} & set(tables):
        return tuple(name for name in COLUMNS[table] if name != "time_s")
    return OPTIONAL[table]


def needed(tables: Collection[str]) -> tuple[str, ...]:
    """Tables without which a mission with some tables is none."""
    if "motion" in tables:
        return ("noise",) if {"ahrs", "depth", "pressure"} & set(tables) else ()
    if "path" in tables:
        return ()
    return TRACK if set(TRACK) & set(tables) else tuple(t for t in LOG if t != "depth" or "pressure" not in tables)
