"""path.csv: a path that was reckoned elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import XYH, ZPR
from models import euler
from nls import kinds
from nls.missions.folder.columns import COLUMNS
from tests.nls.missions.folder.mission_files import folder
from tests.nls.missions.folder.positioned import csv

(x,) = kinds("x")
T = np.arange(0.0, 41.0)
WAY = np.column_stack([10 * np.sin(T / 10), T, 0.1 * T])  # x, y, yaw
SIGMAS = np.tile([0.1, 0.2, 0.03], (len(T), 1))
PATH = csv("time_s,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad", T, WAY, SIGMAS)


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
    assert len(values.stack("x")) == len(T) + 1
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
