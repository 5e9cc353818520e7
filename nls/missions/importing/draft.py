"""A first mapping for a log: one guess per line, unknown entries are marked; read it before you use it."""

import json
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from models.visible import CONTROLS
from nls.missions.folder.columns import ANGLES, COLUMNS, GEODETIC, OPTIONAL, PLACE, VELOCITY
from nls.missions.importing.bags import Bag, is_bag, refuse_no_log
from nls.missions.importing.headers import guess, guesses, header_unit, mission_unit, plain
from nls.missions.importing.quantities import EPOCH, LARGEST
from nls.missions.importing.templates import NOISE, example
from nls.missions.importing.text_log import Log, TextLog

REMARKS = {
    "fan_rad": "its whole width in azimuth, and its height in elevation",
    "pitch_rad": "negative where it looks down",
}
TABLES = {  # what must be there, what may be
    "dvl": (("time_s", *VELOCITY), ("valid",)),
    "path": (("time_s", "x_m", "y_m", "yaw_rad"), ("z_m", "roll_rad", "pitch_rad")),
    "ahrs": (("time_s", *ANGLES), ()),
    "depth": (("time_s", "z_m"), ()),
    "fixes": (("time_s", *GEODETIC), ()),
    "truth": (("time_s", *ANGLES, *PLACE), ()),
    "contacts": (("time_s", "range_m", "azimuth_rad"), ("landmark",)),
    "ranges": (("time_s", "range_m"), ("beacon",)),
}
AXES = {"vy_m_s": "y is to starboard", "vz_m_s": "z is down"}
LEVEL_NOTE = "no column looks like it: level, as far as its sigma in [noise] says"
OF_ONE_LOG = "needed only if several logs have these columns; leave it out to use the mapping for other dives"
NOISE_OF = ("dvl", "dvl", "dvl", "ahrs", "ahrs", "ahrs", "depth")  # the table of each
WALK = "sigma_walk_m_sqrt_s = 1.0   # a guess: by so much in the first second, and by its root in more"
MESSAGES = {  # sections by type of message; {topic} is filled in
    "Imu": ["[ahrs]", 'quaternion = "orientation"', 'frame = "ENU"   # as of ROS; "NED" where the driver says so'],
    "TwistStamped": ["[dvl]", *(f'v{a}_m_s = "twist.linear.{a}"' for a in "xyz"), 'frame = "FLU"'],
    "TwistWithCovarianceStamped": ["[dvl]", *(f'v{a}_m_s = "twist.twist.linear.{a}"' for a in "xyz"), 'frame = "FLU"'],
    "FluidPressure": [
        "[depth]",
        "# meters a Pascal in sea water, 1 / (1026 kg/m3 9.81 m/s2); less the pressure of the air",
        'z_m = { column = "fluid_pressure", scale = 9.936e-5, offset = -10.07 }',
    ],
    "NavSatFix": ["[fixes]", 'lat_deg = "latitude"', 'lon_deg = "longitude"', "sigma_x_m = 2.0", "sigma_y_m = 2.0"],
    "Odometry": [
        "[truth]   # if it is one",
        'quaternion = "pose.pose.orientation"',
        *(f'{a}_m = "pose.pose.position.{a}"' for a in "xyz"),
        'frame = "ENU"',
    ],
}


def draft(paths: Sequence[str | Path]) -> str:
    """A mapping of logs, as TOML: the columns that look like those of a mission.

    Parameters
    ----------
    paths : text files with a header, and bags.

    Raises
    ------
    GraphFileError
        A log that cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     log = Path(folder, "log.csv")
    ...     _ = log.write_text("stamp,depth (cm),temperature\\n0,250,4\\n")
    ...     print(draft([log]).split("# [dvl]")[0])
    # a draft: each line is a guess by the name of a column; read it, correct it
    <BLANKLINE>
    # log.csv has: 'stamp', 'depth (cm)', 'temperature'
    [depth]
    time_s = "stamp"
    z_m = "depth (cm)"
    # not used: 'temperature'
    <BLANKLINE>
    """
    refuse_no_log(paths)
    lines = ["# a draft: each line is a guess by the name of a column; read it, correct it", ""]
    tables: list[str] = []
    logs = [Bag(path) if is_bag(path) else TextLog(path) for path in paths]
    tilted = any(isinstance(log, Bag) or all(guess(angle, log.names) for angle in ANGLES) for log in logs)
    for log in logs:
        lines += _of_bag(log, tables) if isinstance(log, Bag) else _of_text(log, len(logs) > 1, tables, tilted)
    if "path" in tables:  # which needs no log of sensors
        return "\n".join(lines)
    walks = "dvl" not in tables and bool({"fixes", "ranges"} & {*tables})
    if walks:
        lines = [line for line in lines if not line.endswith(LEVEL_NOTE)]  # a tilt that nothing measures stays open
        lines += ["[motion]   # no columns look like a DVL: between two fixes the vehicle may go anywhere", WALK, ""]
    for table in ("dvl", "ahrs", "depth"):
        if table not in tables and not walks:
            lines += [f"# [{table}]   # no columns look like it; nls solve needs it, or [path], or [motion]", ""]
    return "\n".join([*lines, _noise(("dvl", "ahrs", "depth") if not walks else tables)])


