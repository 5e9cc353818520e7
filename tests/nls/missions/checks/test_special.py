"""Numbers that stand for none, and sensors that repeat one, are named with their lines; what only looks so is not."""

from __future__ import annotations

import re

import numpy as np

from models.algebra import Array
from models.geodesy import LocalPlane
from nls.missions.checks.findings import Cause
from nls.missions.checks.special import repeated
from nls.missions.folder.table import csv_text
from tests.combinations import for_all
from tests.nls.missions.checks.missions import FIXES, Change, changed, clean, dive, findings, kinds, tables_of

V, DEG = ["vx_m_s", "vy_m_s", "vz_m_s"], np.pi / 180
SPOILS: dict[str, tuple[str, str, list[str], float]] = {  # kind of mission, table, columns, number
    "DVL in mm/s, 16 bits": ("log", "dvl", V, -32.768),
    "DVL in m/s, 16 bits": ("log", "dvl", V[:2], -32768.0),
    "one beam axis": ("log", "dvl", ["vz_m_s"], 32.767),
    "zeros that are valid": ("log", "dvl", V, 0.0),
    "depth of nines": ("log", "depth", ["z_m"], -9999.0),
    "depth of nines in feet": ("log", "depth", ["z_m"], -9999 * 0.3048),
    "attitude of zeros": ("log", "ahrs", ["roll_rad", "pitch_rad", "yaw_rad"], 0.0),
    "depth of zeros": ("log", "depth", ["z_m"], 0.0),
    "heading of nines": ("log", "ahrs", ["yaw_rad"], -9999 * DEG + 56 * np.pi),
    "fixes of nines": ("log", "fixes", ["x_m", "y_m"], 9999.0),
    "path of nines": ("path", "path", ["z_m"], 999.0),
    "path without a place": ("path", "path", ["x_m", "y_m"], -32768.0),
    "fixes of a motion": ("motion", "fixes", ["x_m", "y_m"], -999.0),
}


def checks(files: dict[str, str]) -> set[str]:
    """The checks that find something."""
    return {entry.check for entry in findings(files)}


def held(first: int, last: int) -> Change:
    """The columns behind the time of rows as those of the first of them."""

    def change(y: Array) -> Array:
        y[first:last, 1:4] = y[first, 1:4]
        return y

    return change


@for_all(name=list(SPOILS))
def test_a_number_that_stands_for_none_is_named_first_with_its_lines(name: str) -> None:
    kind, table, columns, value = SPOILS[name]
    bad = np.arange(30, 36)

    def at(rows: object, number: float) -> Change:
        return lambda y: np.where(np.isin(np.arange(len(y)), rows), number, y)

    spoils = dict.fromkeys(columns, at(bad, value))
    if table == "dvl":
        spoils["valid"] = at(np.arange(29, 37), 1.0)
    files = kinds(clean(3, minutes=6.0, drop_outs=False))[kind]
    spoiled = changed(files, table, **spoils)
    (finding,) = findings(spoiled)
    assert findings(changed(spoiled, table, lambda y: np.delete(y, np.array(finding.lines) - 2, axis=0))) == []
    assert (finding.check, finding.file, finding.lines) == ("special value", f"{table}.csv", tuple(bad + 2))
    assert finding.readings[0].cause is (Cause.NONE if value else Cause.ZEROS)
    assert finding.readings[0].column == ", ".join(columns)
    text = finding.says
    assert f"leave out lines 32 to 37 of {table}.csv" in text
    number = re.search(rf"missing(?:_together)? = {{ {columns[0]} = \[?(-?[\d.]+)", text)
    assert number is not None
    assert value == 0 or abs(float(number[1])) in (9999, 999, 32768, 32.768, 32.767) or "feet" in name


@for_all(case=[(54.0, 10.0, True), (0.0, 0.0, False)])
def test_rows_of_zero_latitude_and_longitude_are_no_fixes(case: tuple[float, float, bool]) -> None:
    """0, 0 is far from the other fixes; a survey that begins there has it, too."""
    plane = LocalPlane(*case[:2])

    def geodetic(y: Array) -> Array:
        y[:, 1], y[:, 2] = plane.geodetic(y[:, 1:3])
        y[:2, 1:3] = 0.0
        return y

    files = changed(kinds(clean(4, minutes=6.0))["log"], "fixes", geodetic)
    files["fixes"] = files["fixes"].replace("x_m,y_m", "lat_deg,lon_deg", 1)
    found = [entry.lines for entry in findings(files, plane) if entry.check == "special value"]
    assert found == [(2, 3)] * case[2]


