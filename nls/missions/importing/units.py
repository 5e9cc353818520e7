"""Units: those that a header or a mapping names, and the factor to the unit that the name of a mission column says.

A header names its unit in brackets at its end, ``Roll [deg]`` or ``speed (m/s)``, or behind its last underscores,
``depth_mm`` or ``v_mm_s``.
"""

from __future__ import annotations

import math
import re

import numpy as np

from models.algebra import Array
from nls.missions.folder.columns import OF_ENDS

__all__ = ["convert", "dimension", "factor", "header_unit", "known_units", "mission_unit"]

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


def known_units(kind: str) -> str:
    """The units of a dimension, for messages."""
    return ", ".join(UNITS[kind]) if kind else "none: it is a plain number"


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
            raise ValueError(
                k, f"{numbers[k]:.10g} has {abs(minutes[k]):.6g} minutes, expected less than 60 (ddmm.mmmm)"
            )
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
