"""Findings about the tables of a mission in words; no other file has these sentences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nls.io.mission.checks.findings import Cause, Implausible, Reading

__all__ = ["record", "sentence"]
UNITS = {  # of a column by the end of its name: what a number is that is so many times too large
    "_m_s": {1000.0: "mm/s", 100.0: "cm/s", 1.9438: "kn", 3.2808: "ft/s", 3.6: "km/h"},
    "z_m": {100.0: "cm", 1000.0: "mm", 3.2808: "ft", 10.0: "kPa", 1e4: "Pa", 0.1: "bar", 0.001: "km", 0.01: "hm"},
    "_m": {1000.0: "mm", 100.0: "cm", 3.2808: "ft", 0.001: "km"},
    "_rad": {180 / 3.141592653589793: "deg"},
    "travel_time_s": {1e3: "ms", 1e6: "us"},
    "time_s": {1e3: "ms", 1e6: "us", 1e9: "ns"},
}
NUMBERS = {  # of a check: what was measured, and what its limit is
    "speed": "the middle speed is {measured}; a vehicle stays below {limit}",
    "zeros": "{measured} with bottom lock have a velocity of 0, between others that move",
    "bottom lock": "valid is 1 in {percent} of the rows, and the rows of 0 are smooth",
    "tilt": "a fifth of the log is beyond {measured}; a vehicle stays within {limit}",
    "turn rate": "a tenth of the log turns faster than {measured}; a vehicle stays below {limit}",
    "depth": "a depth of {measured}; expected {side} {limit}",
    "depth rate": "the depth changes by {measured}; a vehicle stays below {limit}",
    "time step": "the middle time between two rows is {measured}; expected {side} {limit}",
    "outliers": "{percent} of the rows are far from the rows beside them; expected below {limit_percent}",
    "scatter": "its rows scatter by {measured}, {ratio} times the sigma stated in noise.csv; expected below {limit}",
    "sound speed": "it is {measured}; water has 1400 to 1600 m/s",
    "far away": "the middle fix is {measured} from x = y = 0; expected below {limit}",
    "jumps": "{percent} of the fixes jump away from those before and after; expected below {limit_percent}",
    "range": "the middle range is {measured} times the distance by dead reckoning; expected 0.8 to 1.25",
    "way down": "depth and DVL disagree about the way down by {percent} of it; expected below {limit_percent}",
    "way between fixes": "fixes and DVL disagree about the way by {percent} of it; expected below {limit_percent}",
}
CAUSES = {
    Cause.SWAPPED: "{column} of {file} look exchanged: exchange the names of the columns",
    Cause.INVERTED: "{column} of {file} looks inverted: write 1 with bottom lock and 0 without",
    Cause.ZEROS: "rows of {file} without bottom lock count as valid: write {column} 0 there",
    Cause.STUCK: "the sensor of {file} looks stuck, or the column was filled: log it again",
    Cause.OUTLIERS: "{column} of {file} has outliers: delete these rows, or give them no weight",
    Cause.SIGMA: "{column} of {file} looks {ratio} times too small: a variance, or degrees?",
    Cause.FAR: "the origin looks wrong: give the latitude and longitude of the site in origin.csv",
    Cause.WAYS: "{column} of {file} is of both ways and taken as one, or the other way around: give the column ways",
    Cause.UNKNOWN: "none of the usual mistakes explains it: check units, signs, axes and times of {file}",
}


def sentence(finding: Implausible) -> str:
    """A finding in words: where, which number, what is expected, what the cause is and what to do."""
    measured, limit = (f"{number:.4g} {finding.unit}".strip() for number in (finding.measured, finding.limit))
    numbers = NUMBERS[finding.check].format(
        measured=measured,
        limit=limit,
        percent=f"{100 * finding.measured:.3g} %",
        limit_percent=f"{100 * finding.limit:.3g} %",
        side="below" if finding.measured > finding.limit else "above",
        ratio=f"{finding.readings[0].factor:.3g}",
    )
    causes = "; or ".join(cause(reading) for reading in finding.readings)
    return f"{finding.place}: {finding.column} is implausible: {numbers}. Probable cause: {causes}"


def record(finding: Implausible) -> dict[str, Any]:
    """A finding for programs, and in words."""
    return finding.numbers | {"sentence": sentence(finding)}


def cause(reading: Reading) -> str:
    """The cause and what to do."""
    of = {"column": reading.column, "file": reading.file, "ratio": f"{reading.factor:.2g}"}
    return CAUSES[reading.cause].format(**of) if reading.cause in CAUSES else DETAILED[reading.cause](reading)


def _unit(r: Reading) -> str:
    units = next(units for end, units in UNITS.items() if r.column.endswith(end))
    name = next((unit for factor, unit in units.items() if abs(factor / r.factor - 1) < 1e-3), "")
    looks = f"looks like {name}" if name else "looks like another unit"
    if len(r.column.split(", ")) > 1:
        looks = looks.replace("looks", "look")
    act = f"divide by {r.factor:.5g}" if r.factor > 1 else f"multiply by {1 / r.factor:.5g}"
    mapping = f', or unit = "{name}" in the mapping of nls import' if name else ""
    return f"{r.column} of {r.file} {looks}: {act}{mapping}"


def _sign(r: Reading) -> str:
    positive = {
        "z_m": "z is down",
        "vz_m_s": "vz is down",
        "vy_m_s": "vy is to starboard",
        "vx_m_s": "vx is ahead",
        "pitch_rad": "pitch is positive with the bow up",
        "roll_rad": "roll is positive with the starboard side down",
        "yaw_rad": "yaw is clockwise from north",
        "x_m": "x is north",
        "y_m": "y is east",
    }[r.column]
    return f"{r.column} of {r.file} looks as if it had the other sign: multiply by -1; {positive}"


def _axes(r: Reading) -> str:
    return (
        f"{r.column} of {r.file} look like axes ahead, port and up: change the sign of the second and third, or "
        'frame = "FLU" in the mapping of nls import'
    )


def _turned(r: Reading) -> str:
    if r.file == "dvl.csv":
        return f"the axes of the DVL look turned by {r.factor:.3g} deg: write yaw_rad {_rad(r)} in dvl_mount.csv"
    return f"{r.column} of {r.file} looks {r.factor:.3g} deg too large: subtract {_rad(r)}"


def _rad(r: Reading) -> str:
    return f"{r.factor * 3.141592653589793 / 180:.4f}"


def _north(r: Reading) -> str:
    return (
        f"{r.column} of {r.file} looks counted from east, counterclockwise: write pi/2 - yaw, or "
        'frame = "ENU" in the mapping of nls import'
    )


def _clock(r: Reading) -> str:
    late, act = ("late", "subtract") if r.factor > 0 else ("early", "add")
    return f"times of {r.file} look about {abs(r.factor):.3g} s {late}: {act} {abs(r.factor):.3g} s, or set both clocks"


DETAILED: dict[Cause, Callable[[Reading], str]] = {
    Cause.UNIT: _unit,
    Cause.SIGN: _sign,
    Cause.AXES: _axes,
    Cause.TURNED: _turned,
    Cause.NORTH: _north,
    Cause.CLOCK: _clock,
}
