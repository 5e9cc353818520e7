"""Clocks, depths and headings of missions of every kind: what is spoiled is named, and what only looks so is not."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nls
from models.algebra import Array
from nls.missions.checks.agreement import of_fixes
from nls.missions.checks.alone import tilt_of
from nls.missions.checks.clocks import clocks_by_spans
from nls.missions.checks.findings import Cause
from nls.missions.checks.inspection import implausible
from nls.missions.checks.log import Fixes, Log
from nls.missions.folder.columns import COLUMNS, OPTIONAL
from nls.missions.folder.table import Table
from tests.combinations import for_all
from tests.nls.missions.checks.missions import dive, files_of, kinds, path_of, with_fixes
from tests.nls.missions.checks.test_special import changed, findings
from tests.nls.missions.checks.vehicle import clean
from tests.nls.missions.folder.mission_files import folder

Change = Callable[[list[str], Array], Array]


def column(name: str, change: Callable[[Array], Array]) -> Change:
    """One column changed."""

    def apply(names: list[str], numbers: Array) -> Array:
        numbers[:, names.index(name)] = change(numbers[:, names.index(name)])
        return numbers

    return apply


LATE = [
    ("fixes", late, kind) for late in (18.0, -18.0, 37.0, 25.0, 3600.0, -7200.0, 604800.0) for kind in ("log", "path")
]
LATE += [("depth", late, "log") for late in (18.0, -37.0)]


@for_all(case=LATE, seed=[1])
def test_a_clock_that_is_off_is_named_with_the_offset(case: tuple[str, float, str], seed: int, tmp_path: Path) -> None:
    table, late, kind = case
    files = changed(kinds(dive(seed))[kind], table, column("time_s", lambda t: t + late))
    (finding, *_) = findings(tmp_path / f"{table}{kind}{late}{seed}", files)
    (reading,) = finding.readings
    assert (reading.cause, reading.file) == (Cause.ZONE, f"{table}.csv")
    assert abs(reading.factor - late) < 1.5  # the rows are a second apart
    if table == "fixes" and late in (18.0, 3600.0):
        act = f"subtract {late:g} s from time_s, or write `offset = {-late:g}` for time_s in [fixes] of the mapping"
        assert act in finding.says


@for_all(seed=[1, 2], on_deck=[5.0, 18.0, 37.0, 600.0])
def test_a_receiver_that_is_on_before_and_after_the_dive_has_the_right_clock(
    seed: int, on_deck: float, tmp_path: Path
) -> None:
    log = dive(seed, on_deck)
    for kind, files in kinds(log).items():
        assert findings(tmp_path / f"{kind}{seed}{on_deck}", files) == []
    late = changed(with_fixes(log), "fixes", lambda _, y: y[y[:, 0] > -on_deck + 18.0])  # switched on late
    assert findings(tmp_path / f"late{seed}{on_deck}", late) == []


def test_fixes_by_sound_are_under_water_at_any_time(tmp_path: Path) -> None:
    """USBL throughout, USBL for a part of the dive, and fixes that are held for a few seconds after diving."""
    log = dive(4)
    usbl = with_fixes(replace(log, fixes=clean(4, minutes=12.0).fixes))
    way = log.way()[::25, :2]
    usbl = changed(usbl, "fixes", lambda names, y: np.column_stack([y[:, 0], way[: len(y)], y[:, 3:]]))
    part = changed(usbl, "fixes", lambda _, y: y[20:60])
    held = changed(with_fixes(dive(4, 60.0)), "fixes", lambda _, y: np.vstack([y[:60], y[60:67], y[67:]]))
    held = changed(held, "fixes", column("time_s", lambda t: np.where((t > 0) & (t < 7), t * 2.5, t)))
    for name, files in (("all", usbl), ("part", part), ("held", held)):
        assert [entry for entry in findings(tmp_path / name, files) if entry.check == "under water"] == []


@for_all(table=["fixes", "ahrs", "depth", "dvl"], factor=[1e3, 1e6, 1 / 86400.0])
def test_times_of_one_table_in_another_unit(table: str, factor: float, tmp_path: Path) -> None:
    files = changed(with_fixes(dive(2)), table, column("time_s", lambda t: factor * t))
    (finding,) = findings(tmp_path / f"{table}{factor}", files)
    assert (finding.file, finding.readings[0].cause) == (f"{table}.csv", Cause.UNIT)
    assert np.isclose(finding.readings[0].factor, factor)


def test_days_of_a_spreadsheet(tmp_path: Path) -> None:
    path = changed(path_of(replace(dive(3), fixes=None)), "path", column("time_s", lambda t: 45631.9 + t / 86400.0))
    (finding,) = findings(tmp_path / "days", path)
    assert 'unit = "day"' in finding.says


DEPTHS: dict[str, tuple[Callable[[Array], Array], Cause, float]] = {
    "up": (lambda z: -z - 2.5, Cause.SIGN, -1.0),
    "absolute, dbar": (lambda z: z + 10.1325, Cause.PRESSURE, 1.0),
    "absolute, kPa": (lambda z: 10 * z + 101.325, Cause.PRESSURE, 10.0),
    "absolute, hPa": (lambda z: 100 * z + 1013.25, Cause.PRESSURE, 100.0),
    "absolute, Pa": (lambda z: 1e4 * z + 101325.0, Cause.PRESSURE, 1e4),
}


@for_all(name=list(DEPTHS), kind=["depth", "path"], seed=[1])
def test_a_depth_of_another_sign_or_with_the_air_is_named(name: str, kind: str, seed: int, tmp_path: Path) -> None:
    change, cause, factor = DEPTHS[name]
    files = with_fixes(dive(seed)) if kind == "depth" else path_of(dive(seed))
    found = findings(tmp_path / f"{name[-3:]}{kind}{seed}", changed(files, kind, column("z_m", change)))
    first = [(entry.file, entry.readings[0].cause, entry.readings[0].factor) for entry in found]
    assert (f"{kind}.csv", cause, factor) in first[:1], [entry.says for entry in found]
    if cause is Cause.PRESSURE:
        assert "`offset = -10.1325` for z_m in [" in found[0].says


def test_a_vehicle_ten_meters_deep_has_no_air_in_its_depth(tmp_path: Path) -> None:
    """Its fixes are by sound, at every depth; or there are none."""
    log = dive(5)
    deep = replace(log, z=log.z + 10.1)
    usbl = replace(deep, fixes=replace(clean(5, minutes=12.0).fixes, p=log.way()[::25, :2]))  # type: ignore[type-var]
    assert [entry for entry in findings(tmp_path / "usbl", with_fixes(usbl)) if entry.column == "z_m"] == []
    assert [entry for entry in findings(tmp_path / "none", files_of(deep)) if entry.column == "z_m"] == []
    level = path_of(replace(usbl, z=10.1 + 0.02 * np.sin(log.t_z)))
    assert [entry for entry in findings(tmp_path / "level", level) if entry.column == "z_m"] == []


@for_all(name=["x", "y", "swapped"], seed=[1])
def test_a_path_that_goes_elsewhere_than_its_heading(name: str, seed: int, tmp_path: Path) -> None:
    def mirror(names: list[str], y: Array) -> Array:
        y[:, 1:3] = {"x": y[:, 1:3] * [-1, 1], "y": y[:, 1:3] * [1, -1], "swapped": y[:, 2:0:-1]}[name]
        return y

    files = path_of(replace(clean(seed), fixes=None))
    (finding,) = findings(tmp_path / f"{name}{seed}", changed(files, "path", mirror))
    expected = {"x": (Cause.SIGN, "x_m"), "y": (Cause.SIGN, "y_m"), "swapped": (Cause.SWAPPED, "x_m, y_m")}[name]
    assert (finding.readings[0].cause, finding.readings[0].column) == expected


def test_a_vehicle_that_goes_sideways_has_no_other_axes(tmp_path: Path) -> None:
    """A remotely operated vehicle: its heading is free of its way. Another one goes north all the time."""

    def sideways(names: list[str], y: Array) -> Array:
        yaw = np.cumsum(np.random.default_rng(1).normal(0, 0.1, len(y)))
        y[:, names.index("yaw_rad")] = (yaw + np.pi) % (2 * np.pi) - np.pi
        return y

    def north(names: list[str], y: Array) -> Array:
        y[:, names.index("yaw_rad")] = 0.0
        y[:, 1:3] = np.column_stack([1.4 * y[:, 0], 0 * y[:, 0]])
        return y

    files = path_of(replace(clean(2), fixes=None))
    assert findings(tmp_path / "rov", changed(files, "path", sideways)) == []
    assert findings(tmp_path / "north", changed(files, "path", north)) == []


def earth(log: Log, east_first: bool) -> Log:
    """Velocities along north and east, or east and north."""
    yaw = np.interp(log.t_v, log.t_a, np.unwrap(log.rpy[:, 2]))
    north = log.v[:, 0] * np.cos(yaw) - log.v[:, 1] * np.sin(yaw)
    east = log.v[:, 0] * np.sin(yaw) + log.v[:, 1] * np.cos(yaw)
    both = [east, north] if east_first else [north, east]
    return replace(log, v=np.column_stack([*both, log.v[:, 2]]))


@for_all(east_first=[False, True], seed=[1, 2])
def test_velocities_in_axes_of_the_world(east_first: bool, seed: int, tmp_path: Path) -> None:
    files = with_fixes(earth(clean(seed, drop_outs=False), east_first))
    found = findings(tmp_path / f"{east_first}{seed}", files)
    assert [entry.readings[0].cause for entry in found] == [Cause.EARTH]
    assert found[0].readings[0].factor == (-1.0 if east_first else 1.0)


@for_all(seed=[1, 2])
def test_a_path_and_a_compass_beside_a_motion_turn_in_radians(seed: int, tmp_path: Path) -> None:
    log = clean(seed)
    for table, files in (("path", path_of(replace(log, fixes=None))), ("ahrs", {"ahrs": files_of(log)["ahrs"]})):
        for factor in (np.pi / 180, 1.0, 100.0):  # radians; degrees and hundredths of one in their place
            turned = changed(files, table, column("yaw_rad", lambda yaw, f=factor: np.degrees(yaw) * f))  # type: ignore[misc]
            (tmp_path / f"{table}.csv").write_text(turned[table])
            found = implausible(
                {table: Table(tmp_path / f"{table}.csv", COLUMNS[table], OPTIONAL.get(table, ()))}, None
            )
            named = [(entry.check, entry.file, round(entry.readings[0].factor, 2)) for entry in found]
            assert named == [("turn rate", f"{table}.csv", round(factor * 180 / np.pi, 2))] * (factor >= 1)


def test_a_glider_dives_steeply_in_radians() -> None:
    """Degrees in a column of radians go beyond a quarter turn."""
    pitch = np.tile([0.46, -0.65, 0.6, -0.88], 50)
    assert list(tilt_of("ahrs.csv", "pitch_rad", pitch)) == []
    (finding,) = tilt_of("ahrs.csv", "pitch_rad", np.degrees(pitch))
    assert finding.readings[0].cause is Cause.UNIT


@for_all(away=[0.0, 4e5])
def test_a_voyage_is_far_from_any_origin_and_a_site_is_not(away: float) -> None:
    t = np.arange(200.0)
    voyage = np.column_stack([away + 6e3 * (t - 50), 2e3 * t])
    none = np.zeros(len(t), dtype=bool)
    fixes = Fixes(t, voyage, np.ones(len(t)), ("lat_deg", "lon_deg"), np.arange(len(t)))
    assert of_fixes(fixes, none) == []
    (finding,) = of_fixes(replace(fixes, p=np.array([4e5, 1e5]) + voyage / 1e4), none)
    assert finding.check == "far away"


@for_all(factor=[1e3, 1e6])
def test_a_log_that_is_no_log_in_seconds_is_refused_before_its_poses_are_made(factor: float, tmp_path: Path) -> None:
    files = with_fixes(clean(1))
    for table in ("dvl", "ahrs", "depth", "fixes"):
        files = changed(files, table, column("time_s", lambda t: factor * t))
    unit = {1e3: "ms", 1e6: "us"}[factor]
    cure = f'divide time_s by {factor:g}, or write `unit = "{unit}"` for time_s in [dvl] of the mapping'
    with pytest.raises(nls.GraphFileError, match=r"dvl\.csv:3: no log of sensors") as e:
        nls.load(folder(tmp_path / unit, files))
    assert cure in str(e.value)


@for_all(table=["dvl", "ahrs", "depth"], late=[18.0, -18.0, 25.0])
def test_a_sensor_that_begins_and_ends_late_has_a_late_clock(table: str, late: float, tmp_path: Path) -> None:
    (finding,) = findings(
        tmp_path / f"{table}{late}", changed(with_fixes(clean(1)), table, column("time_s", lambda t: t + late))
    )
    assert (finding.readings[0].cause, finding.readings[0].file) == (Cause.ZONE, f"{table}.csv")
    assert abs(finding.readings[0].factor - late) < 1.0


def test_sensors_that_are_switched_on_and_off_one_after_the_other_have_right_clocks(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    files = with_fixes(clean(3))
    names = ("dvl", "ahrs", "depth")
    tables = {
        name: Table(tmp_path / f"{name}.csv", COLUMNS[name], OPTIONAL.get(name, ()), data=files[name].encode())
        for name in names
    }
    for trial in range(200):
        cut = {}
        for name, table in tables.items():
            begin, end = rng.uniform(0, 15, 2)
            t = table.floats("time_s")[:, 0]
            cut[name] = copy(table)
            cut[name].lines = table.lines[(t >= t[0] + begin) & (t <= t[-1] - end)]
        assert clocks_by_spans(cut) == [], trial


@for_all(seed=[1], wild=[30, 31])
def test_wild_headings_are_named_also_side_by_side_and_turns_of_the_number_are_none(
    seed: int, wild: int, tmp_path: Path
) -> None:
    """A heading that goes from 3.1 to -3.1 rad has not moved."""

    def spoiled(yaw: Array) -> Array:
        yaw = yaw.copy()
        yaw[wild::40] += 1.5
        yaw[31::200] += 2.5
        return yaw

    files = changed(with_fixes(clean(seed)), "ahrs", column("yaw_rad", spoiled))
    (finding,) = [entry for entry in findings(tmp_path / f"{seed}{wild}", files) if entry.check == "outliers"]
    rows = np.arange(len(files["ahrs"].splitlines()) - 1)
    assert set(np.array(finding.lines) - 2) == set(rows[wild::40]) | set(rows[31::200])
    whole = changed(with_fixes(clean(seed)), "ahrs", column("yaw_rad", lambda yaw: np.remainder(yaw + 2, 2 * np.pi)))
    assert not any(entry.check == "outliers" for entry in findings(tmp_path / f"{seed}{wild}turns", whole))
