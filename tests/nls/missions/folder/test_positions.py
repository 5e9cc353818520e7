"""Positions, closures, ranges and directions by sound: exact ones give the truth, whatever of beacons is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import XYH, BearingRange, Between, Cauchy, Heading, Position, Prior, Range, ScaledRange, Shifted
from models import SE3, euler
from models.geodesy import LocalPlane
from models.sensors import direction
from nls.missions.folder.columns import ANGLES, COLUMNS, PLACE, USBL, suffixed
from tests.nls.io.g2o_files import assert_refused
from tests.nls.missions.folder.mission_files import BEACONS, TINY, Positioned, csv, folder

x, b, s = nls.kinds("x", "b", "s")
T = np.arange(2.3, 79.0, 2.5)
HEARD = np.array([3, 5, 9])[np.arange(len(T)) % 3]
RANGE = "time_s,beacon,range_m,sigma_range_m"
DIRECTION = ",".join((*USBL, *suffixed(USBL)))
SHIP = ",".join(("time_s", *ANGLES, *PLACE))
SIGMA = np.full((len(T), 1), 0.2)
IDS = np.array(list(BEACONS))
PLACES = np.array(list(BEACONS.values()))
KNOWN = csv("beacon,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m", IDS, PLACES, np.full((3, 3), 0.1))
DEPTHS = csv("beacon,z_m,sigma_z_m", IDS, PLACES[:, 2], np.full((3, 1), 0.1))
FIX = csv("time_s,x_m,y_m,sigma_x_m,sigma_y_m", [0.0], [[100.0, -50.0, 0.5, 0.5]])


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Positioned:
    return Positioned(tmp_path_factory.mktemp("truth"), T)


def test_ranges_to_beacons_in_their_places_are_a_position(truth: Positioned, tmp_path: Path) -> None:
    ranges = csv(RANGE, T, HEARD, truth.ranges(T, HEARD), SIGMA)
    graph, result, report = solved(tmp_path, truth, ranges=ranges, beacons=KNOWN)
    assert [type(factor) for factor in graph.factors[3:]] == [Prior, Range]
    assert report.place(4, 2).endswith("ranges.csv:4")
    assert result.values[b] == pytest.approx(PLACES, abs=1e-6)


def test_beacons_of_unknown_place_are_found_from_ranges(truth: Positioned, tmp_path: Path) -> None:
    arm = np.array([0.5, 0.2, -0.4])
    names = RANGE + ",arm_x_m,arm_y_m,arm_z_m"
    ranges = csv(names, T, HEARD, truth.ranges(T, HEARD, arm), SIGMA, np.tile(arm, (len(T), 1)))
    for beacons in (None, "\n".join(KNOWN.splitlines()[:3]), DEPTHS):  # the second without 9
        _, result, report = solved(tmp_path, truth, ranges=ranges, fixes=FIX, beacons=beacons)
        assert result.values[b] == pytest.approx(PLACES, abs=1e-5)
        assert any("beacons 3, 5, 9 are not in beacons.csv" in note for note in report.notes) == (beacons is None)
    assert not any("no anchor.csv" in note for note in report.notes)
    (tmp_path / "fixes.csv").unlink()
    _, _, report = nls.load(folder(tmp_path, {}, poses=truth.poses))
    assert "there is no anchor.csv: x and y of x0 are fixed at 0" in report.notes  # depths alone are no place


def test_ranges_turn_odometry_into_the_world(tmp_path: Path) -> None:
    """Without a compass the yaw is that which brings the beacons of dead reckoning to their places."""
    i = np.arange(40)
    step = np.column_stack([np.full(39, 2.0), np.full(39, 0.1), 0.15 * np.cos(i[1:] / 6)])
    odometry = csv(",".join(COLUMNS["odometry"]), i[:-1], i[1:], step, np.full((39, 3), 0.01))
    zpr = csv(",".join(COLUMNS["zpr"][:7]), i, 3 + np.sin(i / 5), np.zeros((40, 2)), np.full((40, 3), 0.01))
    _, dead, _ = nls.load(folder(tmp_path / "m", {"odometry": odometry, "zpr": zpr}))
    X = SE3.compose(euler.to_se3([0.0, 0.0, -2.0, 60.0, 10.0, 0.0]), dead[x])
    r = np.linalg.norm(X[:, None, :3] - PLACES, axis=2)
    ranges = csv("i,beacon,range_m,sigma_range_m", np.repeat(i, 3), np.tile(IDS, 40), r.ravel(), np.full(120, 0.1))
    graph, start, _ = nls.load(folder(tmp_path / "m", {}, ranges=ranges, beacons=KNOWN))
    assert start[x] == pytest.approx(X, abs=1e-3)
    result = graph.optimize(start)
    assert result.chi2_final < 1e-9
    assert result.values[x] == pytest.approx(X, abs=1e-6)


def test_travel_times(truth: Positioned, tmp_path: Path) -> None:
    """There and back, one way, a turn-around, at 1500 m/s and by a profile that is a hand-made mean of 1 / c."""
    ways, wait = 1 + np.arange(len(T)) % 2, 0.05 * (np.arange(len(T)) % 3)
    names = "time_s,beacon,travel_time_s,sigma_travel_time_s,turn_around_s,ways"
    r = truth.ranges(T, HEARD)

    def file(c: np.ndarray | float) -> str:
        return csv(names, T, HEARD, wait + ways * r / c, np.full((len(T), 1), 1e-4), wait, ways)

    graph, _, report = solved(tmp_path / "m", truth, ranges=file(1500.0), beacons=KNOWN)
    assert "there is no sound-speed.csv: travel times at 1500 m/s" in report.notes
    assert graph.factors[4].noise.sigmas[:2, 0] == pytest.approx([0.15, 0.075])
    z, c = np.array([0.0, 5.0, 12.0]), np.array([1500.0, 1490.0, 1460.0])
    fine = np.linspace(0, 1, 20001)[:, None]
    depths = truth.places(T)[:, 2] * (1 - fine) + np.array([BEACONS[k][2] for k in HEARD]) * fine
    profile = csv("z_m,sound_speed_m_s", z, c)
    mean = 1 / np.trapezoid(1 / np.interp(depths, z, c), fine, axis=0)
    assert np.ptp(mean) > 1
    solved(tmp_path / "m", truth, 1e-5, ranges=file(mean), beacons=KNOWN, **{"sound-speed": profile})


def test_a_speed_of_sound_that_is_wrong_is_a_variable_or_a_number(truth: Positioned, tmp_path: Path) -> None:
    ranges = csv(RANGE, T, HEARD, 1.02 * truth.ranges(T, HEARD), SIGMA)
    variable, held = ("name,value,sigma\nsound_speed_scale," + text for text in ("0,0.05\n", "0.02,0\n"))
    graph, start, _ = nls.load(folder(tmp_path / "m", truth.files, ranges=ranges, beacons=KNOWN, calibration=variable))
    scale = graph.optimize(start).values[nls.Keys("sound_speed_scale", 0)]
    assert scale == pytest.approx(0.02, abs=2e-4)  # its prior is at 0
    assert sum(isinstance(factor, ScaledRange) for factor in graph.factors) == 1
    solved(tmp_path / "held", truth, ranges=ranges, beacons=KNOWN, calibration=held)


def usbl(frames: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Range, bearing to starboard and elevation downwards of targets in frames."""
    p = SE3.act(SE3.inverse(frames), targets)
    return np.column_stack([np.linalg.norm(p, axis=1), direction(p)[0]])


