"""Findings about the tables of a mission in words; no other file has these sentences."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from models.listing import several
from nls.missions.checks.findings import Cause, Explained, Implausible, Reading, Trial
from nls.missions.checks.special import meant
from nls.missions.folder.calibration import NAMES, wide

__all__ = ["record", "sentence"]
COARSE = 1.0  # s: sigma of a lag that is one of a list
LISTED = 100  # runs of lines
PERIODS = ((604800, "week"), (86400, "day"), (3600, "hour"), (1800, "half-hour"))
LEAPS = {18.0: "GPS time and not UTC", 37.0: "TAI and not UTC", 19.0: "TAI and not GPS time"}
UNITS = {  # of a column by the end of its name: what a number is that is so many times too large
    "_m_s": {1000.0: "mm/s", 100.0: "cm/s", 1.9438: "kn", 3.2808: "ft/s", 3.6: "km/h"},
    "z_m": {100.0: "cm", 1000.0: "mm", 3.2808: "ft", 0.5468: "fathom", 0.001: "km", 0.01: "hm"}
    | {10.0: "kPa", 1e4: "Pa", 0.1: "bar"},
    "_m": {1000.0: "mm", 100.0: "cm", 3.2808: "ft", 0.001: "km"},
    "_rad": {180 / math.pi: "deg", 18000 / math.pi: "cdeg", math.pi / 180: "rad"},
    "_pa": {1.0: "dbar", 10.0: "kPa", 100.0: "hPa", 1e4: "Pa"},
    "_deg": {math.pi / 180: "rad"},
    "travel_time_s": {1e3: "ms", 1e6: "us"},
    "time_s": {1e3: "ms", 1e6: "us", 1e9: "ns", 1 / 86400: "day"},
}
NUMBERS = {  # of a check: what was measured, and what its limit is
    "speed": "the middle speed is {measured}; a vehicle stays below {limit}",
    "special value": "{rows} with {measured} are far from the rows around them",
    "bottom lock": "valid is 1 in {percent} of the rows, and the rows of 0 are smooth",
    "heading": "the vehicle goes ahead by {percent}, of its way beside its heading; expected above {limit_percent}",
    "stale": "{rows} repeat a fix while the vehicle goes {measured}",
    "repeated": "{rows} repeat a number, {measured} long, while the vehicle moves",
    "tilt": "a fifth of the log is beyond {measured}; a vehicle stays within {limit}",
    "turn rate": "a tenth of the log turns faster than {measured}; a vehicle stays below {limit}",
    "depth": "a depth of {measured}; expected {side} {limit}",
    "stuck": "it is {measured} in all rows, and the vehicle moves",
    "depth rate": "the depth changes by {measured}; a vehicle stays below {limit}",
    "time step": "the middle time between two rows is {measured}; expected {side} {limit}",
    "span": "its times span {measured} times those of the track; expected about 1, or less",
    "late": "it begins {measured} after the track; expected within the track",
    "under water": "{measured} fixes are more than 2 m under water at their times; expected none of a receiver",
    "surface": "the vehicle has fixes where it is {measured}, and none deeper; expected below {limit}",
    "outliers": "{percent} of the rows are far from the rows beside them; expected below {limit_percent}",
    "scatter": "its rows scatter by {measured}, {ratio} times the sigma stated in noise.csv; expected below {limit}",
    "sound speed": "it is {measured}; water has 1400 to 1600 m/s",
    "far away": "the middle fix is {measured} from x = y = 0; expected below {limit}",
    "jumps": "{percent} of the fixes jump away from those before and after; expected below {limit_percent}",
    "way down": "depth and DVL disagree about the way down by {percent} of it; expected below {limit_percent}",
}
CAUSES = {
    Cause.INVERTED: "{column} of {file} looks inverted: write 1 with bottom lock and 0 without",
    Cause.STALE: "{column} of {file} repeat while the vehicle moves: leave out {lines} of {file}",
    Cause.STUCK: "the sensor of {file} looks stuck, or the column was filled: log it again",
    Cause.OUTLIERS: "{column} of {file} {has} outliers: {act}, or give them no weight",
    Cause.SIGMA: "{column} of {file} looks {ratio} times too small (or a variance): multiply {column} by {ratio}",
    Cause.SCALE: "{column} of {file} looks {factor:.4g} times too large: divide {column} by {factor:.4g}",
    Cause.SWAPPED: "{column} of {file} look exchanged: exchange the names of {column}{origin}",
    Cause.FAR: "the origin looks wrong: give the latitude and longitude of the site in origin.csv",
    Cause.UNKNOWN: "none of the usual mistakes explains it: check units, signs, axes and times of {file}",
}


def sentence(finding: Implausible | Explained) -> str:
    """A finding in words: where, which number, what is expected, what the cause is and what to do."""
    if isinstance(finding, Explained):
        return _explained(finding)
    measured, limit = (f"{number:.4g} {finding.unit}".strip() for number in (finding.measured, finding.limit))
    numbers = NUMBERS[finding.check].format(
        measured=measured,
        limit=limit,
        percent=f"{100 * finding.measured:.3g} %",
        limit_percent=f"{100 * finding.limit:.3g} %",
        side="below" if finding.measured > finding.limit else "above",
        ratio=f"{finding.readings[0].factor:.3g}",
        rows=several(len(finding.lines), "row"),
    )
    rows = lines(finding.lines) if finding.lines else ""
    causes = "; or ".join(cause(reading, rows) for reading in finding.readings)
    return f"{finding.place}: {finding.column} is implausible: {numbers}. Probable cause: {causes}"


def record(finding: Implausible | Explained) -> dict[str, Any]:
    """A finding for programs, and in words."""
    return finding.numbers | {"sentence": sentence(finding)}


def lines(numbers: Sequence[int]) -> str:
    """Lines of a file: the first of their runs, and how many more there are.

    Examples
    --------
    >>> lines([7, 8, 9, 10, 14]), lines([3])
    ('lines 7 to 10, 14', 'line 3')
    """
    runs = np.split(np.array(numbers), np.flatnonzero(np.diff(numbers) > 1) + 1)
    words = [f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs[:LISTED]]
    more = sum(map(len, runs[LISTED:]))
    return f"line{'s' * (len(numbers) > 1)} {', '.join(words)}{f' and {more} more' if more else ''}"


def cause(reading: Reading, rows: str = "") -> str:
    """The cause and what to do; rows are the lines that it is about."""
    if reading.cause in (Cause.NONE, Cause.ZEROS):
        return f"{_none(reading)}, or leave out {rows} of {reading.file}"
    of = {"column": reading.column, "file": reading.file, "factor": reading.factor, "lines": rows}
    of["ratio"] = f"{float(f'{reading.factor:.2g}'):g}"
    of |= {"has": "have" if ", " in reading.column else "has", "origin": _origin(reading)}
    of["act"] = f"leave out {rows} of {reading.file}" if rows else "delete these rows"
    return CAUSES[reading.cause].format(**of) if reading.cause in CAUSES else DETAILED[reading.cause](reading)


def _none(r: Reading) -> str:
    names = r.column.split(", ")
    numbers = {name: ", ".join(f"{number:.10g}" for number in meant(name, r.factor)) for name in names}
    keys = ", ".join(f"{name} = [{text}]" if "," in text else f"{name} = {text}" for name, text in numbers.items())
    option = "missing" if r.cause is Cause.NONE or len(names) == 1 else "missing_together"
    cure = _key(r, f"{option} = {{ {keys} }}")
    return f"no {r.column} was measured there: {cure}"


def _unit(r: Reading) -> str:
    units = next(units for end, units in UNITS.items() if r.column.endswith(end))
    name = next((unit for factor, unit in units.items() if abs(factor / r.factor - 1) < 1e-3), "")
    looks = f"{'look' if ', ' in r.column else 'looks'} like {name or 'another unit'}"
    digits = 5 if not _origin(r) else 10
    act = f"multiply {r.column} by {1 / r.factor:.{digits}g}{_origin(r)}"
    if r.factor > 1:
        act = f"divide {r.column} by {r.factor:.{digits}g}"
    mapping = _mapped(r, f'unit = "{name}"', r.column) if name else ""
    return f"{r.column} of {r.file} {looks}: {act}{mapping}"


def _mapped(r: Reading, key: str, column: str = "") -> str:
    """The key of a mapping that cures as well."""
    return f", or {_key(r, key, column)}"


def _key(r: Reading, key: str, column: str = "") -> str:
    return f"write `{key}`{f' for {column}' if column else ''} in [{r.file.removesuffix('.csv')}] of the mapping"


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
        "lat_deg": "latitudes are north",
        "lon_deg": "longitudes are east",
    }.get(r.column, "")
    looks = "look as if they" if ", " in r.column else "looks as if it"
    return (
        f"{r.column} of {r.file} {looks} had the other sign: multiply {r.column} by -1{_origin(r)}"
        f"{_mapped(r, 'sign = -1', r.column)}{f'; {positive}' if positive else ''}"
    )


def _origin(r: Reading) -> str:
    """Where latitudes and longitudes stand besides."""
    return ", in origin.csv as well" if r.column.startswith(("lat_deg", "lon_deg")) else ""


def _axes(r: Reading) -> str:
    act = f"multiply {r.column.partition(', ')[2]} by -1, or " if ", " in r.column else ""
    return f"{r.column} of {r.file} look like axes ahead, port and up: {act}{_frame(r, 'FLU')}"


def _north(r: Reading) -> str:
    if r.column == "bearing_rad":
        return f"{r.column} of {r.file} looks counted from north: take the heading of the ship from it"
    looks = "looks" if r.column == "yaw_rad" else "look"
    east = f"{r.column} of {r.file} {looks} counted from east, counterclockwise"
    if r.column != "yaw_rad":  # the pitch has its sign, too
        return f"{east}, as of axes ENU and FLU: {_frame(r, 'ENU')}"
    return f"{east}: multiply yaw_rad by -1, then add 1.5708 to it{_mapped(r, 'sign = -1, offset = 1.5708', 'yaw_rad')}"


def _frame(r: Reading, frame: str) -> str:
    return _key(r, f'frame = "{frame}"')


def _pressure(r: Reading) -> str:
    air, name = f"{10.1325 * r.factor:.6g}", UNITS["_pa"][r.factor]
    divide, scale = (f" and divide by {r.factor:g}", f"`scale = {1 / r.factor:g}` and ") if r.factor > 1 else ("", "")
    return (
        f"z_m of {r.file} looks like absolute pressure in {name}: subtract {air} from z_m{divide}, or write {scale}"
        f"`offset = -10.1325` for z_m in [{r.file.removesuffix('.csv')}] of the mapping"
    )


def _earth(r: Reading) -> str:
    axes, act = "north, east and down", ""
    if r.factor < 0:
        axes, act = "east, north and up", "exchange the names of vx_m_s, vy_m_s, multiply vz_m_s by -1, and "
    return (
        f"{r.column} of {r.file} look like velocities {axes}: {act}write `earth_axes = 1` in [dvl] of the mapping, or "
        f"give {r.file} a column earth_axes of 1"
    )


def _clock(r: Reading) -> str:
    size = f"{abs(r.factor):.3g} s"
    late, act = ("late", f"subtract {size} from") if r.factor > 0 else ("early", f"add {size} to")
    looks = f"times of {r.file} look about {size} {late}"
    if (name := f"{r.file.removesuffix('.csv')}_clock_s") in NAMES:
        return f"{looks}: {_row(name, r.factor, COARSE)}"
    return f"{looks}: {act} time_s{_mapped(r, f'offset = {-r.factor:.3g}', 'time_s')}"


def _fast(r: Reading) -> str:
    if r.column == "yaw_rad":
        drift = f"{math.degrees(60 * r.factor):.2g} deg a minute"
        return f"yaw_rad of {r.file} drifts by {drift}: log it by another compass"
    act = f"divide time_s by {1 + r.factor:.12g}, then add {r.offset:.6f} s to it"
    return f"the clock of {r.file} looks {100 * r.factor:.2g} % fast: {act}"


def _arm(trial: Trial) -> str:
    r, size = trial.reading, f"{abs(trial.reading.factor):.2g}"
    looks, act, of = ("large", "subtract", "from") if r.factor > 0 else ("small", "add", "to")
    without = "; without that file it is 0" if r.file == "dvl_mount.csv" else ""
    looking = f"looks {size} +- {trial.sigma:.2g} m too {looks}"
    return f"{r.column} of {r.file} {looking}: {act} {size} {of} {r.column}{without}"


def _row(name: str, value: float, sigma: float) -> str:
    """A row of calibration.csv, with as many digits as sigma has two of.

    The row's own sigma is wide: the measurements that say the number count once, when it is solved again.
    """
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    row = f"write `{name},{value:.{digits}f},{wide(name):g}` in calibration.csv"
    if not name.endswith("_clock_s"):
        return row
    file = name.removesuffix("_clock_s") + ".csv"
    return row + _mapped(Reading(Cause.CLOCK, file, "time_s"), f"offset = {-value:.{digits}f}", "time_s")


def _explained(finding: Explained) -> str:
    """What explains chi2, in words, with the line to write."""
    if not finding.trials:
        return f"no single constant and no single table explains chi2 ({_size(finding.chi2)}, {finding.dof:,} expected)"
    best = finding.trials[0]
    one = "one constant explains" if len(finding.trials) == 1 else "each of these constants explains"
    left = f"chi2 ({_size(finding.chi2)} -> {_size(best.chi2)}, {best.dof:,} expected)"
    if best.reading.cause is Cause.KERNEL:
        rows = f"{100 * best.reading.factor:.2g} % of the rows of {best.reading.file}"
        one = f"no single constant explains chi2; without {rows} all others fit:"
    alike = "" if len(finding.trials) == 1 else ", and nothing tells them apart"
    return f"{one} {left}{alike}: {'; or '.join(map(_tried, finding.trials))}"


def _size(chi2: float) -> str:
    return f"{chi2:,.0f}" if chi2 >= 100 else f"{chi2:.3g}"


def _tried(trial: Trial) -> str:
    r = trial.reading
    if r.cause is Cause.KERNEL:
        return f"look at these rows, or solve with --robust {r.column}=cauchy:1"
    if r.cause is not Cause.CALIBRATION:
        return _arm(trial) if r.cause is Cause.ARM else cause(r)
    digits = max(0, 1 - math.floor(math.log10(trial.sigma)))
    value = f"{r.column} {r.factor:.{digits}f} +- {trial.sigma:.{digits}f}"
    return f"{value}: {_row(r.column, r.factor, trial.sigma)}"


def _zone(r: Reading) -> str:
    size, words = f"{abs(r.factor):.9g} s", LEAPS.get(abs(r.factor), "")
    periods = (several(round(abs(r.factor) / one), noun) for one, noun in PERIODS if r.factor % one == 0)
    words = words or next(periods, "by the depth")
    late, act = ("late", f"subtract {size} from") if r.factor > 0 else ("early", f"add {size} to")
    offset = _mapped(r, f"offset = {-r.factor:.9g}", "time_s")
    return f"the clock of {r.file} looks {size} {late} ({words}): {act} time_s{offset}"


DETAILED: dict[Cause, Callable[[Reading], str]] = {
    Cause.UNIT: _unit,
    Cause.SIGN: _sign,
    Cause.AXES: _axes,
    Cause.EARTH: _earth,
    Cause.NORTH: _north,
    Cause.CLOCK: _clock,
    Cause.PRESSURE: _pressure,
    Cause.ZONE: _zone,
    Cause.DRIFT: _fast,
}
