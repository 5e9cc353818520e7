"""Positions and closures: exact ones give the truth, wherever the rows say their time or pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import XYH, Between, Cauchy, Heading, Position
from models import SE3, euler
from models.geodesy import LocalPlane
from nls.missions.folder.columns import COLUMNS
from tests.nls.io.g2o_files import assert_refused
from tests.nls.missions.folder.mission_files import TINY, Positioned, csv, folder

(x,) = nls.kinds("x")
T = np.array([10.4, 30.2, 55.55, 71.0])
FIX = "time_s,x_m,y_m,sigma_x_m,sigma_y_m"
SIGMAS = np.full((len(T), 2), 0.5)


def solved(path: Path, truth: Positioned, tolerance: float = 1e-6, **files: str | None) -> tuple:
    """The solution of a log with more files, which is the truth."""
    graph, values, report = nls.load(folder(path, truth.files, **files))
    result = graph.optimize(values)
    assert result.converged
    assert len(report.sources) == len(graph.factors)
    assert [len(s.lines) for s in report.sources] == [len(f) for f in graph.factors]
    assert SE3.position(result.values[x]) == pytest.approx(SE3.position(truth.X), abs=tolerance)
    assert result.chi2_final < 1e-6
    return graph, result, report


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Positioned:
    return Positioned(tmp_path_factory.mktemp("truth"), T)


def test_fixes_at_their_times_need_no_anchor_and_no_heading(truth: Positioned, tmp_path: Path) -> None:
    fixes = csv(FIX, T, truth.places(T)[:, :2], SIGMAS)
    graph, _, report = solved(tmp_path / "m", truth, fixes=fixes)
    assert sum(isinstance(factor, Position) for factor in graph.factors) == 1
    assert report.place(3, 1).endswith("fixes.csv:3")
    assert report.vertex_times["x"].tolist() == truth.t.tolist()
    solved(tmp_path / "m", truth, fixes=fixes, poses=truth.poses)


def test_arms_depths_delays_clocks_and_kernels(truth: Positioned, tmp_path: Path) -> None:
    arm = np.array([1.0, -0.5, -0.3])
    words = ["cauchy:2", "none", "none", "cauchy:2"]
    names = "time_s,delay_s,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m,arm_x_m,arm_y_m,arm_z_m,kernel"
    delay = np.array([0.2, 0.3, 0.2, 0.0])
    columns = (T + delay + 1.5, delay, truth.places(T, arm), np.full((4, 3), 0.5), np.tile(arm, (4, 1)), words)
    calibration = "name,value,sigma\nfixes_clock_s,1.5,0\n"
    graph, _, report = solved(tmp_path / "m", truth, fixes=csv(names, *columns), calibration=calibration)
    fixes = [factor for factor in graph.factors if isinstance(factor, Position)]
    assert [(len(fix), fix.kernel) for fix in fixes] == [(2, Cauchy(2.0)), (2, None)]
    assert [report.place(3, 1), report.place(4, 0)] == [str(tmp_path / f"m/fixes.csv:{line}") for line in (5, 3)]


def test_latitudes(truth: Positioned, tmp_path: Path) -> None:
    lat, lon = LocalPlane(54.1, 10.2).geodetic(truth.places(T)[:, :2])
    fixes = csv(FIX.replace("x_m,y_m", "lat_deg,lon_deg", 1), T, lat, lon, SIGMAS)
    solved(tmp_path / "m", truth, fixes=fixes, origin="lat_deg,lon_deg\n54.1,10.2\n")
    (tmp_path / "m" / "origin.csv").unlink()
    assert_refused(1, "write origin.csv with one row of lat_deg,lon_deg, such as 54.10", nls.load, tmp_path / "m")


def test_rows_outside_the_log_are_left_out_and_counted(truth: Positioned, tmp_path: Path) -> None:
    t, p = np.append([-3.0, 99.0], T), np.vstack([np.zeros((2, 2)), truth.places(T)[:, :2]])
    _, _, report = solved(tmp_path / "m", truth, fixes=csv(FIX, t, p, np.full((6, 2), 0.5)))
    assert "fixes.csv:2: the first row of 2 that are left out, of 6: not within the track, 0.0" in str(report)
    place = folder(tmp_path / "m", fixes=csv(FIX, t + 1e6, p, np.full((6, 2), 0.5)), files=truth.files)
    assert_refused(2, "no row is within the track, 0.0 to 80.0 s; do the clocks agree?", nls.load, place)
    place = folder(tmp_path / "m", truth.files, fixes=csv(FIX, T + 0.01, p[2:], SIGMAS), poses=truth.poses)
    assert_refused(2, "no pose is at 10.41 s; the nearest is pose 11 at 10.4 s. Add a pose", nls.load, place)


def test_numbers_of_poses_do_not_shift(truth: Positioned, tmp_path: Path) -> None:
    fixes = csv(FIX, T, truth.places(T)[:, :2], SIGMAS)
    place = folder(tmp_path / "m", truth.files, fixes=fixes, anchor=TINY["anchor"])
    words = "names poses by i, but the times of fixes.csv add poses; write poses.csv"
    assert_refused(1, words, nls.load, place)


def test_fixes_give_the_yaw_of_odometry(tmp_path: Path) -> None:
    turn = euler.to_se3([0.0, 0.0, 2.5, 300.0, 40.0, 0.0])
    _, dead, _ = nls.load(folder(tmp_path / "m", contacts=None, sonar=None, anchor=None, truth=None, landmarks=None))
    X = SE3.compose(turn, dead[x])
    fixes = csv(FIX.replace("time_s", "i"), np.arange(4), X[:, :2], SIGMAS)
    graph, start, report = nls.load(folder(tmp_path / "m", {}, fixes=fixes))
    assert not any(isinstance(factor, Heading) for factor in graph.factors)
    assert start[x] == pytest.approx(X, abs=1e-9)
    assert not any("anchor" in note for note in report.notes)
    assert graph.chi2(start) < 1e-9
    timed = folder(tmp_path / "timed", contacts=None, sonar=None, fixes=fixes.replace("i,", "time_s,", 1))
    assert_refused(1, "has times, but no pose has one; add poses.csv", nls.load, timed)


def test_closures(tmp_path: Path) -> None:
    t = np.array([[5.5, 70.2], [12.0, 33.3]])
    truth = Positioned(tmp_path / "truth", t.ravel())
    T_ij = SE3.compose(SE3.inverse(truth.at(t[:, 0])), truth.at(t[:, 1]))
    state = euler.from_se3(T_ij)
    names = ",".join(COLUMNS["closures"][2:-1])
    closures = csv(names, t, state[:, 3:], state[:, :3], np.full((2, 6), 0.1))
    fixes = csv(FIX, [71.0], truth.places([71.0])[:, :2], SIGMAS[:1])
    graph, _, report = solved(tmp_path / "m", truth, closures=closures, fixes=fixes)
    assert sum(isinstance(factor, Between) for factor in graph.factors) == 1
    assert report.place(4, 1).endswith("closures.csv:3")
    names = "time_i_s,time_j_s,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad"
    level = csv(names, t, state[:, [3, 4, 2]], np.full((2, 3), 0.1))
    graph, _, _ = solved(tmp_path / "m", truth, closures=level, fixes=fixes)
    assert sum(isinstance(factor, XYH) for factor in graph.factors) == 2
