"""Starts of a mission: wrong fixes move it little, a compass keeps its heading; places of beacons from ranges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Heading, Isotropic, Position, Shifted
from models import SE3, euler
from nls.missions.folder.calibration import Calibrations
from nls.missions.starts.placing import beacon_of_ranges, turn_to_measurements
from tests.nls.missions.folder.mission_files import Positioned

x, b, c = nls.kinds("x", "b", "c")
TURN = euler.to_se3([0.0, 0.0, 2.0, 70.0, -30.0, 0.0])
NOWHERE = np.zeros((0, 3))


@pytest.fixture
def start(tmp_path: Path) -> nls.Values:
    return nls.Values({x: (SE3, Positioned(tmp_path / "truth").X)})


def test_a_third_of_wrong_fixes(start: nls.Values) -> None:
    X = SE3.compose(TURN, start[x])
    z, rng = X[::2, :2].copy(), np.random.default_rng(0)
    wrong = rng.choice(len(z), len(z) // 3, replace=False)
    z[wrong] += rng.uniform(20, 90, (len(wrong), 2))
    fixes = Position(x[np.arange(0, 81, 2)], z, Isotropic(1.0), ("x", "y"))
    turn = turn_to_measurements(nls.FactorGraph([fixes]), start, NOWHERE, None)
    assert SE3.act(turn, start[x][:, :3]) == pytest.approx(X[:, :3], abs=0.5)


def test_with_a_compass_it_does_not_turn_to_fixes(start: nls.Values) -> None:
    X = SE3.compose(TURN, start[x])
    yaw = euler.from_se3(start[x])[:, 2]
    compass = Heading(x[[4, 9]], yaw[[4, 9]] + 1.5, Isotropic(0.1))
    fixes = Position(x[[0, 80]], X[[0, 80], :2], Isotropic(1.0), ("x", "y"))
    for heading in (compass, Shifted(compass, [[1.0]], c[0])):
        graph = nls.FactorGraph([heading, fixes])
        turn = turn_to_measurements(graph, start, NOWHERE, Calibrations(None).headings(heading))
        assert euler.from_se3(turn)[:3] == pytest.approx([0, 0, 1.5], abs=1e-9)
        moved = SE3.act(turn, start[x][[0, 80], :3])
        assert moved.mean(axis=0)[:2] == pytest.approx(X[[0, 80], :2].mean(axis=0), abs=1e-6)


def test_one_spot_gives_no_yaw(start: nls.Values) -> None:
    fix = Position(x[7], [3.0, 4.0], Isotropic(1.0), ("x", "y"))
    turn = turn_to_measurements(nls.FactorGraph([fix]), start, NOWHERE, None)
    assert SE3.act(turn, start[x][7, :3])[:2] == pytest.approx([3.0, 4.0])
    assert turn[3:] == pytest.approx([0, 0, 0, 1])


T = np.linspace(0, 1, 60)
COURSES = {
    "circle": np.column_stack([20 * np.cos(7 * T), 15 * np.sin(7 * T), 3 + 0 * T]),
    "lawn mower": np.column_stack([40 * np.abs((4 * T) % 2 - 1), 30 * T, 3 + np.sin(9 * T)]),
    "nearly a line": np.column_stack([100 * T, 2 * np.sin(9 * T), 3 + 0 * T]),
}


@pytest.mark.parametrize("course", COURSES)
@pytest.mark.parametrize("wrong", [0, 9])
def test_a_beacon_is_where_its_ranges_meet(course: str, wrong: int) -> None:
    p, rng = COURSES[course] + [500.0, -200.0, 0.0], np.random.default_rng(4)
    for beacon in rng.uniform([400, -300, 10], [600, -100, 40], (20, 3)):
        r = np.linalg.norm(p - beacon, axis=1)
        r[rng.choice(len(r), wrong, replace=False)] += rng.uniform(5, 60, wrong)
        assert beacon_of_ranges(p, r, float(beacon[2])) == pytest.approx(beacon, abs=1e-3), beacon
        if not wrong:
            assert beacon_of_ranges(p, r) == pytest.approx(beacon, abs=1e-3), beacon


def test_on_a_level_course_it_is_below() -> None:
    above = np.array([30.0, 10.0, -5.0])
    r = np.linalg.norm(COURSES["circle"] - above, axis=1)
    assert beacon_of_ranges(COURSES["circle"], r) == pytest.approx([30.0, 10.0, 11.0], abs=1e-4)


def test_from_one_place_there_is_still_a_start() -> None:
    beacon = beacon_of_ranges(np.zeros((3, 3)), np.full(3, 5.0))
    assert np.linalg.norm(beacon) == pytest.approx(5.0, abs=1e-6)
