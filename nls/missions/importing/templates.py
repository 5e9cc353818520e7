"""Templates of a mission, to be filled by hand or by a script: heads, units and an example row each."""

from nls.missions.folder.columns import COLUMNS, LOG, TRACK, optional
from nls.missions.importing.headers import mission_unit

ABOUT = {
    "sonar": "the imaging sonar: one row; its name in quotation marks where it has a comma",
    "contacts": "a landmark that the sonar saw, at a time or from pose i; azimuth to starboard",
    "odometry": "the step from pose i to pose j, in the horizontal axes of i",
    "zpr": "depth and tilt of each pose, and its heading where there is a compass",
    "anchor": "a pose whose place and heading in the world are known",
    "truth": "true poses, for errors; of a pose i, or of a time",
    "landmarks": "true landmarks",
    "dvl": "velocity over the bottom along the axes of the DVL: ahead, starboard, down; valid: 1 with bottom lock",
    "ahrs": "attitude of the vehicle: starboard side down, bow up, clockwise from north",
    "depth": "depth, down",
    "dvl_mount": "where the DVL is on the vehicle: one row",
    "noise": "standard deviations of the log: one row",
    "poses": "when the poses are",
    "origin": "where x = y = 0 is on the Earth, WGS 84: one row",
    "fixes": "a position of the vehicle, as of GPS; x, y or lat, lon",
    "beacons": "an acoustic beacon; x, y or lat, lon",
    "ranges": "a distance to a beacon, or a travel time",
    "usbl": "range and direction to a beacon, or from the ship",
    "ship": "where the transceiver of a ship was; x, y or lat, lon",
    "closures": "two poses at one place: where j is in the axes of i",
    "dive_closures": "a place of this dive that is one of another: where its pose j is in the axes of i",
    "path": "the way as another program has reckoned it; sigmas of a step",
    "motion": "how far the vehicle may go where no sensor measures its motion: one row",
    "gyro": "rates of turn about the axes of the vehicle, in place of the yaw of ahrs.csv",
    "pressure": "pressure with that of the atmosphere, in place of depth.csv",
    "water": "what the water is like, for pressure.csv: one row",
    "tide": "the height of the surface above the level from which depths count",
    "sound-speed": "the speed of sound over depth",
    "calibration": "a property of a sensor: its value and sigma; sigma 0 fixes it",
}
ALTERNATIVES = {  # of two ways to say the same the template has one
    "truth": ("time_s",),
    "contacts": ("i",),
    "fixes": ("i", "lat_deg", "lon_deg"),
    "beacons": ("lat_deg", "lon_deg"),
    "ranges": ("i", "travel_time_s", "sigma_travel_time_s"),
    "usbl": ("i",),
    "ship": ("lat_deg", "lon_deg"),
    "closures": ("time_i_s", "time_j_s"),
}
EXAMPLES = {  # by column, or by table and column
    **{"name": "dvl_scale", "kernel": "huber:1.345", "time_s": "0.0", "time_i_s": "10.0", "time_j_s": "95.0"},
    **{"i": "0", "j": "1", "landmark": "7", "beacon": "1", "beams": "256", "bins": "500", "ways": "2", "valid": "1"},
    **{"lat_deg": "54.1", "lon_deg": "10.2", "sound_speed_m_s": "1500.0", "vx_m_s": "1.2", "range_m": "12.5"},
    **{"range_min_m": "1.0", "range_max_m": "20.0", "fan_rad": "2.1", "aperture_rad": "0.35", "scale": "0.005"},
    **{"travel_time_s": "0.0167", "turn_around_s": "0.0", "delay_s": "0.0", "sigma_bridge_m_s_sqrt_s": "0.05"},
    **{"sigma_travel_time_s": "0.0001", "value": "0.0", "sigma": "0.01", "z_m": "5.0"},
    **{"sonar.name": '"sonar"', "sonar.z_m": "0.0", **{f"sonar.{a}_rad": "0.0" for a in ("roll", "pitch", "yaw")}},
    **{"contacts.sigma_range_m": "0.02", "contacts.sigma_azimuth_rad": "0.005", "path.sigma_yaw_rad": "0.01"},
    **{"fixes.sigma_x_m": "2.0", "fixes.sigma_y_m": "2.0", "path.sigma_x_m": "0.05", "path.sigma_y_m": "0.05"},
}
SMALL = {"rad": "0.01", "deg": "1.0", "m": "0.5", "m/s": "0.02", "s": "0.01"}
NOISE = """\
[noise]                          # one sigma each, from the data sheets
sigma_v_m_s = 0.02               # of one velocity of the DVL
scale = 0.005                    # of its scale, a fraction
sigma_bridge_m_s_sqrt_s = 0.05   # of the velocity after a second without bottom lock
sigma_roll_rad = 0.005
sigma_pitch_rad = 0.005
sigma_yaw_rad = 0.02
sigma_z_m = 0.05
"""
HEAD = """\
# Which columns of a log are which of the mission: nls import LOG --map mapping.toml -o mission
#
# A column is         vx_m_s = "Vel X [mm/s]"                           the unit is read from the header,
#                     vx_m_s = { column = "Vel X", unit = "mm/s" }      or given; also sign = -1, scale, offset, missing
# A number is a constant: sigma_x_m = 2.0. Depth from a height: z_m = { column = "Altitude [m]", up = true }
# A flag:             valid = { column = "status", equals = "A" } or { column = "beams", above = 2 }
# Several logs:       file = "dvl.csv" in the section, where several have the columns; of a bag topic = "/dvl"
# Three at once:      velocity, attitude, position, sigma_attitude = ["...", "...", "..."]; quaternion = [x, y, z, w]
# Axes:               frame = "ENU" (with FLU), "NWU" (with FLU), "FLU" (a body alone), "ENU/FRD"; NED/FRD without it
# Times:              time_format = "%d.%m.%Y %H:%M:%S"; date = "2022-08-15", of times of the day; sort = true
# Reading:            separator = "semicolon", decimal = ",", header = false, skip = 3, where = { column, equals }

# time_s = "Time [s]"   # above all sections: for every table

"""


