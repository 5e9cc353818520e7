"""Mistakes in the numbers of a sensor: units, signs, exchanges, frames, turns, special values, wild and stuck rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from mistake_base import (
    DEG,
    FOOT,
    KNOT,
    NAMES,
    PITCH,
    ROLL,
    TURNED,
    YAW,
    Change,
    Mistake,
    change,
    grown,
    mapped,
    named,
    on,
    repeated,
    some,
    unit,
)
from mistake_missions import ANGLES, DEPTH, PLACES, SEEN, TIME, VELOCITIES, Survey

from models import euler
from models.algebra import Array, apply
from models.manifolds.so3 import rotation3


def turning(degrees: float) -> Callable[[Array], Array]:
    """Velocities along axes that are turned to starboard from those of the vehicle."""
    c, s = np.cos(degrees / DEG), np.sin(degrees / DEG)
    return lambda v: v @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]).T


def rotations(survey: Survey) -> Array:
    """From the axes of the vehicle to those of the earth (n, 3, 3), at the rows of the DVL."""
    ahrs, t = survey.logs["ahrs"], survey.logs["dvl"][TIME]
    rpy = [np.interp(t, ahrs[TIME], np.unwrap(ahrs[name] / DEG)) for name in ANGLES]
    return rotation3(euler.quaternion_from_angles(np.column_stack(rpy)))


def of_earth(order: tuple[int, int, int], signs: tuple[int, int, int]) -> Change:
    """Velocities along the axes of the earth."""

    def spoil(survey: Survey) -> None:
        dvl = survey.logs["dvl"]
        v = apply(rotations(survey), np.column_stack([dvl[name] for name in VELOCITIES]))
        dvl.update({name: np.round(sign * v[:, k], 4) for name, k, sign in zip(VELOCITIES, order, signs, strict=True)})

    return spoil


def through_water(survey: Survey) -> None:
    """Velocities through water that moves by half a meter a second."""
    dvl = survey.logs["dvl"]
    current = apply(rotations(survey).mT, np.array([[0.4, 0.3, 0.0]]))
    dvl.update({name: dvl[name] - current[:, k] * dvl["lock"] for k, name in enumerate(VELOCITIES)})


def from_north(survey: Survey) -> None:
    """Bearings of the USBL from north, not from the bow of the ship."""
    usbl, ship = survey.logs["usbl"], survey.logs["ship"]
    usbl[SEEN[1]] = usbl[SEEN[1]] + np.interp(usbl[TIME], ship[TIME], np.unwrap(ship[YAW] / DEG) * DEG)


def only(column: str, name: str, factor: int) -> tuple[str, ...]:
    """Patterns of a wrong unit of one velocity, not of all three."""
    return rf"(divide|(like|in) {name}: \w+) {column} by {factor}", f'unit = "{name}"`? for {column} in'


def of_velocities() -> Iterator[Mistake]:
    of = on("dvl")
    for name, factor in {"mm/s": 1000.0, "cm/s": 100.0, "kn": KNOT, "ft/s": FOOT, "km/h": 3.6}.items():
        yield of(f"in {name}", VELOCITIES, lambda v, f=factor: f * v, unit(VELOCITIES, name, factor))
    yield of("vx in mm/s", VELOCITIES[:1], lambda v: 1000 * v, only("vx_m_s", "mm/s", 1000))
    yield of("vz in cm/s", VELOCITIES[2:], lambda v: 100 * v, only("vz_m_s", "cm/s", 100))
    for k, name in enumerate(("vx astern", "vy to port", "vz up")):
        yield of(name, VELOCITIES[k : k + 1], lambda v: -v, named(VELOCITIES[k : k + 1], "-1", "sign"))
    yield of("all signs", VELOCITIES, lambda v: -v, named(VELOCITIES, "-1", "sign", "180", r"3\.14"))
    for a, b in ((0, 1), (0, 2), (1, 2)):
        pair = [VELOCITIES[a], VELOCITIES[b]]
        yield of(f"{NAMES[pair[0]]}, {NAMES[pair[1]]} exchanged", pair, lambda v: v[:, ::-1], named(pair, "exchange"))
    yield of("FLU", VELOCITIES, lambda v: v * [1, -1, -1], named(VELOCITIES, "FLU", "-1"))
    yield of(
        "FRD turned to FLU and mm/s", VELOCITIES, lambda v: 1000 * v * [1, -1, -1], named(VELOCITIES, "FLU", "mm/s")
    )
    for turn in (3, 10, 45, 90, -90, 135, 180):
        right = (TURNED, r"turned by", *(named(VELOCITIES[:2], "exchange", "-1") if turn % 90 == 0 else ()))
        yield of(f"turned by {turn} deg", VELOCITIES, turning(turn), right)
    for part in (1.05, 0.97):
        yield of(f"scale {part}", VELOCITIES, lambda v, f=part: f * v, ("dvl_scale",))
    axes = ("frame", "earth", "axes of the (earth|world)")
    yield Mistake("dvl: NED axes of the earth", of_earth((0, 1, 2), (1, 1, 1)), axes)
    yield Mistake("dvl: through water", through_water, ("dvl|current|water",))
    yield Mistake("dvl: ENU axes of the earth", of_earth((1, 0, 2), (1, 1, -1)), axes)
    for name, value in (("-32768", -32768.0), ("-32.768", -32.768), ("-9999", -9999.0), ("0", 0.0)):
        right = (
            rf"missing = .*{value:g}",
            rf"{value:g}\b.*(none|special|missing)",
            "leave out lines",
            "without bottom lock",
        )
        yield Mistake(f"dvl: {name} in 3 rows", some("dvl", VELOCITIES, slice(400, 403), value), right)
        yield Mistake(f"dvl: {name} in 5 %", some("dvl", VELOCITIES, 0.05, value), right)
    stuck = repeated("dvl", VELOCITIES, slice(500, 560))
    yield Mistake("dvl: repeats for 30 s", stuck, ("dvl.*(repeat|stuck|same)", "repeat.*(dvl|vx_m_s)"))
    yield Mistake("dvl: 5 % of spikes", some("dvl", VELOCITIES, 0.05, 0.0, 3.0), ("vx_m_s.*outliers", "dvl.*gate"))
    yield Mistake("dvl: lock inverted", change("dvl", ["lock"], lambda a: 1 - a), ("valid.*invert", "invert.*valid"))
    yield Mistake("dvl: lock not mapped", mapped("dvl", valid=None), (r"\bvalid\b|= .*\b0\b|without bottom lock",))
    yield Mistake("dvl_mount: x 5 m off", grown("dvl_mount", x_m=13.5), ("dvl_mount|lever",))
    yield Mistake("noise: sigma_v 10 times too small", grown("noise", sigma_v_m_s=0.1), ("sigma_v_m_s",))


def of_angles() -> Iterator[Mistake]:
    for table in ("ahrs", "ship"):
        of = on(table)
        turned = TURNED if table == "ahrs" else f"{TURNED}|bearing_rad|usbl_yaw_rad,"  # the same to the vehicle
        for turn in (13, 90, -90, 180):
            yield of(f"heading {turn} deg off", [YAW], lambda a, d=turn: (a + d) % 360, (turned,))
        yield of("heading counterclockwise", [YAW], lambda a: -a % 360, named([YAW], "-1", "sign", "clockwise"))
        yield of("heading ENU", [YAW], lambda a: (90 - a) % 360, named([YAW], "ENU", "from east"))
        yield of("heading in rad", [YAW], lambda a: a / DEG, named([YAW], 'unit = "rad"', "rad", "multiply by 57"))
        yield of("heading in deg x 100", [YAW], lambda a: 100 * a, unit([YAW], "cdeg", 100))
        yield of("stuck heading for 60 s", [YAW], frozen(0.4, 0.5), ("(yaw|ahrs|ship).*(repeat|stuck|same)",))
        yield of("stuck heading", [YAW], frozen(0.0, 1.0), ("(yaw|ahrs|ship).*(repeat|stuck|same|constant)",))
        yield of("heading drifts by 20 deg", [YAW], lambda a: (a + 20 * ramp(a)) % 360, (f"(ahrs|ship|{turned})",))
        yield of("roll, pitch exchanged", [ROLL, PITCH], lambda a: a[:, ::-1], named([ROLL, PITCH], "exchange"))
        yield of("pitch bow down", [PITCH], lambda a: -a, named([PITCH], "-1", "sign"))
        yield of("roll to port", [ROLL], lambda a: -a, named([ROLL], "-1", "sign"))
        yield of("roll upside down", [ROLL], lambda a: a + 180, named([ROLL], "180|axes|frame|upside|FLU|-1"))
        yield of("roll, pitch in deg x 100", [ROLL, PITCH], lambda a: 100 * a, unit([ROLL, PITCH], "cdeg", 100))
        for value in (0, 999, -9999):
            right = (rf"missing = .*{value}\b", rf"{value}\b.*(none|special|missing)", "leave out lines")
            name = f"{value} for 30 s"
            yield Mistake(f"{table}: {name}", change(table, ANGLES, gap(value)), right)
    yield Mistake("ahrs: degrees under [rad]", radians_header, unit(ANGLES, "deg", DEG))
    yield Mistake(
        "ahrs: 5 % of wild headings", some("ahrs", [YAW], 0.05, 0.0, 60.0), ("(yaw|ahrs).*(outlier|wild|far)",)
    )
    yield Mistake("noise: sigma_yaw a variance", grown("noise", sigma_yaw_rad=0.01), ("sigma_yaw_rad",))


def ramp(a: Array) -> Array:
    return np.linspace(0.0, 1.0, len(a))[:, None]


def frozen(begin: float, end: float) -> Callable[[Array], Array]:
    """The value at a part of the log until another part."""

    def freeze(a: Array) -> Array:
        rows = slice(int(begin * len(a)), int(end * len(a)))
        a[rows] = a[rows][0]
        return a

    return freeze


def gap(value: float) -> Callable[[Array], Array]:
    """A value for a twentieth of the log."""

    def fill(a: Array) -> Array:
        a[int(0.5 * len(a)) : int(0.55 * len(a))] = value
        return a

    return fill


def radians_header(survey: Survey) -> None:
    """Degrees in columns that say rad."""
    log = survey.logs["ahrs"]
    survey.logs["ahrs"] = {name.replace("[deg]", "[rad]"): column for name, column in log.items()}
    section = survey.mapping["ahrs"]
    section.update({key: str(value).replace("[deg]", "[rad]") for key, value in section.items()})


def of_depths() -> Iterator[Mistake]:
    def of(name: str, function: Callable[[Array], Any], right: tuple[str, ...]) -> Mistake:
        return on("depth")(name, [DEPTH], function, right)

    yield of("negative", lambda z: -z, named([DEPTH], "-1", "sign", "up = true"))
    for name, factor in {"cm": 100.0, "mm": 1000.0, "ft": FOOT, "fathom": FOOT / 6}.items():
        yield of(f"in {name}", lambda z, f=factor: f * z, unit([DEPTH], name, factor))
    yield of("in kPa", lambda z: 10.05 * z, named([DEPTH], "kPa", "pressure", "10"))
    yield of(
        "absolute pressure in dbar",
        lambda z: 1.005 * z + 10.13,
        named([DEPTH], "pressure", "atmosphere", "10", "offset"),
    )
    yield of("absolute pressure in hPa", lambda z: 100.5 * z + 1013.0, named([DEPTH], "hPa", "mbar", "pressure"))
    yield of("absolute pressure in Pa", lambda z: 10050 * z + 101300.0, named([DEPTH], "Pa", "pressure"))
    yield of("3 m too deep", lambda z: z + 3.0, named([DEPTH], "offset", "surface", "deep", "subtract"))
    yield of("altitude", lambda z: 30.0 - z, named([DEPTH], "altitude", "-1", "sign", "height"))
    yield of("scale 1.03", lambda z: 1.03 * z, named([DEPTH], "scale", "density", "divide"))
    yield of("stuck", lambda z: 0 * z + 7.0, named([DEPTH], "stuck", "constant", "same", "repeat"))
    yield of("stuck for 60 s", frozen(0.4, 0.5), named([DEPTH], "stuck", "constant", "same", "repeat"))
    for value in (-9999.0, 9999.0, 0.0, -32768.0):
        right = (rf"missing = .*{value:g}", rf"{value:g}\b.*(none|special|missing)", "leave out lines")
        yield Mistake(f"depth: {value:g} in 3 rows", some("depth", [DEPTH], slice(400, 403), value), right)
        yield Mistake(f"depth: {value:g} in 5 %", some("depth", [DEPTH], 0.05, value), right)
    yield Mistake("depth: 5 % of spikes", some("depth", [DEPTH], 0.05, 0.0, 20.0), named([DEPTH], "outlier", "far"))
    yield Mistake("noise: sigma_z 10 times too small", grown("noise", sigma_z_m=0.1), ("sigma_z_m",))


def lettered(survey: Survey) -> None:
    """Latitudes and longitudes without sign, with letters beside them."""
    log = survey.logs["fixes"]
    for name, letter in zip(PLACES, ("NW"), strict=True):
        log[name] = np.abs(log[name])
        log[f"{letter}?"] = np.array([letter] * len(log[name]), dtype=object)


def minutes(x: Array) -> Array:
    """ddmm.mmmm."""
    return np.asarray(np.sign(x) * (100 * np.floor(np.abs(x)) + 60 * (np.abs(x) % 1)))


def moved(table: str, north: float, columns: list[str] = PLACES) -> Change:
    """One row in the middle so many meters north and west."""

    def spoil(survey: Survey) -> None:
        log = survey.logs[table]
        k = len(log[TIME]) // 2 + 1
        log[columns[0]][k] += north / 1.5 / 111_200
        log[columns[1]][k] -= north / 1.35 / 65_000

    return spoil


def wild_places(survey: Survey) -> None:
    """5 % of the fixes, one at least, 40 m off."""
    log, rng = survey.logs["fixes"], np.random.default_rng(7)
    chosen = rng.choice(len(log[TIME]), max(1, len(log[TIME]) // 20), replace=False)
    for name, degree in zip(PLACES, (111_200, 65_000), strict=True):
        log[name][chosen] += rng.normal(0, 40.0, len(chosen)) / degree


def of_places() -> Iterator[Mistake]:
    for table in ("fixes", "ship"):
        of = on(table)
        yield of("lat, lon exchanged", PLACES, lambda a: a[:, ::-1], named(PLACES, "exchange"))
        yield of("west as east", PLACES[1:], lambda a: -a, named(PLACES[1:], "-1", "sign", "west"))
        yield of("north as south", PLACES[:1], lambda a: -a, named(PLACES[:1], "-1", "sign", "south"))
        yield of("in rad", PLACES, lambda a: a / DEG, named(PLACES, "rad", "57"))
        yield of("times 1e7", PLACES, lambda a: np.round(1e7 * a), named(PLACES, "degE7"))
        yield of("ddmm.mmmm", PLACES, minutes, named(PLACES, "ddmm"))
        yield of("lon times 10", PLACES[1:], lambda a: 10 * a, named(PLACES[1:], "divide|unit|ddmm|degE7|sigma"))
        for name, part in (("0, 0 in the first 2 rows", slice(0, 2)), ("0, 0 in the middle", slice(8, 10))):
            right = ("missing = .*0", r"\b0, 0\b", "leave out lines", "no fix")
            yield Mistake(f"{table}: {name}", some(table, PLACES, part, 0.0), right)
        stale = ("(fix|ship|lat_deg).*(repeat|stale|same|stuck)", "(repeat|stale).*(fix|ship|lat_deg)")
        yield Mistake(f"{table}: 5 rows repeat", repeated(table, PLACES, slice(7, 12)), stale)
        yield Mistake(f"{table}: half of the rows repeat", change(table, PLACES, frozen(0.25, 0.75)), stale)
        yield Mistake(f"{table}: one row 44 m off", moved(table, 44.0), (rf"{table}|Position",))
    yield Mistake("fixes: letters N and W not mapped", lettered, named(PLACES, "side", "W", "-1"))
    yield Mistake("fixes: 5 % 40 m off", wild_places, ("fixes.*(outlier|jump|robust|leave)", "Position=", "Position"))
    yield Mistake(
        "fixes: sigma 10 times too small",
        grown("fixes", sigma_x_m=0.1, sigma_y_m=0.1),
        ("fixes.*sigma|sigma_x_m|Position",),
    )
    yield Mistake("fixes: arm 5 m off", grown("fixes", arm_x_m=14.0), ("arm",))


def of_acoustics() -> Iterator[Mistake]:
    of = on("usbl")
    R, B, E = ([name] for name in SEEN)
    for name, factor in {"cm": 100.0, "mm": 1000.0, "ft": FOOT, "km": 0.001}.items():
        yield of(f"range in {name}", R, lambda a, f=factor: f * a, unit(R, name, factor) + named(R, "multiply"))
    yield of("range both ways", R, lambda a: 2 * a, named(R, "ways", "divide", "twice"))
    yield of("range 5 % too long", R, lambda a: 1.05 * a, ("sound|range_m|scale",))
    yield of("bearing in rad", B, lambda a: a / DEG, named(B, "rad"))
    yield of("bearing in deg x 100", B, lambda a: 100 * a, unit(B, "cdeg", 100))
    yield of("bearing to port", B, lambda a: -a, named(B, "-1", "sign"))
    for turn in (13, 90, 180):
        yield of(f"bearing {turn} deg off", B, lambda a, d=turn: a + d, ("bearing_rad|yaw_rad",))
    yield of("elevation upward", E, lambda a: -a, named(E, "-1", "sign"))
    yield of("elevation from the vertical", E, lambda a: 90 - a, ("elevation_rad",))
    yield of("bearing, elevation exchanged", [*B, *E], lambda a: a[:, ::-1], named([*B, *E], "exchange"))
    yield Mistake("usbl: bearing from north", from_north, ("bearing_rad|yaw_rad",))
    for name, part in (("3 rows", slice(70, 73)), ("5 %", 0.05)):
        right = ("missing = ", "usbl.*(none|special|jump|outlier)", "leave out lines", "usbl|RangeBearing")
        yield Mistake(f"usbl: range 0 in {name}", some("usbl", R, part, 0.0), right)
        yield Mistake(f"usbl: range 9999 in {name}", some("usbl", R, part, 9999.0), right)
    yield Mistake(
        "usbl: repeats for 80 s",
        repeated("usbl", SEEN, slice(70, 90)),
        ("usbl.*(repeat|same|stale)", "repeat.*(usbl|range)"),
    )
    yield Mistake("usbl: 5 % 40 m off", some("usbl", R, 0.05, 0.0, 40.0), ("usbl|range_m|robust",))
    small = grown("usbl", sigma_range_m=0.1, sigma_bearing_rad=0.1, sigma_elevation_rad=0.1)
    yield Mistake("usbl: sigma 10 times too small", small, ("usbl|sigma_range_m",))
