"""motion.csv: a vehicle whose motion nothing measures, with positions, and the compass and depth that it may have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Heading, Landmark
from models import SE3, euler
from models.algebra import Array
from nls import GraphFileError, Marginals, kinds
from nls.missions.folder import columns
from tests.nls.io.g2o_files import assert_refused
from tests.nls.missions.folder.mission_files import csv, folder

(x,) = kinds("x")
MOTION = "sigma_walk_m_sqrt_s\n0.3\n"
NOISE = "sigma_roll_rad,sigma_pitch_rad,sigma_yaw_rad,sigma_z_m\n0.01,0.02,0.03,0.1\n"
USBL = ",".join(("time_s", *columns.USBL, *columns.suffixed(columns.USBL)))
FIXED = "time_s,x_m,y_m,sigma_x_m,sigma_y_m,arm_x_m,arm_y_m,arm_z_m"
T = np.arange(0.0, 60.0, 2.0)
ROWS = np.arange(-1.0, 61.0, 0.5)
ARM = np.array([1.0, 0.2, -0.5])
BEACON = np.array([40.0, 10.0, 30.0])


def state(t: Array) -> Array:
    """Roll, pitch, yaw, x, y and z (n, 6) of an ROV that turns through north, and dives."""
    angles = np.column_stack([0.1 * np.sin(t / 9), 0.1 * np.cos(t / 7), 3 + t / 20])
    return np.column_stack([angles, 3 * np.sin(t / 20), 2 * np.cos(t / 15), 5 + t])


X = euler.to_se3(state(T))


def logs(t: Array = ROWS, **changed: str | None) -> dict[str, str | None]:
    """Files of an ROV with a compass and a depth sensor, without noise."""
    rows = state(t)
    angles = csv("time_s,roll_rad,pitch_rad,yaw_rad", t, (rows[:, :3] + np.pi) % (2 * np.pi) - np.pi)
    return {"motion": MOTION, "ahrs": angles, "depth": csv("time_s,z_m", t, rows[:, 5]), "noise": NOISE} | changed


def fixes(arm: Array) -> str:
    sigmas, arms = np.full((len(T), 2), 0.01), np.tile(arm, (len(T), 1))
    return csv(FIXED, T, SE3.act(X, arm)[:, :2], sigmas, arms)


def directions(sight: Array, names: str = USBL) -> str:
    far = np.linalg.norm(sight, axis=1)
    z = np.column_stack([far, np.arctan2(sight[:, 1], sight[:, 0]), np.arcsin(sight[:, 2] / far)])
    more = [np.full(len(T), 7)] if "beacon" in names else []
    return csv(names, T, z, np.full((len(T), 3), 0.001), *more)


OWN = {
    "usbl": directions(SE3.act(SE3.inverse(X), np.tile(BEACON, (len(T), 1))), f"{USBL},beacon"),
    "beacons": csv("beacon,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m", [7], BEACON[None], [[0.01, 0.01, 0.01]]),
}
SHIP = {
    "usbl": directions(SE3.position(X)),
    "ship": "time_s,x_m,y_m,z_m,roll_rad,pitch_rad,yaw_rad\n-9,0,0,0,0,0,0\n99,0,0,0,0,0,0\n",
}


@pytest.mark.parametrize("places", [{"fixes": fixes(0 * ARM)}, {"fixes": fixes(ARM)}, SHIP, OWN])
def test_compass_depth_and_places_are_a_mission(places: dict[str, str], tmp_path: Path) -> None:
    """Also at a lever arm, by directions from a ship, and by those from the vehicle, along its axes."""
    files = logs(motion="sigma_walk_m_sqrt_s\n10\n", **places)  # which hardly smooths
    graph, start, report = nls.load(folder(tmp_path / "m", files))
    assert report.vertex_times["x"] == pytest.approx(T)
    assert report.unmeasured == ()
    assert not report.warnings
    assert np.abs(SE3.position(np.asarray(start[x])) - state(T)[:, 3:]).max() < 0.05  # and not all at one place
    result = graph.optimize(start)
    assert result.converged
    found = euler.from_se3(result.values[x])
    assert found[:, 3:5] == pytest.approx(state(T)[:, 3:5], abs=0.05)
    assert found[:, 5] == pytest.approx(state(T)[:, 5], abs=0.02)
    assert [report.place(k, 3).split("/")[-1] for k in range(3)] == ["motion.csv:2", "depth.csv:16", "ahrs.csv:16"]
    assert np.cos(found[:, :3] - state(T)[:, :3]) == pytest.approx(1.0, abs=2e-4)
    Sigma = Marginals(graph, result.values).covariance(x[result.values.stack(x).numbers], view="euler")
    assert (np.sqrt(Sigma[:, [0, 1, 2], [0, 1, 2]]).max(axis=0) < np.array([0.01, 0.02, 0.03]) * 1.000001).all()


def test_a_fast_dive_is_no_walk_where_the_depth_is_measured(tmp_path: Path) -> None:
    graph, start, _ = nls.load(folder(tmp_path / "m", logs(fixes=fixes(0 * ARM))))
    assert not any(isinstance(factor, Landmark) for factor in graph.factors)
    assert graph.optimize(start).chi2_final < 0.5 * len(T)
    places = csv("time_s,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m", T, state(T)[:, 3:], np.full((len(T), 3), 0.1))
    graph, start, _ = nls.load(folder(tmp_path / "f", {"motion": MOTION, "fixes": places}))
    assert isinstance(graph.factors[3], Landmark)
    steps = np.square(np.diff(state(T)[:, 3:], axis=0)).sum() / (0.3**2 * 2)
    assert graph.chi2(start) == pytest.approx(steps)  # of x, y and z


@pytest.mark.parametrize(
    ("left", "unmeasured"), [("ahrs depth noise", "roll pitch yaw z"), ("depth", "z"), ("ahrs", "roll pitch yaw")]
)
def test_what_nothing_measures_is_known_by_name_and_moves_nothing(left: str, unmeasured: str, tmp_path: Path) -> None:
    files = logs(fixes=fixes(0 * ARM), **dict.fromkeys(left.split()))
    graph, start, report = nls.load(folder(tmp_path / "m", files))
    assert report.unmeasured == tuple(unmeasured.split())
    result = graph.optimize(start)
    assert result.converged
    assert result.dof == 2 * len(T) - 2  # the gauge counts for nothing
    assert euler.from_se3(result.values[x])[:, 3:5] == pytest.approx(state(T)[:, 3:5], abs=0.05)


def test_a_compass_alone_needs_its_sigma_alone(tmp_path: Path) -> None:
    compass = csv("time_s,yaw_rad", ROWS, np.sin(ROWS / 9))
    files = {"motion": MOTION, "ahrs": compass, "noise": "sigma_yaw_rad\n0.03\n", "fixes": fixes(0 * ARM)}
    graph, start, report = nls.load(folder(tmp_path / "m", files))
    assert report.unmeasured == ("roll", "pitch", "z")
    found = euler.from_se3(graph.optimize(start).values[x])
    assert found[:, :3] == pytest.approx(np.column_stack([0 * T, 0 * T, np.sin(T / 9)]), abs=1e-6)


def test_declination_and_clock_of_a_compass_are_calibrations(tmp_path: Path) -> None:
    """The directions to a beacon tell where north is."""
    rows = state(ROWS)
    ahrs = csv("time_s,roll_rad,pitch_rad,yaw_rad", ROWS + 0.4, rows[:, :2], rows[:, 2] - 6.2)
    calibration = "name,value,sigma\ndeclination_rad,0.0,1.0\nahrs_clock_s,0.4,0\n"
    files = logs(ahrs=ahrs, calibration=calibration, fixes=fixes(0 * ARM), **OWN)
    graph, start, _ = nls.load(folder(tmp_path / "m", files))
    north = graph.optimize(start).values[nls.Keys("declination_rad", 0)]
    assert north == pytest.approx(6.2 - 2 * np.pi, abs=0.01)
    calibration = "name,value,sigma\nahrs_clock_s,0.2,1.0\n"
    ahrs = csv("time_s,roll_rad,pitch_rad,yaw_rad", ROWS + 0.4, rows[:, :3] - [0, 0, 2 * np.pi])
    noise = NOISE.replace("0.01,0.02,0.03", "0.0001,0.0001,0.01")  # whose tilt tells the clock
    graph, start, _ = nls.load(folder(tmp_path / "c", logs(ahrs=ahrs, calibration=calibration, noise=noise, **OWN)))
    assert graph.optimize(start).values[nls.Keys("ahrs_clock_s", 0)] == pytest.approx(0.4, abs=0.05)


def test_rows_of_a_compass_at_the_times_of_the_fixes_may_be_uneven(tmp_path: Path) -> None:
    """No pose is in a hole. One that is has a larger sigma than its row."""
    t = T[[0, 1, 2, 3, 9, 10, 11, 20, 21, 29]]
    places = csv("time_s,x_m,y_m,sigma_x_m,sigma_y_m", t, state(t)[:, 3:5], np.full((len(t), 2), 0.1))
    _, start, report = nls.load(folder(tmp_path / "m", logs(t, fixes=places)))
    assert len(start.stack(x)) == len(t)
    assert not any("hole" in note for note in report.notes)
    dense = np.concatenate([ROWS[:30], ROWS[40:]])
    graph, _, report = nls.load(folder(tmp_path / "h", logs(dense, fixes=fixes(0 * ARM))))
    inside = (dense[29] < T) & (dense[30] > T)
    (heading,) = (factor for factor in graph.factors if isinstance(factor, Heading))
    sigmas = np.asarray(heading.noise.sigma)
    assert (sigmas[inside] > 0.03).all()
    assert sigmas[~inside] == pytest.approx(0.03)
    assert any("a hole between" in note for note in report.notes)


@pytest.mark.parametrize("name", ["ahrs", "depth", "fixes"])
def test_the_odd_one_of_three_clocks_is_named(name: str, tmp_path: Path) -> None:
    files = logs(fixes=fixes(0 * ARM))
    head, *rows = str(files[name]).splitlines()
    late = (f"{float(t) + 3600},{rest}" for t, rest in (row.split(",", 1) for row in rows))
    spans = "ahrs.csv has .* to .* s; depth.csv has .*; fixes.csv has"
    with pytest.raises(GraphFileError, match=f"{spans} .* {name}.csv looks 3600 s late"):
        nls.load(folder(tmp_path / "m", files | {name: "\n".join([head, *late])}))


def test_the_track_lasts_as_long_as_all_logs(tmp_path: Path) -> None:
    _, _, report = nls.load(folder(tmp_path / "m", logs(np.arange(5.0, 50.5, 0.5), fixes=fixes(0 * ARM))))
    assert report.vertex_times["x"].tolist() == T[(T >= 5) & (T <= 50)].tolist()
    assert any("fixes.csv:2: the first row of 7 that are left out, of 30" in note for note in report.notes)


def test_directions_and_a_lever_arm_need_all_angles(tmp_path: Path) -> None:
    """And the printed cure for an arm works."""
    turned = logs(ahrs=csv("time_s,yaw_rad", ROWS, ROWS / 99), **OWN)
    assert_refused(2, "is a direction from the vehicle", nls.load, folder(tmp_path / "turned", turned))
    level = csv("time_s,roll_rad,pitch_rad,yaw_rad", ROWS, np.zeros((len(ROWS), 3)))
    assert nls.load(folder(tmp_path / "m", logs(ahrs=level, fixes=fixes(ARM))))[2].unmeasured == ()


def test_poses_denser_than_the_rows_say_no_more_than_these(tmp_path: Path) -> None:
    graph, _, _ = nls.load(folder(tmp_path / "m", logs(np.arange(0.0, 61.0, 6.0), fixes=fixes(0 * ARM))))
    (heading,) = (factor for factor in graph.factors if isinstance(factor, Heading))
    assert np.median(heading.noise.sigma) == pytest.approx(0.03 * np.sqrt(3), rel=0.05)
