"""Findings about missions in words: implausible tables, causes of chi2, the setup of scans. All are here."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from models.findings import Sentences, Stated
from models.listing import several
from nls.explanation.findings import FindingKind
from nls.missions.checks.agreement import LEAPS, PERIODS
from nls.missions.checks.findings import Cause, Reading, SetupKind, Trial
from nls.missions.checks.special import meant
from nls.missions.folder.calibration import NAMES, wide

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
NO_LENGTHS = {"hm", "kPa", "Pa", "bar"}  # a mapping has no such unit for a depth
CHECKS = {  # of a check: what was measured, and what its limit is
    "speed": "the median speed is {measured}; a vehicle stays below {limit}",
    "special value": "{rows} with {measured} are far from the rows around them",
    "bottom lock": "valid is 1 in {percent} of the rows, and the rows of 0 are smooth",
    "heading": "course and heading agree to {percent} only; expected above {limit_percent}",
    "stale": "{rows} repeat a fix while the vehicle moves {measured}",
    "repeated": "{rows} repeat a number for {measured} while the vehicle moves",
    "tilt": "it is beyond {measured} in a fifth of the log; a vehicle stays within {limit}",
    "turn rate": "the vehicle turns faster than {measured} in a tenth of the log; expected below {limit}",
    "depth": "a depth of {measured}; expected {side} {limit}",
    "stuck": "it is {measured} in all rows, and the vehicle moves",
    "depth rate": "the depth changes by {measured}; a vehicle stays below {limit}",
    "time step": "the median time between two rows is {measured}; expected {side} {limit}",
    "span": "its times span {measured} times those of the track; expected about 1, or less",
    "late": "it begins {measured} after the track; expected within the track",
    "under water": "{measured} fixes are more than 2 m under water at their times; a receiver has none there",
    "surface": "all fixes are at the smallest depth, {measured}; expected below {limit}",
    "outliers": "{percent} of the rows are far from the rows beside them; expected below {limit_percent}",
    "scatter": "its rows scatter by {measured}, {ratio} times the sigma stated in noise.csv; expected below {limit}",
    "sound speed": "it is {measured}; water has 1400 to 1600 m/s",
    "far away": "the median fix is {measured} from x = y = 0; expected below {limit}",
    "jumps": "{percent} of the fixes jump away from those before and after; expected below {limit_percent}",
    "way down": "changes of depth and vertical velocity of the DVL differ by {percent}; expected below {limit_percent}",
}


def _implausible(f: Stated) -> str:
    """Where, which number, what is expected, what the cause is and what to do; or what explains chi2."""
    n = f.numbers
    if "trials" in n:
        return _explained(n)
    readings, rows = [Reading(**reading) for reading in n["readings"]], n.get("lines", ())
    words = {name: f"{n[name]:.4g} {n['unit']}".strip() for name in ("measured", "limit")}
    words |= {name: f"{100 * part:.3g} %" for name, part in (("percent", n["measured"]), ("limit_percent", n["limit"]))}
    words |= {"ratio": f"{readings[0].factor:.3g}", "rows": several(len(rows), "row")}
    numbers = CHECKS[n["check"]].format(**words, side="below" if n["measured"] > n["limit"] else "above")
    causes = "; or ".join(_cause(reading, lines(rows) if rows else "") for reading in readings)
    return f"{n['file']}:{n['line']}: {n['column']} is implausible: {numbers}. Probable cause: {causes}"


def lines(numbers: Sequence[int], most: int = 100) -> str:
    """Lines of a file: the first of their runs, so many, and how many lines more there are.

    Examples
    --------
    >>> lines([7, 8, 9, 10, 14]), lines([3])
    ('lines 7 to 10, 14', 'line 3')
    """
    runs = np.split(np.array(numbers), np.flatnonzero(np.diff(numbers) > 1) + 1)
    words = [f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs[:most]]
    more = sum(map(len, runs[most:]))
    return f"line{'s' * (len(numbers) > 1)} {', '.join(words)}{f' and {more} more' if more else ''}"


def _cause(r: Reading, rows: str = "") -> str:
    """The cause and what to do; rows are the lines that it is about."""
    text = words(r) if callable(words := CAUSES[r.cause]) else words
    many = ", " in r.column
    return text.format(
        **vars(r),
        lines=rows,
        ratio=f"{float(f'{r.factor:.2g}'):g}",
        has="have" if many else "has",
        looks="look" if many else "looks",
        seems="look as if they" if many else "looks as if it",
        positive=f"; {POSITIVE[r.column]}" if r.column in POSITIVE else "",
        origin=_origin(r),
        act=f"leave out {rows} of {r.file}" if rows else "delete these rows",
        mapping=f"in [{r.file.removesuffix('.csv')}] of the mapping",
    )


def _origin(r: Reading) -> str:
    """Where latitudes and longitudes stand besides."""
    return ", in origin.csv as well" if r.column.startswith(("lat_deg", "lon_deg")) else ""


def _none(r: Reading) -> str:
    names = r.column.split(", ")
    numbers = {name: ", ".join(f"{number:.10g}" for number in meant(name, r.factor)) for name in names}
    keys = ", ".join(f"{name} = {f'[{text}]' if ',' in text else text}" for name, text in numbers.items())
    option = "missing" if r.cause == Cause.NONE or len(names) == 1 else "missing_together"
    cure = f"write `{option} = {{{{ {keys} }}}}` {{mapping}}, or leave out {{lines}} of {{file}}"
    return f"no {{column}} was measured there: {cure}"


def _unit(r: Reading) -> str:
    units = next(units for end, units in UNITS.items() if r.column.endswith(end))
    name = next((unit for factor, unit in units.items() if abs(factor / r.factor - 1) < 1e-3), "")
    act = f"multiply {{column}} by {1 / r.factor:.{10 if _origin(r) else 5}g}{{origin}}"
    if r.factor > 1:
        act = f"divide {{column}} by {r.factor:.{10 if _origin(r) else 5}g}"
    key = f"scale = {1 / r.factor:.5g}" if name in NO_LENGTHS and r.column == "z_m" else f'unit = "{name}"'
    mapped = f", or write `{key}` for {{column}} {{mapping}}" if name else ""
    return f"{{column}} of {{file}} {{looks}} like {name or 'another unit'}: {act}{mapped}"


def _axes(r: Reading) -> str:
    act = f"multiply {r.column.partition(', ')[2]} by -1, or " if ", " in r.column else ""
    return f'{{column}} of {{file}} look like axes ahead, port and up: {act}write `frame = "FLU"` {{mapping}}'


def _north(r: Reading) -> str:
    if r.column == "bearing_rad":
        return "{column} of {file} looks measured from north: subtract the heading of the ship"
    east = "{column} of {file} {looks} measured from east, counterclockwise"
    if r.column != "yaw_rad":  # the pitch has its sign, too
        return east + ', as in axes ENU and FLU: write `frame = "ENU"` {mapping}'
    cure = "or write `sign = -1, offset = 1.5708` for yaw_rad {mapping}"
    return f"{east}: multiply yaw_rad by -1, then add 1.5708 to it, {cure}"


def _pressure(r: Reading) -> str:
    divide, scale = (f" and divide by {r.factor:g}", f"`scale = {1 / r.factor:g}` and ") if r.factor > 1 else ("", "")
    return (
        f"z_m of {{file}} looks like absolute pressure in {UNITS['_pa'][r.factor]}: subtract {10.1325 * r.factor:.6g} "
        f"from z_m{divide}, or write {scale}`offset = -10.1325` for z_m {{mapping}}"
    )


def _earth(r: Reading) -> str:
    axes, act = "north, east and down", ""
    if r.factor < 0:
        axes, act = "east, north and up", "exchange the names of vx_m_s, vy_m_s, multiply vz_m_s by -1, and "
    cure = "write `earth_axes = 1` {mapping}, or give {file} a column earth_axes of 1"
    return f"{{column}} of {{file}} look like velocities {axes}: {act}{cure}"


def _late(seconds: float, digits: int) -> tuple[str, str]:
    """How much a clock is off, and what to do with its times."""
    size = f"{abs(seconds):.{digits}g} s"
    act = f"subtract {size} from" if seconds > 0 else f"add {size} to"
    cure = f"{act} time_s, or write `offset = {-seconds:.{digits}g}` for time_s {{mapping}}"
    return f"{size} {'late' if seconds > 0 else 'early'}", cure


def _clock(r: Reading) -> str:
    late, cure = _late(r.factor, 3)
    if (name := f"{r.file.removesuffix('.csv')}_clock_s") in NAMES:
        cure = _row(name, r.factor, sigma=1.0)  # one of a list of lags
    return f"times of {{file}} look about {late}: {cure}"


def _zone(r: Reading) -> str:
    late, cure = _late(r.factor, 9)
    periods = (several(round(abs(r.factor) / one), noun) for one, noun in PERIODS.items() if r.factor % one == 0)
    why = LEAPS.get(abs(r.factor), "") or next(periods, "by the depth")
    return f"the clock of {{file}} looks {late} ({why}): {cure}"


def _fast(r: Reading) -> str:
    if r.column == "yaw_rad":
        drift = f"{math.degrees(60 * r.factor):.2g} deg a minute"
        return f"yaw_rad of {{file}} drifts by {drift}: log it by another compass"
    act = f"divide time_s by {1 + r.factor:.12g}, then add {r.offset:.6f} s to it"
    return f"the clock of {{file}} looks {100 * r.factor:.2g} % fast: {act}"


def _row(name: str, value: float, sigma: float) -> str:
    """A row of calibration.csv, with as many digits as sigma has two of.

    The row's own sigma is wide: the measurements that say the number count once, when it is solved again.
    """
    digits = _digits(sigma)
    row = f"write `{name},{value:.{digits}f},{wide(name):g}` in calibration.csv"
    table = name.removesuffix("_clock_s")
    cure = f", or write `offset = {-value:.{digits}f}` for time_s in [{table}] of the mapping"
    return row + (cure if table != name else "")


def _digits(sigma: float) -> int:
    """Decimals of a number, of whose sigma two digits count."""
    return max(0, 1 - math.floor(math.log10(sigma)))


def _explained(n: Mapping[str, Any]) -> str:
    """The explanation of chi2 in words, with the line to write."""
    chi2 = f"{_size(n['chi2'])}"
    if not n["trials"]:
        return f"no single constant and no single table explains chi2 ({chi2}, {n['dof']:,} expected)"
    trials = [Trial(**{**trial, "reading": Reading(**trial["reading"])}) for trial in n["trials"]]
    best, alike = trials[0], ", and the data do not distinguish them" if len(trials) > 1 else ""
    one = "each of these constants explains" if alike else "one constant explains"
    if best.reading.cause == Cause.KERNEL:
        rows = f"{100 * best.reading.factor:.2g} % of the rows of {best.reading.file}"
        one = f"no single constant explains chi2; without {rows} all others fit:"
    fall = f"({chi2} -> {_size(best.chi2)}, {best.dof:,} expected)"
    return f"{one} chi2 {fall}{alike}: {'; or '.join(map(_tried, trials))}"


def _size(chi2: float) -> str:
    return f"{chi2:,.0f}" if chi2 >= 100 else f"{chi2:.3g}"


def _tried(trial: Trial) -> str:
    r = trial.reading
    if r.cause == Cause.KERNEL:
        return f"look at these rows, or solve with --robust {r.column}=cauchy:1"
    if r.cause == Cause.ARM:
        looks, act, of = ("large", "subtract", "from") if r.factor > 0 else ("small", "add", "to")
        cure = f"{act} {abs(r.factor):.2g} {of} {r.column}"
        without = "; without that file it is 0" if r.file == "dvl_mount.csv" else ""
        return f"{r.column} of {r.file} looks {abs(r.factor):.2g} +- {trial.sigma:.2g} m too {looks}: {cure}{without}"
    if r.cause != Cause.CALIBRATION:
        return _cause(r)
    digits = _digits(trial.sigma)
    value = f"{r.column} {r.factor:.{digits}f} +- {trial.sigma:.{digits}f}"
    return f"{value}: {_row(r.column, r.factor, trial.sigma)}"


CAUSES: dict[Cause, str | Callable[[Reading], str]] = {
    Cause.INVERTED: "{column} of {file} looks inverted: write 1 with bottom lock and 0 without",
    Cause.STALE: "{column} of {file} repeat while the vehicle moves: leave out {lines} of {file}",
    Cause.STUCK: "the sensor of {file} looks stuck, or the column was filled: log it again",
    Cause.OUTLIERS: "{column} of {file} {has} outliers: {act}, or give them no weight",
    Cause.SIGMA: "{column} of {file} looks {ratio} times too small (or a variance): multiply {column} by {ratio}",
    Cause.SCALE: "{column} of {file} looks {factor:.4g} times too large: divide {column} by {factor:.4g}",
    Cause.SWAPPED: "{column} of {file} look exchanged: exchange the names of {column}{origin}",
    Cause.FAR: "the origin looks wrong: give the latitude and longitude of the site in origin.csv",
    Cause.UNKNOWN: "none of the usual mistakes explains it: check units, signs, axes and times of {file}",
    Cause.NONE: _none,
    Cause.ZEROS: _none,
    Cause.UNIT: _unit,
    Cause.SIGN: "{column} of {file} {seems} had the other sign: multiply {column} by -1{origin}, or write `sign = -1` "
    "for {column} {mapping}{positive}",
    Cause.AXES: _axes,
    Cause.EARTH: _earth,
    Cause.NORTH: _north,
    Cause.CLOCK: _clock,
    Cause.PRESSURE: _pressure,
    Cause.ZONE: _zone,
    Cause.DRIFT: _fast,
}
POSITIVE = {
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
}


def shown(name: str, value: float) -> str:
    """A component of the mounting of a sonar, or the time of its clock, with its unit."""
    return f"{math.degrees(value):.2g} deg" if name == "yaw" else f"{value:.2g} {'s' if name == 'time' else 'm'}"


def _mounting(f: Stated) -> str:
    n = f.numbers
    name = n["component"]
    key, mounted = f"{name}_rad" if name == "yaw" else f"{name}_m", dict(zip(LABELS, n["mount"], strict=False))[name]
    return (
        f"{LABELS[name]} looks wrong by {shown(name, n['value'])} +- {shown(name, n['sigma'])}. Write {key} = "
        f"{mounted:.3g} {SONAR}, or measure it on the vehicle"
    )


def _turned(f: Stated) -> str:
    n = f.numbers
    return (
        f"the sonar looks turned by {shown('yaw', n['value'])} +- {shown('yaw', n['sigma'])} from the assumed yaw. A "
        f"drift of the vehicle to the side by {abs(n['value']):.2g} m per meter looks the same in scans. If nothing "
        f"drifts, write yaw_rad = {n['mount'][2]:.3g} {SONAR}; the map turns with it"
    )


def _time_offset(f: Stated) -> str:
    n = f.numbers
    late, act = ("late", "subtract") if n["value"] > 0 else ("early", "add")
    return (
        f"times of the scans look {abs(n['value']):.3g} +- {n['sigma']:.2g} s {late} against the track: {act} "
        f"{abs(n['value']):.3g} s, or set both clocks. Then choose the scans of the keyframes again"
    )


def _sigmas(f: Stated) -> str:
    n = f.numbers
    name, large, ratio = n["measurements"], n["scale"] < 1, max(n["scale"], 1 / n["scale"])
    cure = f"Covariances of the map are too {'wide' if large else 'narrow'} by as much"
    cure += "" if large else ": look at the mounting and at the noise of the points"
    if names := {"steps": "step and yaw", "drifts": "mean and stretch"}.get(name):
        cure = f"State a {'smaller' if large else 'larger'} {names} in the section [drift] of mission.toml"
    return (
        f"sigmas of the {name} look {ratio:.2g} times too {'large' if large else 'small'}: chi2 {n['chi2']:.0f}, "
        f"{n['dof']:.0f} expected, chi2/dof {n['chi2'] / n['dof']:.2f}. {cure}"
    )


SONAR = "in the section [sonar] of mission.toml"
LABELS = {
    "x": "forward offset of the sonar",
    "y": "sideways offset of the sonar",
    "yaw": "yaw of the sonar",
    "time": "delay of the scans",
}
SENTENCES: Sentences = {
    FindingKind.IMPLAUSIBLE: _implausible,
    SetupKind.UNREPEATED: (
        "consecutive scans do not show the same features: {fit} of {scans} match the scan before. "
        "Closures of such points are due to chance: detect fewer and stronger echoes, or check the units of ranges and "
        "azimuths"
    ),
    SetupKind.MIRRORED: (
        "azimuths look mirrored: {mirrored} turning steps fit the other sign better, {given} fit this one. Change "
        'the positive side, azimuth = "left" or "right", ' + SONAR
    ),
    SetupKind.MOUNTING: _mounting,
    SetupKind.TURNED: _turned,
    SetupKind.TIME_OFFSET: _time_offset,
    SetupKind.SIGMAS_TOO_LARGE: _sigmas,
    SetupKind.SIGMAS_TOO_SMALL: _sigmas,
}