def along(t: np.ndarray, track: np.ndarray) -> np.ndarray:
    """Poses of a ship at the times of the measurements."""
    return euler.to_se3(np.column_stack([np.interp(T, t, column) for column in track.T]))


def test_usbl_of_the_vehicle_and_of_a_ship(truth: Positioned, tmp_path: Path) -> None:
    sigmas, arm = np.tile([0.2, 0.01, 0.01], (len(T), 1)), np.array([0.5, 0.2, -0.4])
    antenna = SE3.compose(truth.at(T), np.append(arm, [0, 0, 0, 1.0])[None])
    z = usbl(antenna, np.array([BEACONS[k] for k in HEARD]))
    assert (z[:, 2] > 0).all()  # the beacons are below
    rows = (T, HEARD, z, sigmas, np.tile(arm, (len(T), 1)))
    file = csv(f"time_s,beacon,{DIRECTION},arm_x_m,arm_y_m,arm_z_m", *rows)
    solved(tmp_path / "beacons", truth, usbl=file, beacons=KNOWN)
    _, result, _ = solved(tmp_path / "unknown", truth, usbl=file, fixes=FIX)
    assert result.values[b] == pytest.approx(PLACES, abs=1e-5)

    t_s = np.array([0.0, 30.0, 75.0])
    track = np.array([[0.1, 0, 3.0, 90, -40, 1.0], [0, 0.1, 3.5, 120, -60, 1.2], [0, 0, 2.9, 150, -50, 0.8]])
    ship = csv(SHIP, t_s, track)
    frames = along(t_s, track)
    file = csv(f"time_s,{DIRECTION}", T, usbl(frames, truth.places(T)), sigmas)
    graph, _, report = solved(tmp_path / "ship", truth, usbl=file, ship=ship)
    left_out = "usbl.csv:32: the first row of 1 that are left out, of 31: not within the times of ship.csv"
    assert left_out in " ".join(report.notes)
    assert isinstance(graph.factors[3], BearingRange)
    assert [len(keys) for keys in graph.fixed] == [30]
    (tmp_path / "ship" / "ship.csv").unlink()
    assert_refused(1, "write ship.csv", nls.load, tmp_path / "ship")