def _noise(tables: Collection[str]) -> str:
    """The noise of the sensors that a mission has."""
    head, *lines = NOISE.splitlines(keepends=True)
    used = [line for line, table in zip(lines, NOISE_OF, strict=True) if table in tables]
    return "".join([head, *used] if used else [])


def _of_text(log: TextLog, named: bool, tables: list[str], tilted: bool) -> list[str]:
    """The sections of a text file; where no log is `tilted`, a heading alone is an attitude."""
    lines = [f"# {log.title} has: {', '.join(map(repr, log.names))}"]
    used: set[str] = set()
    drafted = len(tables)
    for table, (needed, possible) in TABLES.items():
        chosen: dict[str, str] = {}
        for column in (*needed, *possible):
            names = guesses(column, log.names, [*chosen.values(), *_heights(log)])
            if column == "time_s":
                names.sort(key=lambda name: not _is_stamp(log, name))
            if names:
                chosen[column] = names[0]
        chosen_places = {column: name for column in GEODETIC if (name := guess(column, log.names)) is not None}
        if table == "truth" and chosen_places:
            chosen = {name: value for name, value in chosen.items() if name not in ("x_m", "y_m")} | chosen_places
            needed = ("time_s", *ANGLES, *GEODETIC, "z_m")
        if table == "ahrs" and not tilted:
            needed = ("time_s", "yaw_rad")
        if table in ("dvl", "depth", "fixes") and table not in tables and {*needed} - {*chosen} == {"time_s"}:
            lines.append(f"# [{table}]   # {', '.join(map(repr, chosen.values()))}: no column looks like their time")
        if table in tables or not set(needed) <= set(chosen):
            continue
        pose = all(guess(column, log.names) for column in (*ANGLES, "z_m"))
        whole = {*ANGLES, *PLACE} <= set(chosen) and "odo" not in plain(chosen["x_m"])
        acoustic = "beacon" in chosen or "slant" in plain(chosen.get("range_m", "")).split()
        path = "path" in (tables[drafted:] if table == "truth" else tables)  # which has the columns of the others
        if {
            "fixes": pose and "dvl" in tables,  # a whole pose beside a DVL is a truth
            "truth": path or "fixes" in tables[drafted:],
            "path": whole or "dvl" in tables,  # sensors measure the way; not called odometry, a whole pose is a truth
            "ranges": "contacts" in tables or not acoustic,  # one of an echo sounder, or a setting of the sonar
        }.get(table, path and table in ("ahrs", "depth")):
            continue
        tables.append(table)
        used |= set(chosen.values())
        lines += [f"[{table}]", *([f"file = {json.dumps(log.title)}   # {OF_ONE_LOG}"] if named else [])]
        lines += [_line(column, chosen, log) for column in chosen]
        if table == "ahrs":
            lines += [f"{angle} = 0.0   # {LEVEL_NOTE}" for angle in ANGLES if angle not in chosen]
        if table == "ranges" and "beacon" not in chosen:
            lines.append("beacon = 1   # no column looks like it: the number of the one beacon")
        lines += [*_numbers(table), ""]
        if table == "contacts":
            sonar = [(f"{name} = {example('sonar', name)}", REMARKS.get(name, "")) for name in COLUMNS["sonar"]]
            lines += ["[sonar]   # from its data sheet, and where it is on the vehicle"]
            lines += [*(f"{line}   # {remark}" if remark else line for line, remark in sonar), ""]
    unused = [name for name in log.names if name not in used]
    if unused:
        lines = [*lines[: -1 if lines[-1] == "" else None], f"# not used: {', '.join(map(repr, unused))}", ""]
    return lines