def test_what_vehicles_have_as_well_is_no_special_value() -> None:
    """A rest on the bottom, a begin at x = y = 0, a ship at anchor, a depth of 9.99 m, and one around it."""

    def rest(y: Array) -> Array:
        y[:, 1:4] *= np.clip(np.abs(y[:, :1] - 100.0) / 20.0 - 1.0, 0.0, 1.0)  # slows down, rests for 40 s, and goes on
        return y

    log = kinds(clean(5, minutes=4.0, drop_outs=False))
    files, path = {name: log["log"][name] for name in ("dvl", "ahrs", "depth", "noise")}, {"path": log["path"]["path"]}
    assert not checks(changed(files, "dvl", rest)) & {"special value", "repeated"}
    assert findings(changed(path, "path", _level)) == []
    anchored = csv_text(FIXES, np.arange(600.0), np.tile([3.0, 4.0, 1.0, 1.0], (600, 1))).decode()
    assert findings({"motion": "sigma_walk_m_sqrt_s\n1.0\n", "fixes": anchored}) == []
    assert findings(changed(path, "path", z_m=lambda z: np.where(np.arange(len(z)) % 40 < 3, 9.99, 9.9))) == []
    nines = changed(log["log"], "depth", z_m=lambda z: np.linspace(9.5, 10.5, len(z)).round(2))
    assert "special value" not in checks(nines)


def _level(y: Array) -> Array:
    """North, exactly, then around and back, from x = y = 0."""
    t = y[:, 0] - y[0, 0]
    yaw = np.clip((t - 60.0) / 30.0, 0.0, 1.0) * np.pi * 0.999
    step = np.column_stack([np.cos(yaw), np.sin(yaw)]) * np.gradient(t)[:, None]
    y[:, 1:3] = np.vstack([np.zeros(2), np.cumsum(step[:-1], axis=0)])
    y[:, 4] = yaw
    return y


@for_all(kind=["log", "path", "motion"])
def test_a_fix_that_repeats_while_the_vehicle_moves_is_stale(kind: str) -> None:
    def spoil(y: Array) -> Array:
        if kind != "motion":
            y[20:40, 1:3] = y[20, 1:3]
            return y
        y = np.repeat(y, 50, axis=0)  # ten metres in a second, afterwards
        return np.column_stack([np.arange(len(y)) * 0.1, y[:, 1:]])

    (finding, *_) = findings(changed(kinds(clean(2, minutes=6.0))[kind], "fixes", spoil))
    assert finding.readings[0].cause is Cause.STALE
    assert kind == "motion" or finding.lines == tuple(range(23, 42))
    assert "leave out lines" in finding.says


@for_all(table=["dvl", "ahrs", "depth"])
def test_a_velocity_or_a_heading_that_repeats_is_stale(table: str) -> None:
    files = kinds(clean(2, minutes=6.0, drop_outs=False))["log"]
    (finding, *_) = findings(changed(files, table, held(200, 260)))
    assert (finding.check, finding.file, finding.lines) == ("repeated", f"{table}.csv", tuple(range(203, 262)))


@for_all(seconds=[1.0, 20.0])
def test_places_of_a_ship_that_are_held_for_long_are_repeated(seconds: float) -> None:
    """Attitudes at 20 Hz, and places that a receiver gives each second, or not for 20 s in the middle."""
    t = np.arange(0.0, 80.0, 0.05)
    given = np.floor(t) if seconds == 1.0 else np.where((t > 30) & (t < 30 + seconds), 30.0, t)
    columns = ["time_s", "x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad"]
    noise = np.random.default_rng(0).normal(0, 0.01, (len(t), 3))
    ship = csv_text(columns, t, given * 2.0, np.sin(given), 0 * t, noise).decode()
    assert [len(entry.lines) for entry in repeated(tables_of({"ship": ship}))] == [399] * (seconds > 1.0)


def test_numbers_that_a_slow_sensor_repeats_are_not_stale() -> None:
    """A DVL of 1 Hz in a log of 5 Hz, a heading of whole degrees on a straight way, a vehicle without noise."""

    def whole(yaw: Array) -> Array:
        return np.round(np.degrees(np.where(np.arange(len(yaw)) < 300, 0.3, yaw))) * np.pi / 180

    def constant(y: Array) -> Array:
        y[:, 1:4] = [1.4, 0.0, 0.0]
        return y

    files = kinds(clean(7, minutes=6.0, drop_outs=False))["log"]
    files.pop("fixes")
    slow = changed(files, "dvl", lambda y: np.column_stack([y[:, 0], y[np.arange(len(y)) // 5 * 5, 1:]]))
    for other in (slow, changed(files, "ahrs", yaw_rad=whole), changed(files, "dvl", constant)):
        assert not checks(other) & {"repeated", "special value"}


@for_all(seed=[0, 1])
def test_clean_missions_of_every_kind_are_plausible(seed: int) -> None:
    for log in (clean(seed, minutes=6.0), dive(seed), dive(seed, on_deck=(7.0, 18.0)[seed])):
        for files in kinds(log).values():
            assert [entry.says for entry in findings(files)] == []