def test_a_beacon_that_nothing_places_is_named(truth: Positioned, tmp_path: Path) -> None:
    ranges = csv(RANGE, T[:1], HEARD[:1], truth.ranges(T[:1], HEARD[:1]), SIGMA[:1])
    graph, start, _ = nls.load(folder(tmp_path / "m", truth.files, ranges=ranges))
    with pytest.raises(nls.UnderconstrainedError, match="b3"):
        graph.optimize(start)


def test_files_without_effect_are_noted(tmp_path: Path) -> None:
    unused = {"beacons": KNOWN, "sound-speed": "z_m,sound_speed_m_s\n0,1500\n"}
    _, _, report = nls.load(folder(tmp_path / "m", **unused))
    assert "sound-speed.csv is not used: nothing in this mission needs it" in report.notes
    assert any("beacons.csv" in note for note in report.notes)


@pytest.mark.parametrize("file", ["fixes", "ranges", "usbl"])
def test_a_late_clock_is_a_variable(file: str, truth: Positioned, tmp_path: Path) -> None:
    """Times that are late by 0.3 s, of which 0.2 s are known; the track turns little in the 0.1 s that are left."""
    late = T + 0.3
    ship_at = np.array([[0.0, 0.1, 0.2, 90.0, -40.0, 1.0], [0.0, 0.1, 0.6, 180.0, -80.0, 1.0]])
    frames = along([0.0, 90.0], ship_at)
    sigmas = np.tile([0.02, 0.001, 0.001], (len(T), 1))
    files = {
        "fixes": csv("time_s,x_m,y_m,sigma_x_m,sigma_y_m", late, truth.places(T)[:, :2], np.full((len(T), 2), 0.02)),
        "ranges": csv(RANGE, late, HEARD, truth.ranges(T, HEARD), 0.1 * SIGMA),
        "usbl": csv(f"time_s,{DIRECTION}", late, usbl(frames, truth.places(T)), sigmas),
    }
    more = {"ranges": {"beacons": KNOWN}, "usbl": {"ship": csv(SHIP, [0.0, 90.0], ship_at)}}.get(file, {})
    calibration = f"name,value,sigma\n{file}_clock_s,0.2,1.0\n"
    place = folder(tmp_path / "m", truth.files, calibration=calibration, **{file: files[file]}, **more)
    graph, start, report = nls.load(place)
    (shifted,) = (k for k, factor in enumerate(graph.factors) if isinstance(factor, Shifted))
    assert report.place(shifted, 0).endswith(f"{file}.csv:2")
    values = graph.optimize(start).values
    assert values[nls.Keys(f"{file}_clock_s", 0)] == pytest.approx(0.3, abs=0.01)


TIMES = np.array([10.4, 30.2, 55.55, 71.0])
PLACED = "time_s,x_m,y_m,sigma_x_m,sigma_y_m"
SIGMAS = np.full((len(TIMES), 2), 0.5)


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
def placed(tmp_path_factory: pytest.TempPathFactory) -> Positioned:
    return Positioned(tmp_path_factory.mktemp("placed"), TIMES)


def test_fixes_at_their_times_need_no_anchor_and_no_heading(placed: Positioned, tmp_path: Path) -> None:
    fixes = csv(PLACED, TIMES, placed.places(TIMES)[:, :2], SIGMAS)
    graph, _, report = solved(tmp_path / "m", placed, fixes=fixes)
    assert sum(isinstance(factor, Position) for factor in graph.factors) == 1
    assert report.place(3, 1).endswith("fixes.csv:3")
    assert report.vertex_times["x"].tolist() == placed.t.tolist()
    solved(tmp_path / "m", placed, fixes=fixes, poses=placed.poses)


def test_arms_depths_delays_clocks_and_kernels(placed: Positioned, tmp_path: Path) -> None:
    arm = np.array([1.0, -0.5, -0.3])
    words = ["cauchy:2", "none", "none", "cauchy:2"]
    names = "time_s,delay_s,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m,arm_x_m,arm_y_m,arm_z_m,kernel"
    delay = np.array([0.2, 0.3, 0.2, 0.0])
    columns = (TIMES + delay + 1.5, delay, placed.places(TIMES, arm), np.full((4, 3), 0.5), np.tile(arm, (4, 1)), words)
    calibration = "name,value,sigma\nfixes_clock_s,1.5,0\n"
    graph, _, report = solved(tmp_path / "m", placed, fixes=csv(names, *columns), calibration=calibration)
    fixes = [factor for factor in graph.factors if isinstance(factor, Position)]
    assert [(len(fix), fix.kernel) for fix in fixes] == [(2, Cauchy(2.0)), (2, None)]
    assert [report.place(3, 1), report.place(4, 0)] == [str(tmp_path / f"m/fixes.csv:{line}") for line in (5, 3)]