def templates(mapping: bool = False) -> dict[str, bytes]:
    """The files of ``nls new`` by name: mapping.toml, and unless it is asked for alone a template of each table.

    Examples
    --------
    >>> print(templates()["templates/depth.csv"].decode())
    # depth.csv: depth, down. Needed for a raw log.
    # s, m
    time_s,z_m
    # 0.0,5.0
    >>> list(templates(mapping=True))
    ['mapping.toml']
    """
    sections = map(_section, (*LOG[:3], "path", "motion", "fixes", "contacts", "sonar"))
    files = {"mapping.toml": (HEAD + "\n".join([*sections, NOISE])).encode()}
    if not mapping:
        files |= {f"templates/{table}.csv": _template(table).encode() for table in COLUMNS}
    return files


def _template(table: str) -> str:
    """Head and one example of a table."""
    columns = [name for name in COLUMNS[table] if name not in ALTERNATIVES.get(table, ())]
    need = f" Needed for {'a raw log' if table in LOG else 'an integrated track'}." if table in (*LOG, *TRACK) else ""
    lines = [f"# {table}.csv: {ABOUT[table]}.{need}"]
    lines.append("# " + ", ".join(mission_unit(name)[1] or "-" for name in columns))
    if left_out := [name for name in columns if name in optional(table, LOG)]:
        lines.append(f"# may be left out: {', '.join(left_out)}")
    if others := ALTERNATIVES.get(table):
        lines.append(f"# other columns: {', '.join(others)}")
    return "\n".join([*lines, ",".join(columns), "# " + ",".join(example(table, column) for column in columns)]) + "\n"


def _section(table: str) -> str:
    """A section of the mapping, commented out."""
    columns = [name for name in COLUMNS[table] if name not in (*ALTERNATIVES.get(table, ()), "kernel", "delay_s")]
    columns = [name for name in columns if not name.startswith("arm_")]
    width = max(map(len, columns))
    units = {name: mission_unit(name)[1] for name in columns}
    remarks = {name: f"   # {unit}" if unit else "" for name, unit in units.items()}
    lines = [f'# {name:{width}} = "COLUMN OF THE LOG"{remark}' for name, remark in remarks.items()]
    return "\n".join([f"# [{table}]   # {ABOUT[table]}", *lines, ""])


def example(table: str, column: str) -> str:
    """A value that a column of a table may have.

    Examples
    --------
    >>> example("sonar", "beams"), example("contacts", "sigma_range_m"), example("zpr", "sigma_z_m")
    ('256', '0.02', '0.5')
    """
    known = EXAMPLES.get(f"{table}.{column}", EXAMPLES.get(column))
    if known is not None:
        return known
    unit = mission_unit(column)[1]
    small = SMALL.get(unit, "1.0")
    return small if column.startswith("sigma") or unit in ("rad", "m/s") else "0.0" if unit else "1.0"
