"""Implausible numbers of a vehicle without a DVL: its heading beside its fixes, its depth alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from models.algebra import Array, wrap
from nls.missions import read_mission
from tests.nls.missions.folder.mission_files import folder
from tests.nls.missions.folder.positioned import csv

NOISE = csv("sigma_roll_rad,sigma_pitch_rad,sigma_yaw_rad,sigma_z_m", [[0.01, 0.01, 0.01, 0.05]])
FIXES = "time_s,x_m,y_m,sigma_x_m,sigma_y_m"
Change = Callable[[Array], Array]


def same(y: Array) -> Array:
    return y


def rov(
    path: Path, heading: Change = same, depth: Change = same, place: Change = same, course: float = 0.0
) -> list[str]:
    """Sentences about 400 s of lanes with turns to either side; the course leaves the heading by a part of it."""
    rng, t = np.random.default_rng(0), np.arange(0.0, 400.0, 0.5)
    yaw = np.convolve(
        np.pad(np.array([0, 1, 2, 1])[(t // 45).astype(int) % 4] * np.pi / 2, 10, "edge"), np.ones(21) / 21, "valid"
    )
    ways = 0.25 * np.column_stack([np.cos((1 + course) * yaw), np.sin((1 + course) * yaw)])
    p = np.cumsum(ways, axis=0)[::4] + rng.normal(0, 0.5, (200, 2))
    z = 8 + 2 * np.sin(t / 14) + rng.normal(0, 0.05, 800)
    rpy = np.column_stack([rng.normal(0, 0.01, (800, 2)), wrap(heading(yaw + rng.normal(0, 0.01, 800)))])
    files = {
        "motion": csv("sigma_walk_m_sqrt_s", [0.7]),
        "ahrs": csv("time_s,roll_rad,pitch_rad,yaw_rad", t, rpy),
        "depth": csv("time_s,z_m", t, depth(z)),
        "fixes": csv(FIXES, t[::4], place(p), np.full((200, 2), 0.5)),
        "noise": NOISE,
    }
    return [finding.says for finding in read_mission(folder(path, files))[2].findings]


def spikes(z: Array) -> Array:
    return np.where(np.arange(len(z)) % 20 == 7, z + 15, z)


@pytest.mark.parametrize("course", [0.0, 0.5, -1.0, -1.6])
def test_a_right_log_is_plausible_whatever_its_way(course: float, tmp_path: Path) -> None:
    """Ahead, more and more sideways, always along one line, sideways against its turns."""
    assert rov(tmp_path / "m", course=course) == []


@pytest.mark.parametrize(
    ("spoiled", "causes"),
    [
        ({"heading": lambda yaw: -yaw}, ["multiply yaw_rad by -1", "multiply y_m by -1"]),
        ({"heading": lambda yaw: np.pi / 2 - yaw}, ["yaw_rad of ahrs.csv looks counted from east", "x_m, y_m of"]),
        ({"place": lambda p: p * [1, -1]}, ["multiply yaw_rad by -1", "multiply y_m by -1"]),
        ({"place": lambda p: p * [-1, 1]}, ["multiply x_m by -1"]),
        ({"place": lambda p: p[:, ::-1]}, ["counted from east", "exchange the names of x_m, y_m"]),
        ({"heading": lambda yaw: 0 * yaw - 1.7}, ["it is -1.7 rad in all rows", "ahrs.csv looks stuck"]),
        ({"depth": lambda z: 0 * z + 7}, ["it is 7 m in all rows", "depth.csv looks stuck"]),
        ({"depth": lambda z: 1000 * z}, ["divide z_m by 1000"]),
        ({"depth": lambda z: 100 * z}, ["divide z_m by 100,"]),
        ({"depth": spikes}, ["5 % of the rows", "leave out lines 9, 29, 49, 69, 89, 109, 129, "]),
        ({"depth": lambda z: z + 9 * np.diff(z, append=z[-1])}, ["multiply sigma_z_m by"]),
    ],
)
def test_what_the_data_tell_is_named(spoiled: dict[str, Change], causes: list[str], tmp_path: Path) -> None:
    (said,) = rov(tmp_path / "m", **spoiled)
    positions = [said.find(cause) for cause in causes]
    assert positions == sorted(positions)
    assert positions[0] >= 0
