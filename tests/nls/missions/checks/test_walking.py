"""Implausible numbers of a vehicle without a DVL: its heading beside its fixes, its depth alone."""

from __future__ import annotations

import numpy as np
import pytest

from models.algebra import wrap
from tests.nls.missions.checks.missions import Change, changed, findings
from tests.nls.missions.folder.positioned import csv


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
            ["yaw_rad of ahrs.csv looks counted from", "x_m, y_m of"],
        ),
        ("ahrs", "yaw_rad", lambda yaw: 0 * yaw - 1.7, ["it is -1.7 rad in all rows", "ahrs.csv looks stuck"]),
        ("fixes", "y_m", lambda y: -y, ["multiply yaw_rad by -1", "multiply y_m by -1"]),
        ("fixes", "x_m", lambda x: -x, ["multiply x_m by -1"]),
        ("fixes", "whole", lambda y: y[:, [0, 2, 1, 3, 4]], ["counted from east", "exchange the names of x_m, y_m"]),
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
