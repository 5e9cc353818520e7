"""Clocks, depths and headings of missions of every kind: what is spoiled is named, and what only looks so is not."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nls
from models.algebra import Array
from nls.missions.checks.agreement import clocks_by_spans, of_fixes
from nls.missions.checks.alone import tilt_of
from nls.missions.checks.findings import Cause, Implausible, Reading
from nls.missions.checks.log import Fixes, Log
from nls.missions.checks.words import UNITS
from nls.missions.importing.headers import dimension, mission_unit
from tests.combinations import for_all
from tests.nls.missions.checks.missions import (
    Change,
    changed,
    clean,
    dive,
    files_of,
    findings,
    kinds,
    path_of,
    tables_of,
    with_fixes,
)
from tests.nls.missions.folder.mission_files import folder

HOUR = 3600.0
LATE = [("fixes", s, kind) for s in (18.0, -18.0, 37.0, 25.0, HOUR, -2 * HOUR, 168 * HOUR) for kind in ("log", "path")]


@for_all(case=[*LATE, ("depth", 18.0, "log"), ("depth", -37.0, "log")])
def test_a_clock_that_is_off_is_named_with_the_offset(case: tuple[str, float, str]) -> None:
    table, late, kind = case
    (finding, *_) = findings(changed(kinds(dive(1))[kind], table, time_s=lambda t: t + late))
    (reading,) = finding.readings
    assert (reading.cause, reading.file) == (Cause.ZONE, f"{table}.csv")
    assert abs(reading.factor - late) < 1.5  # the rows are a second apart
    if table == "fixes" and late in (18.0, HOUR):
        act = f"subtract {late:g} s from time_s, or write `offset = {-late:g}` for time_s in [fixes] of the mapping"
        assert act in finding.says


@for_all(seed=[1, 2], on_deck=[5.0, 18.0, 37.0, 600.0])
def test_a_receiver_that_is_on_before_and_after_the_dive_has_the_right_clock(seed: int, on_deck: float) -> None:
    """Also where it was switched on late."""
    log = dive(seed, on_deck)
    late = changed(with_fixes(log), "fixes", lambda y: y[y[:, 0] > -on_deck + 18.0])
    assert [findings(files) for files in (*kinds(log).values(), late)] == [[]] * 4


def test_fixes_by_sound_are_under_water_at_any_time() -> None:
    """USBL throughout, USBL for a part of the dive, and fixes that are held for a few seconds after diving."""
    log = dive(4)
    usbl, way = with_fixes(replace(log, fixes=clean(4, minutes=12.0).fixes)), log.way()[::25, :2]
    usbl = changed(usbl, "fixes", lambda y: np.column_stack([y[:, 0], way[: len(y)], y[:, 3:]]))
    part = changed(usbl, "fixes", lambda y: y[20:60])
    held = changed(with_fixes(dive(4, 60.0)), "fixes", time_s=lambda t: np.where((t > 0) & (t < 7), t * 2.5, t))
    assert "under water" not in [entry.check for files in (usbl, part, held) for entry in findings(files)]


@for_all(table=["fixes", "ahrs", "depth", "dvl"], factor=[1e3, 1e6, 1 / 86400.0])
def test_times_of_one_table_in_another_unit(table: str, factor: float) -> None:
    (finding,) = findings(changed(with_fixes(dive(2)), table, time_s=lambda t: factor * t))
    assert (finding.file, finding.readings[0].cause) == (f"{table}.csv", Cause.UNIT)
    assert np.isclose(finding.readings[0].factor, factor)


def test_days_of_a_spreadsheet() -> None:
    path = path_of(replace(dive(3), fixes=None))
    (finding,) = findings(changed(path, "path", time_s=lambda t: 45631.9 + t / 86400.0))
    assert 'unit = "day"' in finding.says


@for_all(
    case=[
        (lambda z: -z - 2.5, Cause.SIGN, -1.0),
        (lambda z: z + 10.1325, Cause.PRESSURE, 1.0),  # dbar, kPa, hPa and Pa
        (lambda z: 10 * z + 101.325, Cause.PRESSURE, 10.0),
        (lambda z: 100 * z + 1013.25, Cause.PRESSURE, 100.0),
        (lambda z: 1e4 * z + 101325.0, Cause.PRESSURE, 1e4),
    ],
    kind=["depth", "path"],
)
def test_a_depth_of_another_sign_or_with_the_air_is_named(case: tuple[Change, Cause, float], kind: str) -> None:
    files = with_fixes(dive(1)) if kind == "depth" else path_of(dive(1))
    (first, *_) = findings(changed(files, kind, z_m=case[0]))
    assert (first.file, first.readings[0].cause, first.readings[0].factor) == (f"{kind}.csv", *case[1:])
    assert case[1] is Cause.SIGN or "`offset = -10.1325` for z_m in [" in first.says


def test_a_vehicle_ten_meters_deep_has_no_air_in_its_depth() -> None:
    """Fixes by sound are there at every depth, or there are none."""
    log = dive(5)
    deep, fixes = replace(log, z=log.z + 10.1), clean(5, minutes=12.0).fixes
    assert fixes is not None
    usbl = replace(deep, fixes=replace(fixes, p=log.way()[::25, :2]))
    level = path_of(replace(usbl, z=10.1 + 0.02 * np.sin(log.t_z)))
    assert "z_m" not in [
        entry.column for files in (with_fixes(usbl), files_of(deep), level) for entry in findings(files)
    ]


@for_all(
    case=[
        (lambda p: p * [-1, 1], Cause.SIGN, "x_m"),
        (lambda p: p * [1, -1], Cause.SIGN, "y_m"),
        (lambda p: p[:, ::-1], Cause.SWAPPED, "x_m, y_m"),
    ]
)
def test_a_path_that_goes_elsewhere_than_its_heading(case: tuple[Change, Cause, str]) -> None:
    def moved(y: Array) -> Array:
        return np.column_stack([y[:, 0], case[0](y[:, 1:3]), y[:, 3:]])

    (finding,) = findings(changed(path_of(replace(clean(1), fixes=None)), "path", moved))
    assert (finding.readings[0].cause, finding.readings[0].column) == case[1:]


def test_a_vehicle_that_goes_sideways_has_no_other_axes() -> None:
    """A remotely operated vehicle, whose heading is free of its way; and another one that goes north all the time."""

    def sideways(yaw: Array) -> Array:
        return (np.cumsum(np.random.default_rng(1).normal(0, 0.1, len(yaw))) + np.pi) % (2 * np.pi) - np.pi

    def north(y: Array) -> Array:
        return np.column_stack([y[:, 0], 1.4 * y[:, 0], 0 * y[:, 0], y[:, 3], 0 * y[:, 0], y[:, 5:]])

    files = path_of(replace(clean(2), fixes=None))
    assert findings(changed(files, "path", yaw_rad=sideways)) == []
    assert findings(changed(files, "path", north)) == []


def earth(log: Log, east_first: bool) -> Log:
    """Velocities along north and east, or east and north."""
    yaw = np.interp(log.t_v, log.t_a, np.unwrap(log.rpy[:, 2]))
    v = (log.v[:, 0] + 1j * log.v[:, 1]) * np.exp(1j * yaw)
    both = [v.imag, v.real] if east_first else [v.real, v.imag]
    return replace(log, v=np.column_stack([*both, log.v[:, 2]]))


@for_all(east_first=[False, True], seed=[1, 2])
def test_velocities_in_axes_of_the_world(east_first: bool, seed: int) -> None:
    (finding,) = findings(with_fixes(earth(clean(seed, drop_outs=False), east_first)))
    assert finding.readings[0].cause is Cause.EARTH
    assert finding.readings[0].factor == (-1.0 if east_first else 1.0)


@for_all(seed=[1, 2], table=["path", "ahrs"], factor=[np.pi / 180, 1.0, 100.0])
def test_a_path_and_a_compass_beside_a_motion_turn_in_radians(seed: int, table: str, factor: float) -> None:
    """Radians, and degrees and hundredths of one in their place."""
    log = replace(clean(seed), fixes=None)
    files = path_of(log) if table == "path" else {"ahrs": files_of(log)["ahrs"]}
    found = findings(changed(files, table, yaw_rad=lambda yaw: np.degrees(yaw) * factor))
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


@for_all(case=[(1e3, "ms"), (1e6, "us")])
def test_a_log_that_is_no_log_in_seconds_is_refused_before_its_poses_are_made(
    case: tuple[float, str], tmp_path: Path
) -> None:
    files = with_fixes(clean(1, minutes=4.0))
    for table in ("dvl", "ahrs", "depth", "fixes"):
        files = changed(files, table, time_s=lambda t: case[0] * t)
    with pytest.raises(nls.GraphFileError, match=r"dvl\.csv:3: no log of sensors") as e:
        nls.load(folder(tmp_path / case[1], files))
    cure = f'divide time_s by {case[0]:g}, or write `unit = "{case[1]}"` for time_s in [dvl] of the mapping'
    assert cure in str(e.value)


@for_all(table=["dvl", "ahrs", "depth"], late=[18.0, -18.0, 25.0])
def test_a_sensor_that_begins_and_ends_late_has_a_late_clock(table: str, late: float) -> None:
    (finding,) = findings(changed(with_fixes(clean(1)), table, time_s=lambda t: t + late))
    assert (finding.readings[0].cause, finding.readings[0].file) == (Cause.ZONE, f"{table}.csv")
    assert abs(finding.readings[0].factor - late) < 1.0


def test_sensors_that_are_switched_on_and_off_one_after_the_other_have_right_clocks() -> None:
    rng, tables = np.random.default_rng(0), tables_of(files_of(clean(3)))
    del tables["noise"]
    for trial in range(200):
        cut = {}
        for name, table in tables.items():
            (begin, end), t = rng.uniform(0, 15, 2), table.floats("time_s")[:, 0]
            cut[name] = table.part((t >= t[0] + begin) & (t <= t[-1] - end))
        assert clocks_by_spans(cut) == [], trial


@for_all(wild=[30, 31])
def test_wild_headings_are_named_also_side_by_side_and_turns_of_the_number_are_none(wild: int) -> None:
    """A heading that goes from 3.1 to -3.1 rad has not moved."""
    files = with_fixes(clean(1))
    rows = np.arange(len(files["ahrs"].splitlines()) - 1)
    added = np.where(rows % 40 == wild, 1.5, 0.0) + np.where(rows % 200 == 31, 2.5, 0.0)
    found = findings(changed(files, "ahrs", yaw_rad=lambda yaw: yaw + added))
    (finding,) = [entry for entry in found if entry.check == "outliers"]
    assert finding.lines == tuple(rows[added > 0] + 2)
    whole = findings(changed(files, "ahrs", yaw_rad=lambda yaw: np.remainder(yaw + 2, 2 * np.pi)))
    assert "outliers" not in [entry.check for entry in whole]


@for_all(case=[(end, factor) for end, units in UNITS.items() if end != "_pa" for factor in units])
def test_a_unit_that_is_advised_is_one_of_a_mapping(case: tuple[str, float]) -> None:
    """Or a scale stands for it, as for a depth in kPa."""
    end, factor = case
    column = {"_m_s": "vx_m_s", "_m": "x_m", "_rad": "yaw_rad", "_deg": "lat_deg"}.get(end, end)
    readings = (Reading(Cause.UNIT, "dvl.csv", column, factor),)
    says = Implausible("speed", "dvl.csv", 2, column, 900.0, 10.0, "m/s", readings).says
    if unit := re.search('`unit = "(.+?)"`', says):
        assert dimension(unit[1]) == mission_unit(column)[0]
    else:
        assert float(re.search("`scale = (.+?)`", says)[1]) * factor == pytest.approx(1, rel=1e-4)
