"""Headers of a log: the units that they name, and which column of a mission each may be.

A header names its unit in brackets at its end, ``Roll [deg]`` or ``speed (m/s)``, or behind its last underscores,
``depth_mm`` or ``v_mm_s``.
"""

import math
import re
from collections.abc import Sequence
from difflib import get_close_matches

import numpy as np

from models.algebra import Array
from nls.missions.folder.columns import OF_ENDS

FOOT, KNOT = 0.3048, 1852 / 3600  # m, m/s
UNITS: dict[str, dict[str, float]] = {  # by dimension, in SI units
    "velocity": {"m/s": 1, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": 1 / 3.6, "kn": KNOT, "ft/s": FOOT},
    "length": {"m": 1, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": FOOT, "fathom": 6 * FOOT, "nmi": 1852.0},
    "angle": {
        **{"rad": 1, "deg": math.pi / 180, "mrad": 1e-3, "gon": math.pi / 200},
        **{"cdeg": math.pi / 180e2, "degE7": math.pi / 180e7, "ddmm": math.pi / 180},
    },
    "rate": {"rad/s": 1, "deg/s": math.pi / 180, "mrad/s": 1e-3},
    "time": {"s": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60, "h": 3600, "day": 86400},
    "pressure": {"Pa": 1, "hPa": 100, "mbar": 100, "kPa": 1e3, "dbar": 1e4, "bar": 1e5, "psi": 6894.757293168},
    "fraction": {"1": 1, "%": 1e-2, "ppm": 1e-6},
}
ALIASES = {
    **dict.fromkeys(("mps", "m/sec", "ms-1", "m s-1", "m.s-1", "m s^-1"), "m/s"),
    **dict.fromkeys(("knot", "knots", "kt", "kts"), "kn"),
    **dict.fromkeys(("kmh", "kph", "km/hr"), "km/h"),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("feet", "foot"), "ft"),
    **dict.fromkeys(("degree", "degrees", "°", "degs", "degrees_north", "degrees_east"), "deg"),
    **dict.fromkeys(("centidegree", "centidegrees", "deg*100"), "cdeg"),
    **dict.fromkeys(("deg*1e7", "1e-7deg", "1e-7 deg"), "degE7"),
    "days": "day",
    **dict.fromkeys(("radian", "radians", "rads"), "rad"),
    **dict.fromkeys(("dps", "°/s", "deg/sec"), "deg/s"),
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("µs", "μs", "usec", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nanosecond", "nanoseconds", "nanosec"), "ns"),
    **dict.fromkeys(("pascal", "pa"), "Pa"),
    **dict.fromkeys(("percent",), "%"),
    **{unit.lower(): unit for units in UNITS.values() for unit in units},
}
MINUTES = re.compile(r"d{2,3}mm(\.m+)?", re.I)
IN_BRACKETS = r"[\[(<{]\s*([^\[\](){}<>]+?)\s*[\])>}]"
BRACKET = re.compile(IN_BRACKETS + r"\s*$")


def mission_unit(column: str) -> tuple[str, str]:
    """The dimension of a mission column and its unit there; empty where it is a plain number.

    Examples
    --------
    >>> mission_unit("vx_m_s"), mission_unit("lat_deg"), mission_unit("valid")
    (('velocity', 'm/s'), ('angle', 'deg'), ('', ''))
    """
    return next((kind, unit) for end, kind, unit, *_ in OF_ENDS if column.endswith(end))


def dimension(unit: str) -> str:
    """The dimension of a unit under any of its names; empty where it is none.

    Examples
    --------
    >>> dimension("knots"), dimension("Degrees"), dimension("furlong")
    ('velocity', 'angle', '')
    """
    name = _plain(unit)
    return next((kind for kind, units in UNITS.items() if name in units), "")


def factor(unit: str, column: str) -> float:
    """Size of this unit in the unit of a mission column of the same dimension.

    Examples
    --------
    >>> factor("mm/s", "vx_m_s"), factor("deg", "lat_deg"), round(factor("deg", "yaw_rad"), 6)
    (0.001, 1.0, 0.017453)
    """
    kind, own = mission_unit(column)
    name = _plain(unit)
    return 1.0 if name == own else UNITS[kind][name] / UNITS[kind][own]


def convert(numbers: Array, unit: str, column: str) -> Array:
    """Numbers (n,) of a unit in that of a mission column; ``ddmm`` are degrees times 100 plus minutes, as of NMEA.

    Raises
    ------
    ValueError
        A number (row, sentence) that has 60 minutes or more.

    Examples
    --------
    >>> convert(np.array([4736.6, -12221.0]), "ddmm.mmmm", "lat_deg").round(9).tolist()
    [47.61, -122.35]
    """
    if _plain(unit) == "ddmm":
        minutes = np.fmod(numbers, 100)
        if (bad := np.abs(minutes) >= 60).any():
            k = int(np.argmax(bad))
            expected = "expected less than 60 (ddmm.mmmm)"
            raise ValueError(k, f"{numbers[k]:.10g} has {abs(minutes[k]):.6g} minutes, {expected}")
        numbers = np.trunc(numbers / 100) + minutes / 60
    size = factor(unit, column)
    return numbers if size == 1.0 else numbers * size


def header_unit(header: str) -> tuple[str, bool]:
    """The unit that a header names and whether it stands in brackets; empty where it names none.

    Examples
    --------
    >>> header_unit("Roll [deg]"), header_unit("v_mm_s"), header_unit("field.depth"), header_unit("state [raw]")
    (('deg', True), ('mm/s', False), ('', False), ('raw', True))
    """
    if known := [text for text in re.findall(IN_BRACKETS, header) if dimension(text)]:
        return known[-1], True  # "height [m] (filtered)"
    if bracket := BRACKET.search(header):
        return bracket[1], True
    words = header.strip().split("_")
    for count in (2, 1):
        name = "/".join(words[-count:])
        if len(words) > count and dimension(name):
            return _plain(name), False
    return "", False


def _plain(unit: str) -> str:
    """The name that `UNITS` has for a unit."""
    text = "ddmm" if MINUTES.fullmatch(unit.strip()) else unit.strip()
    return text if any(text in units for units in UNITS.values()) else ALIASES.get(text.lower(), text)


# --- which column of a mission: for drafts and for advice, never used in silence --------------------------------------

ABBREVIATIONS = {"fwd": "forward", "stbd": "starboard", "hdg": "heading", "bt": "bottom", "wt": "water"}
AXIS = r"(?:dvl|vel(?:ocity)?|v|speed|bottom|body|inst(?:rument)?|linear)"
PATTERNS: dict[str, tuple[str, ...]] = {  # by mission column, the best first; of names as `plain` makes them
    "time_s": (
        *(r"time", r"(?:time ?)?stamp", r"header stamp", r".*\b(?:time ?)?stamp"),
        *(r"(?:utc|date ?time|epoch|t)", r".*\btime\b.*", r".*\bdate\b.*"),
    ),
    "valid": (r".*\b(?:velocity|bottom|dvl)\b.*\b(?:valid|lock)", r".*\b(?:valid|lock|flag)"),
    "roll_rad": (r"roll", r".*\broll"),
    "pitch_rad": (r"pitch", r".*\bpitch"),
    "yaw_rad": (r"yaw", r"heading", r".*\b(?:true heading|heading true)", r".*\b(?:yaw|heading)"),
    "z_m": (r"depth", r".*\bdepth", r"altitude relative", r"altitude", r"height", r"z", r".*\bposition z"),
    "x_m": (r"x", r"north(?:ing)?", r".*\bposition x", r".*\bx", r"x odo\w*"),
    "y_m": (r"y", r"east(?:ing)?", r".*\bposition y", r".*\by", r"y odo\w*"),
    "lat_deg": (r"lat(?:itude)?", r".*\blat(?:itude)?"),
    "lon_deg": (r"lon(?:gitude)?|lng", r".*\b(?:lon(?:gitude)?|lng)"),
    "range_m": (r"(?:slant )?range", r"distance", r".*\b(?:range|distance).*"),
    "azimuth_rad": (r"azimuth", r"bearing", r".*\b(?:azimuth|bearing)"),
    "landmark": (r"(?:landmark|target|feature)(?: id)?",),
    "beacon": (r"(?:beacon|transponder)(?: id)?",),
    "sound_speed_m_s": (r".*sound.*(?:speed|velocity).*", r".*\bsvp?\b.*"),
}
VELOCITIES = {  # by column: its letter, its number, words in front and behind, another form
    "vx_m_s": ("x", 0, "surge|forward", "surge|forward", r".*\bu"),
    "vy_m_s": ("y", 1, "sway|starboard", "sway|starboard|port", rf"port {AXIS}"),
    "vz_m_s": ("z", 2, "heave", "heave|down|up", rf"(?:down|up) {AXIS}"),
}
PATTERNS |= {
    column: (
        *(rf".*\b{AXIS} ?(?:{letter}|{number})", rf"(?:{front})\b.*", rf".*\b{AXIS} (?:{behind})"),
        *(other, rf".*{AXIS}.*\b{letter}", rf".*\blinear {letter}"),
    )
    for column, (letter, number, front, behind, other) in VELOCITIES.items()
}
OTHER = {  # names that are something else: no velocity along own axes, no bottom lock
    "velocity": re.compile(r"\b(north|east|earth|local|ned|enu|map|world|imu|acc\w*|gyro|angular|water|air)\b"),
    "": re.compile(r"\b(gps|gnss|fix)\b"),
}
WISHED = re.compile(r"\b(c|cmd|command(?:ed)?|set ?point|desired|target|goal|way ?point|wpt)\b")  # last, if at all
WORLD = re.compile(rf"\b{AXIS} (?:north|east)|\b(?:north|east) {AXIS}")  # then down and up are of the world, too


def plain(name: str) -> str:
    """A header as words: without unit and signs, in lower case.

    Examples
    --------
    >>> plain("DVL X [m/s]"), plain("field.velocityInst0"), plain("v_mm_s"), plain("BT_Vel_Fwd")
    ('dvl x', 'field velocity inst 0', 'v', 'bottom vel forward')
    """
    unit, bracket = header_unit(name)
    text = BRACKET.sub("", name) if bracket else name
    if unit and not bracket:
        text = text[: -len(unit) - 1]
    text = re.sub(r"(?<=[a-z])(?=[A-Z0-9])", " ", text)
    words = re.findall(r"[a-z0-9]+", text.lower())
    return " ".join(ABBREVIATIONS.get(word, word) for word in words)


def guess(column: str, names: Sequence[str]) -> str | None:
    """The column of a log that is most likely a mission column; None where none looks like it.

    Examples
    --------
    >>> guess("vx_m_s", ["Time [s]", "DVL X [m/s]", "V East [m/s]"]), guess("z_m", ["Time [s]"])
    ('DVL X [m/s]', None)
    """
    return next(iter(guesses(column, names)), None)


def guesses(column: str, names: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """All columns of a log that may be a mission column, the most likely first; what was commanded comes last."""
    kind = mission_unit(column)[0]
    fitting = [name for name in names if name not in taken and dimension(header_unit(name)[0]) in ("", kind)]
    if column == "valid" or kind == "velocity":
        fitting = [name for name in fitting if not OTHER[kind].search(plain(name))]
    if kind == "velocity" and any(WORLD.search(plain(name)) for name in names):
        fitting = [name for name in fitting if not {"down", "up"} & set(plain(name).split())]
    fitting.sort(key=lambda name: bool(WISHED.search(plain(name))))
    out = [column] if column in fitting else []
    out += [n for pattern in PATTERNS.get(column, ()) for n in fitting if re.fullmatch(pattern, plain(n))]
    return list(dict.fromkeys(out))


def nearest(column: str, name: str, names: Sequence[str]) -> str | None:
    """The column of a log that a misspelt name is closest to; else the one a mission column may be."""
    close = get_close_matches(name, names, 1)
    return close[0] if close else guess(column, names)