def test_latitudes(placed: Positioned, tmp_path: Path) -> None:
    lat, lon = LocalPlane(54.1, 10.2).geodetic(placed.places(TIMES)[:, :2])
    fixes = csv(PLACED.replace("x_m,y_m", "lat_deg,lon_deg", 1), TIMES, lat, lon, SIGMAS)
    solved(tmp_path / "m", placed, fixes=fixes, origin="lat_deg,lon_deg\n54.1,10.2\n")
    (tmp_path / "m" / "origin.csv").unlink()
    assert_refused(1, "write origin.csv with one row of lat_deg,lon_deg, such as 54.10", nls.load, tmp_path / "m")


def test_rows_outside_the_log_are_left_out_and_counted(placed: Positioned, tmp_path: Path) -> None:
    t, p = np.append([-3.0, 99.0], TIMES), np.vstack([np.zeros((2, 2)), placed.places(TIMES)[:, :2]])
    _, _, report = solved(tmp_path / "m", placed, fixes=csv(PLACED, t, p, np.full((6, 2), 0.5)))
    assert "fixes.csv:2: the first row of 2 that are left out, of 6: not within the track, 0.0" in str(report)
    place = folder(tmp_path / "m", fixes=csv(PLACED, t + 1e6, p, np.full((6, 2), 0.5)), files=placed.files)
    assert_refused(2, "no row is within the track, 0.0 to 80.0 s; do the clocks agree?", nls.load, place)
    place = folder(tmp_path / "m", placed.files, fixes=csv(PLACED, TIMES + 0.01, p[2:], SIGMAS), poses=placed.poses)
    assert_refused(2, "no pose is at 10.41 s; the nearest is pose 11 at 10.4 s. Add a pose", nls.load, place)


def test_numbers_of_poses_do_not_shift(placed: Positioned, tmp_path: Path) -> None:
    fixes = csv(PLACED, TIMES, placed.places(TIMES)[:, :2], SIGMAS)
    place = folder(tmp_path / "m", placed.files, fixes=fixes, anchor=TINY["anchor"])
    words = "names poses by i, but the times of fixes.csv add poses; write poses.csv"
    assert_refused(1, words, nls.load, place)


def test_fixes_give_the_yaw_of_odometry(tmp_path: Path) -> None:
    turn = euler.to_se3([0.0, 0.0, 2.5, 300.0, 40.0, 0.0])
    _, dead, _ = nls.load(folder(tmp_path / "m", contacts=None, sonar=None, anchor=None, truth=None, landmarks=None))
    X = SE3.compose(turn, dead[x])
    fixes = csv(PLACED.replace("time_s", "i"), np.arange(4), X[:, :2], SIGMAS)
    graph, start, report = nls.load(folder(tmp_path / "m", {}, fixes=fixes))
    assert not any(isinstance(factor, Heading) for factor in graph.factors)
    assert start[x] == pytest.approx(X, abs=1e-9)
    assert not any("anchor" in note for note in report.notes)
    assert graph.chi2(start) < 1e-9
    timed = folder(tmp_path / "timed", contacts=None, sonar=None, fixes=fixes.replace("i,", "time_s,", 1))
    assert_refused(1, "has times, but no pose has one; add poses.csv", nls.load, timed)


def test_closures(tmp_path: Path) -> None:
    t = np.array([[5.5, 70.2], [12.0, 33.3]])
    placed = Positioned(tmp_path / "truth", t.ravel())
    T_ij = SE3.compose(SE3.inverse(placed.at(t[:, 0])), placed.at(t[:, 1]))
    state = euler.from_se3(T_ij)
    names = ",".join(COLUMNS["closures"][2:-1])
    closures = csv(names, t, state[:, 3:], state[:, :3], np.full((2, 6), 0.1))
    fixes = csv(PLACED, [71.0], placed.places([71.0])[:, :2], SIGMAS[:1])
    graph, _, report = solved(tmp_path / "m", placed, closures=closures, fixes=fixes)
    assert sum(isinstance(factor, Between) for factor in graph.factors) == 1
    assert report.place(4, 1).endswith("closures.csv:3")
    names = "time_i_s,time_j_s,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad"
    level = csv(names, t, state[:, [3, 4, 2]], np.full((2, 3), 0.1))
    graph, _, _ = solved(tmp_path / "m", placed, closures=level, fixes=fixes)
    assert sum(isinstance(factor, XYH) for factor in graph.factors) == 2
