"""Tables of raw logs: which rows of dvl.csv count, the length of a track, pressure in place of depth, path.csv."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import XYH, ZPR
from models import SE3, euler
from models.pressure import depth_unesco
from nls.io.report import LoadReport
from nls.missions.folder.columns import COLUMNS
from tests.nls.io.g2o_files import assert_refused
from tests.nls.missions.folder.mission_files import RAW, csv, folder, raw, tables

(x,) = nls.kinds("x")
T = np.arange(0.0, 40.01, 0.2)


def log(
    columns: dict[str, object], noise: str = "", value: str = "", yaw: float = 0.0, t: np.ndarray = T
) -> dict[str, str]:
    """1 m/s ahead at times t; columns of dvl.csv besides."""
    zero = np.zeros(len(t))
    table = {"time_s": t, "vx_m_s": 1 + zero, "vy_m_s": zero, "vz_m_s": zero, **columns}
    dvl = [np.broadcast_to(np.asarray(column), len(t)) for column in table.values()]
    names = ",".join(RAW["noise"])
    return {
        "dvl": csv(",".join(table), *dvl),
        **tables(ahrs=(t, zero, zero, yaw + zero), depth=(t, 5 + zero)),
        "noise": f"{names}{noise}\n0.01,0,0.05,0.002,0.002,0.01,0.05{value}\n",
    }


def way(path: Path, files: dict[str, str]) -> tuple[float, float, LoadReport]:
    """How far the dead reckoning ends from its begin, the largest sigma of a leg, the report."""
    graph, values, report = nls.load(folder(path, files))
    steps = next(factor for factor in graph.factors if isinstance(factor, XYH))
    W = steps.noise.sqrt_information(len(steps), ("x", "y", "yaw"))
    p = SE3.position(values.stack("x").X)
    return float(np.linalg.norm(p[-1] - p[0])), float(1 / W[:, 0, 0].min()), report


def test_beams_and_altitude_say_where_the_bottom_is(tmp_path: Path) -> None:
    lost = (T > 10) & (T < 12)
    v = np.where(lost, 77.0, 1.0)
    reference = way(tmp_path / "valid", log({"vx_m_s": v, "valid": 1 * ~lost}))
    for name, columns, reason in (
        ("beams", {"beams": np.where(lost, 2, 4)}, "fewer than 3 beams on the bottom"),
        ("altitude", {"valid": 1, "altitude_m": np.where(lost, 0.0, 9.0)}, "an altitude that is not above 0"),
    ):
        distance, sigma, report = way(tmp_path / name, log({"vx_m_s": v, **columns}))
        assert (distance, sigma) == pytest.approx(reference[:2])
        assert f"dvl.csv:53: 9 rows, this one the first, have {reason}: without bottom lock" in report.notes


def test_a_gate_leaves_out_what_no_vehicle_does(tmp_path: Path) -> None:
    v = np.where(np.isin(np.arange(len(T)), [50, 51, 120]), 3.0, 1.0)
    distance, _, report = way(tmp_path / "gate", log({"vx_m_s": v, "valid": 1}, ",gate_v_m_s", ",0.5"))
    assert distance == pytest.approx(40.0)
    words = "dvl.csv:52: 3 rows, this one the first, have a velocity further than gate_v_m_s, 0.5 m/s"
    assert words in str(report.notes)
    distance, _, report = way(tmp_path / "none", log({"vx_m_s": v, "valid": 1}))
    assert distance == pytest.approx(40.0 + 3 * 2 * 0.2)
    assert "gate" not in str(report.notes)


def test_each_row_has_its_sigma(tmp_path: Path) -> None:
    one = way(tmp_path / "noise", log({"valid": 1}))[1]
    assert way(tmp_path / "rows", log({"valid": 1, "sigma_v_m_s": 0.03}))[1] == pytest.approx(3 * one, rel=1e-6)
    zero = folder(tmp_path / "zero", log({"valid": 1, "sigma_v_m_s": 0.0}))
    assert_refused(2, "sigma_v_m_s is 0.0; expected a number above 0", nls.load, zero)


def test_the_way_through_the_water_and_the_current_go_on(tmp_path: Path) -> None:
    """Looking east over ground at 1 m/s, with a current of 0.3 m/s to the east: 0.7 m/s ahead through the water."""
    rng = np.random.default_rng(0)
    lost = (T > 15) & (T < 25)
    speed = np.where(lost, 1.0 + 0.5 * np.sin(np.pi * (T - 15) / 10), 1.0)  # which no bridge knows
    water = {"water_vx_m_s": speed - 0.3 + rng.normal(0, 0.02, len(T)), "water_vy_m_s": 0.0, "water_vz_m_s": 0.0}
    files = log({"vx_m_s": np.where(lost, 0.0, speed), "valid": 1 * ~lost, **water}, yaw=np.pi / 2)
    distance, sigma, report = way(tmp_path / "water", files)
    assert distance == pytest.approx(40 + 10 / np.pi, abs=0.15)
    assert "the velocity through the water and the current, north " in str(report.notes)
    assert "east 0.3" in str(report.notes)
    assert sigma < 0.2
    legs, spread = 10, 0.02  # the whole of the loss: its 49 rows have the error of the current in common
    assert sigma * np.sqrt(legs) == pytest.approx(spread * 10, rel=0.25)
    odd = folder(tmp_path / "odd", log({"valid": 1 * ~lost, **water, "water_valid": 2}))
    assert_refused(2, "water_valid is '2'; expected 0 or 1", nls.load, odd)
    blind = {**water, "water_valid": 1 * lost}
    alone = log({"vx_m_s": np.where(lost, 0, speed), "valid": 1 * ~lost, **blind})
    distance, _, report = way(tmp_path / "alone", alone)
    assert distance == pytest.approx(40.0)
    assert "is not used: fewer than two rows have both" in str(report.notes)


def test_the_last_pose_is_in_the_log_despite_rounding(tmp_path: Path) -> None:
    assert 12.46 + 68.0 > 80.46  # what floor() of the difference, 68.0, would make a pose of
    for first, last, poses in ((12.46, 80.46, 68), (0.1, 80.1, 81), (0.0, 3.0, 4)):
        t = np.append(np.arange(first, last - 0.1, 0.5), last)
        _, values, report = nls.load(folder(tmp_path / "m", log({"valid": 1}, t=t)))
        times = report.vertex_times["x"]
        assert (len(values), len(times)) == (poses, poses)
        assert times[0] == first
        assert last - 1 < times[-1] <= last


def test_rows_without_bottom_lock_at_the_ends_are_left_out(tmp_path: Path) -> None:
    t = np.arange(0.0, 30.1, 0.5)
    files = log({"valid": 1 * ((t >= 2.5) & (t <= 28.0) & (t != 10.0))}, t=t)
    _, values, report = nls.load(folder(tmp_path / "m", files))
    assert report.vertex_times["x"].tolist() == np.arange(2.5, 28.1).tolist()
    assert np.ptp(SE3.position(values[x])[:, 0]) == pytest.approx(25.0)
    assert "the DVL has no bottom lock in its first 2.5 s and its last 2 s: left out" in report.notes
    for poses, line in (("0,2.0\n1,9.0\n", 2), ("0,2.5\n1,28.5\n", 3)):
        place = folder(tmp_path / "poses", files, poses=f"i,time_s\n{poses}")
        assert_refused(line, "dvl.csv with bottom lock 2.5 to 28.0 s", nls.load, place)
    _, values, _ = nls.load(folder(tmp_path / "poses", files, poses="i,time_s\n0,2.5\n1,28.0\n"))
    assert np.ptp(SE3.position(values[x])[:, 0]) == pytest.approx(25.5)


def test_logs_too_short_and_too_long(tmp_path: Path) -> None:
    t = np.arange(0.0, 3.1, 0.5)
    for files, words in (
        (log({"valid": 0}, t=t), "0 of 7 rows are valid; expected two"),
        (log({"valid": 1 * (np.arange(7) < 1)}, t=t), "1 of 7 rows are valid; expected two"),
        (log({"valid": 1}, t=np.array([0.0, 1e12, 1.7e12])), "the logs last 1.7e+12 s"),
    ):
        assert_refused(None, f"dvl.csv: {words}", nls.load, folder(tmp_path / "m", files))


def test_poses_denser_than_the_rows_of_a_log_say_no_more_than_these(tmp_path: Path) -> None:
    files = log({"valid": 1}, t=np.arange(0.0, 30.1))
    t = np.arange(0.0, 30.1, 0.25)
    poses = "i,time_s\n" + "".join(f"{k},{s!r}\n" for k, s in enumerate(t.tolist()))
    _, zpr, heading = nls.load(folder(tmp_path / "m", files, poses=poses))[0].factors[:3]
    assert np.median(heading.noise.sigma) == pytest.approx(0.01 * 2, rel=0.05)
    assert np.median(zpr.noise.sigmas, axis=0) == pytest.approx([0.05 * 2, 0.002 * 2, 0.002 * 2], rel=0.05)


def test_steps_say_nothing_of_the_yaw_and_know_the_way_given_the_heading(tmp_path: Path) -> None:
    found = []
    for sigma_yaw in ("0.01", "0.3"):
        files = raw()
        files["noise"] = files["noise"].replace("0.002,0.01,0.05", f"0.002,{sigma_yaw},0.05")
        graph, _, _ = nls.load(folder(tmp_path / sigma_yaw, files))
        found.append(graph.factors[0].noise.sqrt_information(len(graph.factors[0]), ("x", "y", "yaw")))
        assert not found[-1][:, 2].any()
        assert not found[-1][:, :, 2].any()
    assert found[0] == pytest.approx(found[1], rel=1e-9)  # the noise of the heading is in Heading alone
    Sigma = np.linalg.inv(found[0][5, :2, :2].T @ found[0][5, :2, :2])
    dt, n = 0.25, 5  # samples of 1/8, 1/4, 1/4, 1/4, 1/8 s in a leg of 1 s at 1 m/s, 0.2 % of it by the scale
    white = 0.01**2 * dt**2 * (n - 1)  # the samples at its ends, half in either leg, count by half, not a quarter
    assert Sigma[0, 0] == pytest.approx(white + 0.002**2, rel=1e-3)
    assert Sigma[1, 1] == pytest.approx(white, rel=1e-2)


PRESSURE = 101325.0 + 1025.0 * 9.80665 * 30.0
ORIGIN = {"origin": "lat_deg,lon_deg\n60,5\n"}


def files(water: str = "", tide: str = "", pressure: float = PRESSURE) -> dict[str, str]:
    out = log({"valid": 1}) | {"pressure": csv("time_s,pressure_pa", T, np.full(len(T), pressure))}
    out |= {"water": water} if water else {}
    out |= {"tide": f"time_s,tide_m\n{tide}"} if tide else {}
    return out


def depths(path: Path, tables: dict[str, str]) -> tuple[np.ndarray, str]:
    graph, _, report = nls.load(folder(path, tables, depth=None))
    return next(f for f in graph.factors if isinstance(f, ZPR)).z[:, 0], "\n".join(report.notes)


def test_density_latitude_atmosphere_and_tide(tmp_path: Path) -> None:
    density = "density_kg_m3\n1025\n"
    z, notes = depths(tmp_path / "density", files(density))
    assert z == pytest.approx(30.0)
    assert "pressure.csv: 101325 Pa of it are taken for the atmosphere" in notes
    z, notes = depths(tmp_path / "air", files("density_kg_m3,atmosphere_pa\n1025,100000\n", pressure=PRESSURE - 1325))
    assert z == pytest.approx(30.0)
    assert "atmosphere" not in notes
    z, _ = depths(tmp_path / "tide", files(density, "-10,1.0\n50,4.0\n"))
    assert z == pytest.approx(30.0 - np.interp(np.arange(41.0), [-10, 50], [1.0, 4.0]))
    below = float(depth_unesco(PRESSURE - 101325.0, 60.0))
    assert depths(tmp_path / "latitude", files("latitude_deg\n60\n"))[0] == pytest.approx(below)
    z, notes = depths(tmp_path / "origin", files() | ORIGIN)
    assert z == pytest.approx(below)
    assert "by the formula of UNESCO at 60 degrees, of origin.csv" in notes


TIMES = np.arange(0.0, 41.0)
WAY = np.column_stack([10 * np.sin(TIMES / 10), TIMES, 0.1 * TIMES])  # x, y, yaw
SIGMAS = np.tile([0.1, 0.2, 0.03], (len(TIMES), 1))
PATH = csv("time_s,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad", TIMES, WAY, SIGMAS)


def test_the_poses_of_a_path_are_its_rows_and_its_steps_count(tmp_path: Path) -> None:
    graph, values, report = nls.load(folder(tmp_path / "m", {"path": PATH}))
    X = euler.from_se3(values[x])
    assert X[:, 3:5] - X[0, 3:5] == pytest.approx(_turned(WAY[:, :2] - WAY[0, :2], X[0, 2] - WAY[0, 2]))
    assert np.unwrap(X[:, 2] - X[0, 2]) == pytest.approx(WAY[:, 2])
    steps, tilts = graph.factors[:2]
    assert (type(steps), type(tilts)) == (XYH, ZPR)
    assert steps.noise.sigmas[0] == pytest.approx([0.1, 0.2, 0.03])
    assert any("no z_m, roll_rad, pitch_rad: taken as 0" in note for note in report.notes)
    assert report.unmeasured == ("z", "roll", "pitch")
    assert report.place(0, 0).endswith("path.csv:3")  # the row a step leads to


def _turned(p: np.ndarray, angle: float) -> np.ndarray:
    return p @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def test_a_fix_between_two_rows_gets_a_pose_and_parts_the_variance(tmp_path: Path) -> None:
    fixes = "time_s,x_m,y_m,sigma_x_m,sigma_y_m\n0.25,0,0,1,1\n30,5,5,1,1\n"
    graph, values, report = nls.load(folder(tmp_path / "m", {"path": PATH, "fixes": fixes}))
    assert len(values.stack("x")) == len(TIMES) + 1
    assert report.vertex_times["x"][1] == 0.25
    assert graph.factors[0].noise.sigmas[:2, 0] ** 2 == pytest.approx([0.25 * 0.01, 0.75 * 0.01])
    assert graph.optimize(values).converged


def test_every_column_of_a_path_is_read(tmp_path: Path) -> None:
    names = COLUMNS["path"]
    rows = np.array([[k, k, 0, 2 + k, 0.01, 0.02, 0.1 * k, *[0.1] * 6] for k in range(3)])
    graph, values, report = nls.load(folder(tmp_path / "m", {"path": csv(",".join(names), rows)}))
    assert euler.from_se3(values[x])[:, [0, 1, 5]] == pytest.approx(np.array([[0.01, 0.02, 2 + k] for k in range(3)]))
    assert graph.factors[1].z == pytest.approx(np.array([[2 + k, 0.02, 0.01] for k in range(3)]))
    assert graph.factors[1].noise.sigmas == pytest.approx(np.full((3, 3), 0.1))
    assert not any("taken as 0" in note for note in report.notes)
