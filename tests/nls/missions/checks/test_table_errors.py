"""Errors of whole tables: which are seen, with their size, and which no other measurement shows, up to what size."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

import nls
from models import SE3, euler
from models.algebra import Array
from models.sensors import spherical
from nls.missions import MissionReport, read_mission
from nls.missions.checks import table_errors
from nls.missions.checks.findings import Cause, TableError
from tests.nls.missions.checks.missions import changed
from tests.nls.missions.folder.mission_files import BEACONS, Positioned, csv, folder
from tests.nls.missions.folder.test_motion import ARM, T, fixes, logs, state

(X,) = nls.kinds("x")
T_FIX = np.concatenate([np.arange(12.0, 18.0), np.arange(62.0, 67.0)])
T_ALL = np.arange(2.0, 78.0, 2.0)
FIXES = "time_s,x_m,y_m,sigma_x_m,sigma_y_m,arm_x_m,arm_y_m,arm_z_m"


@pytest.fixture(scope="module")
def true(tmp_path_factory: pytest.TempPathFactory) -> Positioned:
    return Positioned(tmp_path_factory.mktemp("truth"), t=np.union1d(T_FIX, T_ALL))


def _fixed(
    true: Positioned, t: Array = T_FIX, late: float = 0.0, arm: tuple[float, float] = (0.5, 0.0)
) -> dict[str, str]:
    """The log and fixes of an antenna half a meter ahead."""
    p, n = true.places(t, (0.5, 0.0, 0.0))[:, :2], len(t)
    return true.files | {"fixes": csv(FIXES, t + late, p, np.full((n, 2), 0.1), np.tile([*arm, 0.0], (n, 1)))}


def _solved(path: Path) -> tuple[nls.FactorGraph, nls.Result, MissionReport]:
    graph, start, report = read_mission(path)
    return graph, graph.optimize(start), report


def _errors(path: Path, files: dict[str, str] | None = None) -> list[TableError]:
    graph, result, report = _solved(folder(path, files) if files else path)
    return table_errors.table_errors(graph, result.values, result.chi2_final, result.dof, report)


def _hidden(path: Path, files: dict[str, str]) -> dict[tuple[str, str], float]:
    return {(error.quantity, error.file): error.below for error in _errors(path, files) if error.hidden}


def test_nothing_checks_the_depth_the_heading_and_the_place_of_a_rov(tmp_path: Path) -> None:
    below = _hidden(tmp_path, logs(fixes=fixes(0 * ARM), motion="sigma_walk_m_sqrt_s\n1\n"))
    tables = {("depth", "depth.csv"), ("heading", "ahrs.csv"), ("place", "fixes.csv"), ("clock", "fixes.csv")}
    assert below == dict.fromkeys(tables, np.inf)


def test_places_with_a_depth_check_its_zero(tmp_path: Path) -> None:
    p = state(T)[:, 3:]
    names = "time_s,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m"
    below = _hidden(tmp_path, logs(fixes=csv(names, T, p, np.full((len(T), 3), 0.2))))
    assert not {what for what, file in below if file == "depth.csv"}


def test_a_dvl_and_fixes_at_both_ends_check_the_heading_and_the_clock(true: Positioned, tmp_path: Path) -> None:
    below = _hidden(tmp_path, _fixed(true))
    depth = {("zero of the depth", "depth.csv"): np.inf, ("clock", "depth.csv"): np.inf}
    assert 1.0 < below.pop(("clock", "dvl.csv")) < 8.0
    assert below == depth | {("place", "fixes.csv"): np.inf}


@pytest.mark.parametrize(
    ("table", "column", "cause", "constant", "size"),
    [
        ("fixes", "time_s", Cause.CALIBRATION, "fixes_clock_s", 1.0),
        ("ahrs", "time_s", Cause.CALIBRATION, "ahrs_clock_s", 1.0),
        ("ahrs", "yaw_rad", Cause.CALIBRATION, "declination_rad", -0.1),
        ("fixes", "arm_x_m", Cause.ARM, "arm_x_m", 3.0),
    ],
)
def test_an_error_of_a_table_is_seen_with_its_size(
    table: str, column: str, cause: Cause, constant: str, size: float, true: Positioned, tmp_path: Path
) -> None:
    files = _fixed(true, T_ALL)
    assert not [error for error in _errors(tmp_path / "right", files) if error.evident], "the clean control"
    added = -size if constant == "declination_rad" else size
    errors = _errors(tmp_path / "wrong", changed(files, table, **{column: lambda y: y + added}))
    evident = {(e.reading.cause, e.reading.column): e for e in errors if e.reading and e.evident}
    found = evident[cause, constant]
    assert found.fall > 0.9 * max(error.fall for error in errors), "a clock is like an arm where the vehicle goes ahead"
    assert found.reading is not None
    assert found.reading.factor == pytest.approx(size, abs=max(4 * found.sigma, 0.1 * abs(size)))


@pytest.mark.parametrize("quantity", ["heading", "clock", "arm"])
def test_chi2_grows_by_what_is_seen_from_the_size_on(quantity: str, true: Positioned, tmp_path: Path) -> None:
    file = "ahrs.csv" if quantity == "heading" else "fixes.csv"
    errors = _errors(tmp_path / "m", _fixed(true))
    (below,) = (error.below for error in errors if (error.quantity, error.file) == (quantity, file))

    def chi2(size: float) -> float:
        spoiled = {
            "heading": lambda: changed(_fixed(true), "ahrs", yaw_rad=lambda yaw: yaw + size),
            "clock": lambda: _fixed(true, late=size),
            "arm": lambda: _fixed(true, arm=(0.5 + size, 0.0)),
        }[quantity]()
        return _solved(folder(tmp_path / f"{size:.3f}", spoiled))[1].chi2_final

    root = table_errors.EVIDENT**0.5
    growth = [chi2(part * root / (root + table_errors.SURE) * below) for part in (0.8, 1.2)]
    assert table_errors.EVIDENT < growth[1]
    assert growth[0] < table_errors.EVIDENT or quantity == "arm"  # whose worst direction is not ahead


USBL = "time_s,range_m,bearing_rad,elevation_rad,sigma_range_m,sigma_bearing_rad,sigma_elevation_rad"


def _survey(true: Positioned, t: Array, kernels: bool) -> dict[str, str]:
    """A ship that moves, its directions at times (n,), with two kernels in turn, and ranges to a beacon 1003."""
    s, rng = np.arange(0.0, 80.5), np.random.default_rng(1)
    X = np.column_stack([0.02 * np.sin(s), 0.02 * np.cos(s), 0.1 * np.sin(s / 20), 100 + 0.5 * s, 0.2 * s - 40, 0 * s])
    at = euler.to_se3(np.column_stack([np.interp(t, s, column) for column in X.T]))
    sigmas = np.tile([0.3, 0.01, 0.01], (len(t), 1))
    seen = spherical(SE3.act(SE3.inverse(at), true.places(t)))[0] + rng.normal(0, sigmas)
    words = [["huber:1.345", "none", "none", "none"][k % 4] for k in range(len(t))]
    usbl = csv(f"{USBL},kernel", t, seen, sigmas, words) if kernels else csv(USBL, t, seen, sigmas)
    r = true.ranges(t, np.full(len(t), 3)) + rng.normal(0, 0.1, len(t))
    return {
        "ship": csv("time_s,roll_rad,pitch_rad,yaw_rad,x_m,y_m,z_m", s, X),
        "usbl": usbl,
        "ranges": csv("time_s,beacon,range_m,sigma_range_m", t, np.full(len(t), 1003), r, np.full(len(t), 0.1)),
        "beacons": csv("beacon,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m", [1003], [BEACONS[3]], np.full((1, 3), 0.1)),
    }


@pytest.mark.parametrize("kernels", [False, True])
@pytest.mark.parametrize("each", [1, 3])
@pytest.mark.filterwarnings("error:divide", "error:invalid")
def test_a_ship_and_a_beacon_have_poses_and_times_of_their_own(
    kernels: bool, each: int, true: Positioned, tmp_path: Path
) -> None:
    """More directions than poses, several at one time, in two batches: the clock of the ship is known as well."""
    errors = _errors(tmp_path, true.files | _survey(true, np.repeat(T_ALL, each), kernels))
    below = {(error.quantity, error.file): error.below for error in errors}
    assert 0.05 < below["clock", "usbl.csv"] < 1.0
    assert 0.2 < below["clock", "ship.csv"] < 3.0
    assert not [error for error in errors if error.evident]


def test_tables_in_gzip_have_the_errors_of_plain_ones(true: Positioned, tmp_path: Path) -> None:
    plain, packed = folder(tmp_path / "m", _fixed(true)), tmp_path / "packed"
    packed.mkdir()
    for file in plain.glob("*.csv"):
        (packed / f"{file.name}.gz").write_bytes(gzip.compress(file.read_bytes()))
    assert _errors(packed) == _errors(plain)


def test_held_poses_have_no_errors(true: Positioned, tmp_path: Path) -> None:
    graph, start, report = read_mission(folder(tmp_path, _fixed(true)))
    held = nls.FactorGraph(graph.factors, [X[start.stack("x").numbers]])
    assert table_errors.table_errors(held, start, 1.0, 1, report) == []


@pytest.mark.parametrize("direction", np.arange(0.0, np.pi, np.pi / 4))
def test_an_arm_of_the_hidden_size_is_evident_in_every_direction(
    direction: float, true: Positioned, tmp_path: Path
) -> None:
    right = _errors(tmp_path / "m", _fixed(true))
    (below,) = (error.below for error in right if (error.quantity, error.file) == ("arm", "fixes.csv"))
    arm = (0.5 + below * np.cos(direction), below * np.sin(direction))
    wrong = _errors(tmp_path / "wrong", _fixed(true, arm=arm))
    assert max(error.fall for error in wrong if error.quantity == "arm") > 1.5 * table_errors.EVIDENT
