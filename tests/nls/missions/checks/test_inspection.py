"""Spoiled logs and tables of every vehicle are named with their cause, and right ones are not."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim
from models import SE3
from models.algebra import Array, wrap
from nls.cli import main
from nls.missions import read_mission, write_mission
from nls.missions.checks.findings import Cause, Reading
from nls.missions.checks.inspection import of_log
from nls.missions.checks.log import FROM_NORTH, Fixes, Log, readings
from nls.missions.folder.folder import read_tables
from tests.combinations import for_all
from tests.nls.missions.checks.missions import SIGMAS, Change, changed, clean, files_of, findings
from tests.nls.missions.folder.mission_files import TINY, csv, folder
from tests.nls.missions.folder.test_damaged import WHOLE

V = "vx_m_s, vy_m_s, vz_m_s"
DEG = 180 / np.pi
Spoil = Callable[[Log], Log]


def velocities(A: object) -> Spoil:
    return lambda log: replace(log, v=log.v @ np.array(A, dtype=float).T)


def angles(change: Callable[[Array], Array]) -> Spoil:
    return lambda log: replace(log, rpy=np.remainder(change(log.rpy) + np.pi, 2 * np.pi) - np.pi)


def depths(factor: float) -> Spoil:
    return lambda log: replace(log, z=factor * log.z)


def moved(log: Log, change: Callable[[Fixes], Fixes]) -> Log:
    assert log.fixes is not None
    return replace(log, fixes=change(log.fixes))


def late(name: str, lag: float) -> Spoil:
    return lambda log: replace(log, **{name: getattr(log, name) + lag})


def times(factor: float) -> Spoil:
    def scaled(log: Log) -> Log:
        return replace(log, **{name: factor * getattr(log, name) for name in ("t_v", "t_a", "t_z")})

    return lambda log: moved(scaled(log), lambda fixes: replace(fixes, t=factor * fixes.t))


def scattered(y: Array, size: float, every: int = 20) -> Array:
    """One of so many rows far off."""
    rng, y = np.random.default_rng(7), np.array(y)
    rows = rng.choice(len(y), len(y) // every, replace=False)
    y[rows] += rng.normal(0, size, y[rows].shape)
    return y


def sigma(name: str, factor: float) -> Spoil:
    return lambda log: replace(log, sigmas=log.sigmas | {name: factor * log.sigmas[name]})


def of(cause: Cause, file: str, column: str, factor: float = 1.0) -> Reading:
    return Reading(cause, file + ".csv", column, factor)


SPOILS: dict[str, tuple[Spoil, Reading]] = {
    "velocity in mm/s": (velocities(1000 * np.eye(3)), of(Cause.UNIT, "dvl", V, 1000.0)),
    "velocity in cm/s": (velocities(100 * np.eye(3)), of(Cause.UNIT, "dvl", V, 100.0)),
    "velocity in knots": (velocities(1.9438 * np.eye(3)), of(Cause.UNIT, "dvl", V, 1.9438)),
    "velocity in feet/s": (velocities(3.2808 * np.eye(3)), of(Cause.UNIT, "dvl", V, 3.2808)),
    "vx astern": (velocities(np.diag([-1, 1, 1])), of(Cause.SIGN, "dvl", "vx_m_s", -1.0)),
    "vz up": (velocities(np.diag([1, 1, -1])), of(Cause.SIGN, "dvl", "vz_m_s", -1.0)),
    "vx and vy swapped": (velocities([[0, 1, 0], [1, 0, 0], [0, 0, 1]]), of(Cause.SWAPPED, "dvl", "vx_m_s, vy_m_s")),
    "vx and vz swapped": (velocities([[0, 0, 1], [0, 1, 0], [1, 0, 0]]), of(Cause.SWAPPED, "dvl", "vx_m_s, vz_m_s")),
    "FLU": (velocities(np.diag([1, -1, -1])), of(Cause.AXES, "dvl", V)),
    "yaw in degrees": (lambda log: replace(log, rpy=log.rpy * [1, 1, DEG]), of(Cause.UNIT, "ahrs", "yaw_rad", DEG)),
    "roll and pitch swapped": (angles(lambda a: a[:, [1, 0, 2]]), of(Cause.SWAPPED, "ahrs", "roll_rad, pitch_rad")),
    "pitch with the bow down": (angles(lambda a: a * [1, -1, 1]), of(Cause.SIGN, "ahrs", "pitch_rad", -1.0)),
    "pitch in degrees": (lambda log: replace(log, rpy=log.rpy * [1, DEG, 1]), of(Cause.UNIT, "ahrs", "pitch_rad", DEG)),
    "roll in degrees": (lambda log: replace(log, rpy=log.rpy * [DEG, 1, 1]), of(Cause.UNIT, "ahrs", "roll_rad", DEG)),
    "roll upside down": (angles(lambda a: a + np.array([np.pi, 0, 0])), of(Cause.AXES, "ahrs", "roll_rad")),
    "depth negative": (depths(-1), of(Cause.SIGN, "depth", "z_m", -1.0)),
    "depth in feet": (depths(3.2808), of(Cause.UNIT, "depth", "z_m", 3.2808)),
    "depth in cm": (depths(100), of(Cause.UNIT, "depth", "z_m", 100.0)),
    "depth in kPa": (depths(10), of(Cause.UNIT, "depth", "z_m", 10.0)),
    "depth 30 % too large": (depths(1.3), of(Cause.SCALE, "depth", "z_m", 1.3)),
    "depth constant": (lambda log: replace(log, z=np.full_like(log.z, 12.0)), of(Cause.STUCK, "depth", "z_m")),
    "AHRS early by 6 s": (late("t_a", -6.0), of(Cause.CLOCK, "ahrs", "time_s", -6.0)),
    "AHRS late by 5 s": (late("t_a", 5.0), of(Cause.CLOCK, "ahrs", "time_s", 5.0)),
    "depth late by 5 s": (late("t_z", 5.0), of(Cause.CLOCK, "depth", "time_s", 5.0)),
    "times in ms": (times(1e3), of(Cause.UNIT, "dvl", "time_s", 1e3)),
    "times in ns": (times(1e9), of(Cause.UNIT, "dvl", "time_s", 1e9)),
    "valid inverted": (lambda log: replace(log, valid=~log.valid), of(Cause.INVERTED, "dvl", "valid")),
    "outliers of the DVL": (lambda log: replace(log, v=scattered(log.v, 3.0)), of(Cause.OUTLIERS, "dvl", V)),
    "outliers of the depth": (lambda log: replace(log, z=scattered(log.z, 20.0)), of(Cause.OUTLIERS, "depth", "z_m")),
    "outliers of the fixes": (
        lambda log: moved(log, lambda fixes: replace(fixes, p=scattered(fixes.p, 40.0, 15))),
        of(Cause.OUTLIERS, "fixes", "x_m, y_m"),
    ),
    "sigma of the yaw a variance": (sigma("sigma_yaw_rad", 0.01), of(Cause.SIGMA, "noise", "sigma_yaw_rad")),
    "sigma of the velocity too small": (sigma("sigma_v_m_s", 0.05), of(Cause.SIGMA, "noise", "sigma_v_m_s")),
    "sigma of the depth too small": (sigma("sigma_z_m", 0.05), of(Cause.SIGMA, "noise", "sigma_z_m")),
}


def same(a: Reading, b: Reading) -> bool:
    """Whether two readings say the same; a ratio of sigmas and a lag of a clock are estimates."""
    if (a.cause, a.file, a.column) != (b.cause, b.file, b.column):
        return False
    return b.cause is Cause.SIGMA or abs(a.factor - b.factor) <= 0.25 * abs(b.factor)


@for_all(name=list(SPOILS))
def test_a_spoiled_log_is_named_with_its_cause(name: str) -> None:
    spoil, reading = SPOILS[name]
    findings = of_log(spoil(clean(3)))
    named = [reading for entry in findings for reading in entry.readings]
    assert any(same(entry, reading) for entry in named), named
    assert len(named) <= 4, named
    for entry in findings:
        assert re.match(rf"{entry.file}:\d+: {entry.column} is implausible: [^{{]+Probable cause: [^{{]+$", entry.says)


@for_all(seed=list(range(10)))
def test_a_right_log_is_plausible(seed: int) -> None:
    log = clean(seed, drop_outs=seed % 2 == 0)
    assert of_log(log) == []
    assert of_log(replace(log, fixes=None)) == []


@for_all(number=list(range(1, 8)), every=[0, 5, 20])
def test_a_real_log_is_plausible(number: int, every: int, data: Path, script: Callable[[str], Any]) -> None:
    """Attitude, depth and fixes (a meter) are those of the truth with noise, the DVL is as measured."""
    real = script("logs").read_auv_dvl(data / "underwater-auv-dvl", number)
    rng = np.random.default_rng(number)
    t, n, sigmas = real.t, len(real.t), SIGMAS | {"sigma_v_m_s": 0.02, "sigma_z_m": 0.05}
    rows = np.arange(0, n, every or 1)
    p = real.p[rows, :2] + rng.normal(0, 1.0, (len(rows), 2))
    fixes = Fixes(t[rows], p, np.full(len(rows), 2**0.5), ("x_m", "y_m"), rows) if every else None
    rpy, z = real.rpy + rng.normal(0, 0.003, (n, 3)), real.p[:, 2] + rng.normal(0, 0.05, n)
    log = Log(t, real.v_d, np.ones(n, dtype=bool), t, rpy, t, z, SE3.identity()[0], sigmas, fixes)
    assert [entry.says for entry in of_log(log)] == []


def test_a_short_lag_is_no_cause_as_a_lever_arm_looks_the_same() -> None:
    """1 s at 1.4 m/s is the same as a DVL 1.4 m ahead of where it is said to be."""
    log = clean(4)
    late = of_log(replace(log, t_a=log.t_a + 1.0))
    ahead = of_log(replace(log, mount=np.concatenate([[-1.4, 0.0, 0.0], log.mount[3:]])))
    assert [entry.readings for entry in (*late, *ahead) if entry.readings[0].cause is Cause.CLOCK] == []


def test_a_velocity_without_another_sensor_that_tells_has_several_units() -> None:
    """The depth does not change and there are no fixes: 300 may be in mm/s or cm/s."""
    log = clean(1)
    level = replace(log, v=300 / 1.4 * log.v, z=9.0 + 0.01 * np.sin(log.t_z), fixes=None)
    finding = of_log(level)[0]
    assert [reading.factor for reading in finding.readings] == [1000.0, 100.0]
    assert re.search("mm/s.*cm/s", finding.says)


def test_fixes_that_jump_are_no_disagreement_of_sensors() -> None:
    """Few windows, several of them with a fix that jumps: its outliers are the cause, not another reading."""
    log = clean(18, minutes=2.0)
    fixes, rng = log.fixes, np.random.default_rng(18)
    assert fixes is not None
    t = np.linspace(log.t_v[0], log.t_v[-1], 60)
    p = np.column_stack([np.interp(t, fixes.t, column) for column in fixes.p.T]) + rng.normal(0, 0.5, (60, 2))
    rows = np.sort(rng.choice(np.arange(2, 58), 3, replace=False))
    p[rows, 0] += 50.0
    jumping = replace(fixes, t=t, p=p, sigma=np.full(60, 0.7), rows=np.arange(60))
    (finding,) = of_log(replace(log, fixes=jumping))
    assert (finding.check, finding.line) == ("jumps", rows[0])
    assert finding.readings == (Reading(Cause.OUTLIERS, "fixes.csv", "x_m, y_m"),)


@for_all(seed=[2, 3])
def test_fixes_far_away_may_have_latitude_and_longitude_exchanged_or_of_another_side(seed: int) -> None:
    log = clean(seed)
    assert log.fixes is not None
    away = log.fixes.p + np.array([4e6, -4e6])
    others = (
        Reading(Cause.SWAPPED, "fixes.csv", "lat_deg, lon_deg"),
        Reading(Cause.SIGN, "fixes.csv", "lon_deg", -1.0),
    )
    for near in (*others, None):
        read = tuple((reading, log.fixes.p if reading == near else away) for reading in others)
        fixes = replace(log.fixes, p=away, others=read, columns=("lat_deg", "lon_deg"))
        reading = of_log(replace(log, fixes=fixes))[-1].readings[0]
        assert reading == near or (near is None and reading.cause is Cause.FAR)


ZPR, POSES, DEEP = TINY["zpr"], "i,time_s\n0,0\n1,{0}1\n2,{0}2\n3,{0}3\n", "zpr.csv:2: z_m is implausible: a depth of "
SPEEDS = "z_m,sound_speed_m_s\n0,1490\n10,{}\n"
SPEED = "sound-speed.csv:3: "


@for_all(
    case=[
        ({"sound-speed": SPEEDS.format(4921.0)}, SPEED, "divide sound_speed_m_s by 3.2808"),
        ({"sound-speed": SPEEDS.format(1.5)}, SPEED, "multiply sound_speed_m_s by 1000"),
        ({"sound-speed": SPEEDS.format(1200.0)}, SPEED, "none of the usual"),
        ({"zpr": ZPR.replace(",5.", ",-5.")}, "zpr.csv:", "z is down"),
        ({"zpr": ZPR.replace("0.0479", "0.9").replace("0.03,", "1.1,")}, "zpr.csv:", "roll_rad"),
        ({"zpr": ZPR.replace("5.0332", "3e8")}, DEEP, "none of the usual mistakes"),
        ({"zpr": ZPR.replace("5.0332", "-1e9")}, DEEP, "none of the usual mistakes"),
        ({"zpr": ZPR.replace("5.0332", "1e5")}, DEEP, "mm"),
        ({"poses": POSES.format("0.00")}, "odometry.csv:", "the median speed is"),
    ]
)
def test_speeds_of_sound_and_integrated_tracks(case: tuple[dict[str, str], str, str]) -> None:
    files, place, cause = case
    first, *others = [entry.says for entry in findings(TINY | files)]
    assert first.startswith(place)
    assert cause in first
    assert not ("sound-speed" in files and others)


@for_all(files=[{"sound-speed": SPEEDS.format(1500.0)}, {"poses": POSES.format("")}])
def test_right_ones_are_plausible(files: dict[str, str]) -> None:
    assert findings(TINY | files) == []


@for_all(name=WHOLE)
def test_every_reading_is_tried_on_whatever_columns_there_are(name: str, tmp_path: Path) -> None:
    """Rows of usbl.csv with `i` have the times of poses.csv; without that file no bearing is read from the bow."""
    tables = read_tables(folder(tmp_path / name, WHOLE[name]))[0]
    tried = {a.reading: a.on_tables(tables) for a in readings(tables)}
    assert any(tried.values())
    if name == "placed":
        assert tried[FROM_NORTH]["usbl"].floats("bearing_rad") == pytest.approx(np.array([[0.5 - 0.1 * 3 / 60]]))
        (alone,) = (a for a in readings(tables) if a.reading == FROM_NORTH)
        assert alone.on_tables({k: table for k, table in tables.items() if k != "poses"}) == {}


def test_a_simulated_sonar_mission_is_plausible(tmp_path: Path) -> None:
    for seed in range(3):
        mission, path = sim.hauv_floor(np.random.default_rng(seed), legs=2, per_leg=6), tmp_path / str(seed)
        write_mission(path, mission.graph, mission.sonar, mission.offset, mission.truth)
        assert read_mission(path)[2].findings == []


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_solve_and_explain_name_the_doubt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = SPOILS["velocity in mm/s"][0](clean(1, minutes=4.0))
    path = str(folder(tmp_path / "m", files_of(log)))
    assert main(["solve", path, "--json", str(tmp_path / "r.json")]) == 1
    table = capsys.readouterr().out
    (result,) = [line for line in table.splitlines() if line.startswith("result ")]
    assert "; but implausible: speed (dvl.csv)" in result
    (finding,) = json.loads((tmp_path / "r.json").read_text())["findings"]
    assert (finding["file"], finding["line"], finding["readings"][0]["factor"]) == ("dvl.csv", 2, 1000.0)
    assert main(["explain", path, "--json", str(tmp_path / "e.json")]) == 0
    assert "1. dvl.csv:2: vx_m_s is implausible" in capsys.readouterr().out
    assert json.loads((tmp_path / "e.json").read_text())["findings"][0]["kind"] == "implausible"


def rov(course: float = 0.0) -> dict[str, str]:
    """The files of 400 s of lanes with turns to either side; the course leaves the heading by a part of it."""
    rng, t, smooth = np.random.default_rng(0), np.arange(0.0, 400.0, 0.5), np.ones(21) / 21
    yaw = np.array([0, 1, 2, 1])[(t // 45).astype(int) % 4] * np.pi / 2
    yaw = np.convolve(np.pad(yaw, 10, "edge"), smooth, "valid")
    ways = 0.25 * np.column_stack([np.cos((1 + course) * yaw), np.sin((1 + course) * yaw)])
    p = np.cumsum(ways, axis=0)[::4] + rng.normal(0, 0.5, (200, 2))
    z = 8 + 2 * np.sin(t / 14) + rng.normal(0, 0.05, 800)
    rpy = np.column_stack([rng.normal(0, 0.01, (800, 2)), wrap(yaw + rng.normal(0, 0.01, 800))])
    return {
        "motion": csv("sigma_walk_m_sqrt_s", [0.7]),
        "ahrs": csv("time_s,roll_rad,pitch_rad,yaw_rad", t, rpy),
        "depth": csv("time_s,z_m", t, z),
        "fixes": csv("time_s,x_m,y_m,sigma_x_m,sigma_y_m", t[::4], p, np.full((200, 2), 0.5)),
        "noise": csv("sigma_roll_rad,sigma_pitch_rad,sigma_yaw_rad,sigma_z_m", [[0.01, 0.01, 0.01, 0.05]]),
    }


@pytest.mark.parametrize("course", [0.0, 0.5, -1.0, -1.6])
def test_a_right_log_is_plausible_whatever_its_way(course: float) -> None:
    """Ahead, more and more sideways, always along one line, sideways against its turns."""
    assert findings(rov(course)) == []


@pytest.mark.parametrize(
    ("table", "column", "change", "causes"),
    [
        ("ahrs", "yaw_rad", lambda yaw: -yaw, ["multiply yaw_rad by -1", "multiply y_m by -1"]),
        (
            "ahrs",
            "yaw_rad",
            lambda yaw: wrap(np.pi / 2 - yaw),
            ["yaw_rad of ahrs.csv looks measured from", "x_m, y_m of"],
        ),
        ("ahrs", "yaw_rad", lambda yaw: 0 * yaw - 1.7, ["it is -1.7 rad in all rows", "ahrs.csv looks stuck"]),
        ("fixes", "y_m", lambda y: -y, ["multiply yaw_rad by -1", "multiply y_m by -1"]),
        ("fixes", "x_m", lambda x: -x, ["multiply x_m by -1"]),
        ("fixes", "whole", lambda y: y[:, [0, 2, 1, 3, 4]], ["measured from east", "exchange the names of x_m, y_m"]),
        ("depth", "z_m", lambda z: 0 * z + 7, ["it is 7 m in all rows", "depth.csv looks stuck"]),
        ("depth", "z_m", lambda z: 1000 * z, ["divide z_m by 1000"]),
        ("depth", "z_m", lambda z: 100 * z, ["divide z_m by 100,"]),
        (
            *("depth", "z_m", lambda z: np.where(np.arange(len(z)) % 20 == 7, z + 15, z)),
            ["5 % of the rows", "leave out lines 9, 29, 49, 69, 89, 109, 129, "],
        ),
        ("depth", "z_m", lambda z: z + 9 * np.diff(z, append=z[-1]), ["multiply sigma_z_m by"]),
    ],
)
def test_what_the_data_tell_is_named(table: str, column: str, change: Change, causes: list[str]) -> None:
    (finding,) = findings(changed(rov(), table, **{column: change}))
    positions = [finding.says.find(cause) for cause in causes]
    assert positions == sorted(positions)
    assert positions[0] >= 0
