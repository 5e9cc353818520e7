"""Numbers that stand for none, and sensors that repeat one, are named with their lines; what only looks so is not."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from models.algebra import Array
from models.geodesy import LocalPlane
from nls.missions.checks.findings import Cause, Implausible
from nls.missions.checks.inspection import implausible
from nls.missions.checks.special import repeated
from nls.missions.folder.folder import read_tables
from nls.missions.folder.table import Table, csv_text
from nls.missions.importing.mapping import Mapping
from nls.missions.importing.mission import import_logs
from tests.combinations import for_all
from tests.nls.missions.checks.missions import dive, kinds, rows
from tests.nls.missions.checks.vehicle import clean
from tests.nls.missions.folder.mission_files import folder

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


def changed(files: dict[str, str], table: str, change: Callable[[list[str], Array], Array]) -> dict[str, str]:
    """The files with one table changed."""
    names, numbers = rows(files[table])
    return {**files, table: csv_text(names, change(names, numbers)).decode()}


def findings(path: Path, files: dict[str, str], plane: LocalPlane | None = None) -> list[Implausible]:
    return implausible(read_tables(folder(path, files))[0], plane)


@for_all(name=list(SPOILS), seed=[3])
def test_a_number_that_stands_for_none_is_named_first_with_its_lines(name: str, seed: int, tmp_path: Path) -> None:
    kind, table, columns, value = SPOILS[name]
    bad = np.arange(30, 36)

    def spoil(names: list[str], numbers: Array) -> Array:
        numbers[np.ix_(bad, [names.index(column) for column in columns])] = value
        if "valid" in names:
            numbers[bad - 1, names.index("valid")] = numbers[bad + 1, names.index("valid")] = 1
            numbers[bad, names.index("valid")] = 1
        return numbers

    files = kinds(clean(seed, minutes=6.0, drop_outs=False))[kind]
    spoiled, path = changed(files, table, spoil), tmp_path / f"{seed}{list(SPOILS).index(name)}"
    (finding,) = findings(path, spoiled)
    left = changed(spoiled, table, lambda _, numbers: np.delete(numbers, np.array(finding.lines) - 2, axis=0))
    assert findings(path, left) == []
    assert (finding.check, finding.file) == ("special value", f"{table}.csv")
    assert finding.lines == tuple(bad + 2)
    assert finding.readings[0].cause is (Cause.NONE if value else Cause.ZEROS)
    assert finding.readings[0].column == ", ".join(columns)
    text = finding.says
    assert f"leave out lines 32 to 37 of {table}.csv" in text
    number = re.search(rf"missing(?:_together)? = {{ {columns[0]} = \[?(-?[\d.]+)", text)
    assert number is not None
    assert value == 0 or abs(float(number[1])) in (9999, 999, 32768, 32.768, 32.767) or "feet" in name


def test_rows_of_zero_latitude_and_longitude_are_no_fixes(tmp_path: Path) -> None:
    """0, 0 is far from the other fixes; a survey that begins there has it, too."""
    for lat, lon, named in ((54.0, 10.0, True), (0.0, 0.0, False)):
        plane = LocalPlane(lat, lon)

        def geodetic(names: list[str], numbers: Array, plane: LocalPlane = plane) -> Array:
            numbers[:, 1], numbers[:, 2] = plane.geodetic(numbers[:, 1:3])
            numbers[:2, 1:3] = 0.0
            return numbers

        files = changed(kinds(clean(4, minutes=6.0))["log"], "fixes", geodetic)
        files["fixes"] = files["fixes"].replace("x_m,y_m", "lat_deg,lon_deg", 1)
        found = findings(tmp_path / f"{lat}", files, plane)
        assert [entry.lines for entry in found if entry.check == "special value"] == [(2, 3)] * named


def test_what_vehicles_have_as_well_is_no_special_value(tmp_path: Path) -> None:
    """A rest on the bottom, a begin at x = y = 0, a depth of 9.99 m, a heading of exactly 0, a ship at anchor."""

    def rest(names: list[str], numbers: Array) -> Array:
        t = numbers[:, 0]
        slow = np.clip(np.abs(t - 100.0) / 20.0 - 1.0, 0.0, 1.0)[:, None]  # slows down, rests for 40 s, and goes on
        numbers[:, 1:4] *= slow
        return numbers

    log = clean(5, minutes=4.0, drop_outs=False)
    files = changed(kinds(log)["log"], "dvl", rest)
    files.pop("fixes")
    assert [e for e in findings(tmp_path / "rest", files) if e.check in ("special value", "repeated")] == []

    def steady(names: list[str], numbers: Array) -> Array:
        numbers[:, 1] = np.linspace(9.5, 10.5, len(numbers)).round(2)
        return numbers

    assert findings(tmp_path / "z", {"path": changed(kinds(log)["path"], "path", _level)["path"]}) == []
    names = ["time_s", "x_m", "y_m", "sigma_x_m", "sigma_y_m"]
    t = np.arange(600.0)
    anchored = np.column_stack([t, np.repeat([[3.0, 4.0]], 600, axis=0), np.ones((600, 2))])
    ship = {"motion": "sigma_walk_m_sqrt_s\n1.0\n", "fixes": csv_text(names, anchored).decode()}
    assert findings(tmp_path / "anchor", ship) == []

    def hovering(names: list[str], numbers: Array) -> Array:
        numbers[:, names.index("z_m")] = np.where(np.arange(len(numbers)) % 40 < 3, 9.99, 9.9)
        return numbers

    hover = {"path": changed(kinds(log)["path"], "path", hovering)["path"]}
    assert findings(tmp_path / "hover", hover) == []
    depth = changed(kinds(log)["log"], "depth", steady)
    assert [e for e in findings(tmp_path / "nines", depth) if e.check == "special value"] == []


def _level(names: list[str], numbers: Array) -> Array:
    """North, exactly, then around and back, from x = y = 0."""
    t = numbers[:, 0] - numbers[0, 0]
    yaw = np.clip((t - 60.0) / 30.0, 0.0, 1.0) * np.pi * 0.999
    step = np.column_stack([np.cos(yaw), np.sin(yaw)]) * np.gradient(t)[:, None]
    numbers[:, 1:3] = np.vstack([np.zeros(2), np.cumsum(step[:-1], axis=0)])
    numbers[:, names.index("yaw_rad")] = yaw
    return numbers


@for_all(kind=["log", "path", "motion"], seed=[2])
def test_a_fix_that_repeats_while_the_vehicle_moves_is_stale(kind: str, seed: int, tmp_path: Path) -> None:
    def spoil(names: list[str], numbers: Array) -> Array:
        if kind == "motion":  # ten metres in a second, afterwards
            numbers = np.repeat(numbers, 50, axis=0)
            numbers[:, 0] = np.arange(len(numbers)) * 0.1
            return numbers
        numbers[20:40, 1:3] = numbers[20, 1:3]
        return numbers

    files = kinds(clean(seed, minutes=6.0))[kind]
    (finding, *_) = findings(tmp_path / f"{kind}{seed}", changed(files, "fixes", spoil))
    assert finding.readings[0].cause is Cause.STALE
    assert kind == "motion" or finding.lines == tuple(range(23, 42))
    assert "leave out lines" in finding.says


@for_all(table=["dvl", "ahrs", "depth"], seed=[2])
def test_a_velocity_or_a_heading_that_repeats_is_stale(table: str, seed: int, tmp_path: Path) -> None:
    def spoil(names: list[str], numbers: Array) -> Array:
        numbers[200:260, 1:4] = numbers[200, 1:4]
        return numbers

    files = kinds(clean(seed, minutes=6.0, drop_outs=False))["log"]
    (finding, *_) = findings(tmp_path / f"{table}{seed}", changed(files, table, spoil))
    assert (finding.check, finding.file) == ("repeated", f"{table}.csv")
    assert finding.lines == tuple(range(203, 262))


@for_all(held=[1.0, 20.0])
def test_places_of_a_ship_that_are_held_for_long_are_repeated(held: float) -> None:
    """Attitudes at 20 Hz, and places that a receiver gives each second, or not for 20 s in the middle."""
    t = np.arange(0.0, 80.0, 0.05)
    given = np.floor(t) if held == 1.0 else np.where((t > 30) & (t < 30 + held), 30.0, t)
    place = np.column_stack([given * 2.0, np.sin(given)])
    columns = ["time_s", "x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad"]
    noise = np.random.default_rng(0).normal(0, 0.01, (len(t), 3))
    ship = Table("ship.csv", tuple(columns), data=csv_text(columns, t, place, 0 * t, noise))
    rows = [row for entry in repeated({"ship": ship}) for row in entry.lines]
    assert len(rows) == (0 if held == 1.0 else 399)


def test_numbers_that_a_slow_sensor_repeats_are_not_stale(tmp_path: Path) -> None:
    """A DVL of 1 Hz in a log of 5 Hz, a heading of whole degrees on a straight way, a vehicle without noise."""

    def hold(names: list[str], numbers: Array) -> Array:
        numbers[:, 1:4] = numbers[np.arange(len(numbers)) // 5 * 5, 1:4]
        return numbers

    def whole(names: list[str], numbers: Array) -> Array:
        numbers[:, 3] = np.round(np.degrees(np.where(numbers[:, 0] < 60.0, 0.3, numbers[:, 3]))) * np.pi / 180
        return numbers

    def constant(names: list[str], numbers: Array) -> Array:
        numbers[:, 1:4] = [1.4, 0.0, 0.0]
        return numbers

    files = kinds(clean(7, minutes=6.0, drop_outs=False))["log"]
    files.pop("fixes")
    for name, table, change in (("hold", "dvl", hold), ("whole", "ahrs", whole), ("constant", "dvl", constant)):
        found = findings(tmp_path / name, changed(files, table, change))
        assert [e for e in found if e.check in ("repeated", "special value")] == []


@pytest.mark.parametrize("seed", range(2))
def test_clean_missions_of_every_kind_are_plausible(seed: int, tmp_path: Path) -> None:
    for log in (clean(seed, minutes=6.0), dive(seed), dive(seed, on_deck=(7.0, 18.0, 37.0)[seed])):
        for name, files in kinds(log).items():
            path = tmp_path / f"{name}{len(list(tmp_path.iterdir()))}"
            assert [entry.says for entry in findings(path, files)] == []


def test_the_origin_of_an_import_is_the_first_row_that_is_a_fix(tmp_path: Path) -> None:
    log = tmp_path / "gps.csv"
    log.write_text("t,lat,lon\n0,0,0\n1,0,0\n2,54.25,10.5\n3,54.25001,10.5\n")
    mapping = '[fixes]\ntime_s = "t"\nlat_deg = "lat"\nlon_deg = "lon"\nsigma_x_m = 1\nsigma_y_m = 1\n'
    imported = import_logs([log], Mapping(mapping, "mapping.toml"))
    assert imported.files["origin.csv"].decode().splitlines()[1] == "54.25,10.5"
    assert "the origin x = y = 0 is the first place of [fixes]: 54.25, 10.5 deg" in imported.notes