def _is_stamp(log: Log, name: str) -> bool:
    """Whether the first cell of a column is a date, or a number of seconds since 1970."""
    word = next((word for word in log.words(name) if word), "")
    try:
        return float(word) > EPOCH  # also in other units
    except ValueError:
        return ":" in word


def _heights(log: Log) -> list[str]:
    """Columns with the height over the bottom, which a DVL measures."""
    names = [name for name in log.names if {"altitude", "height", "alt"} & {*plain(name).split()}]
    return [name for name in names if guess("vx_m_s", log.names) and "relative" not in plain(name)]


def _numbers(table: str) -> list[str]:
    """The lines of a section that are no columns of the log: the sigmas that its table needs."""
    sigmas = [name for name in COLUMNS[table] if name.startswith("sigma_") and name not in OPTIONAL[table]]
    sigmas += ["sigma_range_m"] * (table == "ranges")  # or that of a travel time
    remark = "   # a guess, as are the next; of one step" if table == "path" else "   # a guess"
    numbers = [f"{column} = {example(table, column)}" for column in sigmas]
    return [numbers[0] + remark, *numbers[1:]] if numbers else []


def _line(column: str, chosen: dict[str, str], log: Log) -> str:
    """A line of a mapping; says which unit is taken where the log names none."""
    name = chosen[column]
    quoted = CONTROLS.sub(lambda control: f"\\u{ord(control[0]):04x}", json.dumps(name, ensure_ascii=False))
    words = set(plain(name).split())
    kind, own = mission_unit(column)
    if column == "z_m" and {"altitude", "height", "alt"} & words:
        return f"z_m = {{ column = {quoted}, up = true }}   # z is down; up = false if it is depth"
    keys, remarks = f"column = {quoted}", ""
    if kind and kind != "time" and not (log.units.get(name) or header_unit(name)[0]):
        unit, why = own, "its header names no unit"
        if own == "rad" and _in_degrees(chosen, log):
            unit, why = "deg", "by the size of its angles"
        if column in LARGEST and np.nanmax(np.abs(log.numbers(name)), initial=0.0) > LARGEST[column]:
            unit, why = "ddmm", "by the size of its numbers: degrees and minutes"
        keys, remarks = f'{keys}, unit = "{unit}"', f"   # {why}"
    if kind == "velocity" and {"port", "up"} & words:
        keys, remarks = f"{keys}, sign = -1", f"{remarks}   # {AXES[column]}"
    value = f"{{ {keys} }}" if remarks else quoted
    return f"{column} = {value}{remarks}{_constant(log, name)}"


def _in_degrees(chosen: dict[str, str], log: Log) -> bool:
    """Whether an angle without a unit is too large for radians: then all of the table are in degrees."""
    names = [name for column, name in chosen.items() if mission_unit(column)[1] == "rad"]
    sizes = [np.abs(log.numbers(name)) for name in names if not header_unit(name)[0]]
    return any(float(np.nanmax(size, initial=0.0)) > 2 * np.pi for size in sizes)


def _constant(log: Log, name: str) -> str:
    """A mark on a column whose cells are all the same: the sensor may not have it."""
    words = set(log.words(name))
    return f"   # all its cells are {words.pop()}" if len(words) == 1 and len(log) > 1 else ""


def _of_bag(bag: Bag, tables: list[str]) -> list[str]:
    """The sections of a bag, by the types of its messages."""
    lines = [f"# {Path(bag.path).name}"]
    for topic, (kind, count) in bag.topics.items():
        log = bag.log(topic, 1)
        section = MESSAGES.get(kind.rsplit("/", 1)[-1])
        table = section[0].split("]")[0][1:] if section else ""
        fields = ", ".join(map(repr, log.names[:30]))
        lines.append(f"# topic {topic!r}, {count} messages of {kind}: {fields}")
        if section is None or table in tables:
            continue
        tables.append(table)
        stamp = next((name for name in log.names if name.endswith("stamp")), "bag_time")
        lines += [section[0], f"topic = {json.dumps(topic)}", f'time_s = "{stamp}"', *section[1:], ""]
    return [*lines, ""]
