"""Axes of a log turned into those of a mission, against rotations of the vectors themselves."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from models import SE3, euler
from models.algebra import Array
from nls import OptionError
from nls.missions.folder.columns import ANGLES, PLACE
from nls.missions.importing.frames import angles_of, turn
from tests.combinations import for_all
from tests.nls.missions.importing.logs import refused

WORLD = {"NED": lambda v: v, "ENU": lambda v: v[[1, 0, 2]] * [1, 1, -1], "NWU": lambda v: v * [1, -1, -1]}
BODY = {"FRD": lambda v: v, "FLU": lambda v: v * [1, -1, -1]}


def pose(columns: dict[str, Array]) -> Array:
    return euler.to_se3([float(columns[name][0]) for name in (*ANGLES, *PLACE)])


@for_all(world=list(WORLD), body=list(BODY))
def test_a_point_on_the_body_is_where_it_was(world: str, body: str) -> None:
    """A point seen from the body lies at the same place of the world, whichever axes it is written in."""
    columns = dict(zip((*ANGLES, *PLACE), np.array([[0.3], [-0.4], [2.0], [5.0], [-7.0], [3.0]]), strict=True))
    turned = turn("truth", columns, f"{world}/{body}")
    point = np.array([1.0, 0.5, -0.2])
    before = SE3.act(pose(columns), point)
    after = SE3.act(pose(turned), BODY[body](point))
    assert after == pytest.approx(WORLD[world](before))


def test_a_mounting_turns_with_the_axes_of_the_body() -> None:
    mount = dict(zip((*ANGLES, *PLACE), np.array([[0.3], [-0.4], [2.0], [5.0], [-7.0], [3.0]]), strict=True))
    turned = turn("dvl_mount", mount, "FLU")
    v = np.array([1.0, 0.5, -0.2])
    assert SE3.act(pose(turned), BODY["FLU"](v)) == pytest.approx(BODY["FLU"](SE3.act(pose(mount), v)))


def test_sigmas_and_lone_angles() -> None:
    one = np.ones(1)
    fix = turn("fixes", {"x_m": one, "y_m": 2 * one, "sigma_x_m": 3 * one, "sigma_y_m": 4 * one}, "ENU")
    assert [float(fix[name][0]) for name in ("x_m", "y_m", "sigma_x_m", "sigma_y_m")] == [2, 1, 4, 3]
    place = {"x_m": one, "y_m": one, "yaw_rad": 0.2 * one}
    assert turn("anchor", place, "ENU")["yaw_rad"] == pytest.approx(np.pi / 2 - 0.2)
    assert turn("odometry", place, "ENU") == {"x_m": one, "y_m": -one, "yaw_rad": pytest.approx([-0.2])}
    with pytest.raises(OptionError, match="together"):
        turn("zpr", {"z_m": one, "pitch_rad": one}, "ENU/FRD")
    with pytest.raises(OptionError, match="a y_m beside x_m"):
        turn("fixes", {"x_m": one}, "ENU")


def test_rotations_of_both_kinds() -> None:
    rpy = np.array([[0.1, -0.2, 3.0]])
    q = euler.to_se3(np.column_stack([rpy, np.zeros((1, 3))]))[:, 3:]
    R = np.stack([SE3.act(np.r_[0, 0, 0, q[0]], axis) for axis in np.eye(3)], axis=1)
    assert angles_of("quaternion", q) == pytest.approx(rpy)
    assert angles_of("rotation", R.reshape(1, 9)) == pytest.approx(rpy)


def test_no_rotation_is_refused_with_its_line(tmp_path: Path) -> None:
    mapping = 'ahrs = { time_s = "t", quaternion = ["a", "b", "c", "d"] }'
    for numbers in ("0,0,0,2", "1e200,0,0,1", "0,-1e300,0,0"):
        said = refused(tmp_path, mapping, log=f"t,a,b,c,d\n0,0,0,0,1\n1,{numbers}\n")
        assert re.search(r"log\.csv:3: quaternion .* is no rotation; is the order", said)
    mapping = 'depth = { frame = "ENU", time_s = "t", z_m = { column = "a", up = true } }'
    assert "up and frame = 'ENU' both say" in refused(tmp_path, mapping, log="t,a\n0,0\n")
