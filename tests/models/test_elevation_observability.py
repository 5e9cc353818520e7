"""How well two views of a point tell its elevation, motion by motion: the table of the page on sonar.

The point has the parameters (r, az, el) in the frame of the first view, which measures the first two. What both views
say of el when r and az are unknown too is the Schur complement of their information matrix.
"""

from __future__ import annotations

import numpy as np
import pytest

from models import SE3
from models.algebra import Array
from models.sensors import cartesian, point_in_frame, range_azimuth

same = np.testing.assert_allclose
SIGMAS = np.array([0.01, 0.005])  # range, m; azimuth, rad
STEP = {  # a motion of the sonar from its first view to its second: (x, y, z, roll, pitch, yaw), m and rad
    "surge": [0.3, 0, 0, 0, 0, 0],
    "sway": [0, 0.3, 0, 0, 0, 0],
    "heave": [0, 0, 0.3, 0, 0, 0],
    "roll": [0, 0, 0, 0.1, 0, 0],
    "pitch": [0, 0, 0, 0, 0.1, 0],
    "yaw": [0, 0, 0, 0, 0, 0.1],
    "planar": [0.3, 0.2, 0, 0, 0, 0.1],
}
MOUNT = SE3.exp([0.0, 0.0, 0.0, 0.0, -np.deg2rad(35), 0.0])  # a sonar that looks down
STEP["surge, looking down"] = SE3.log(SE3.compose(SE3.inverse(MOUNT), SE3.compose(SE3.exp(STEP["surge"]), MOUNT)))
TABLE = {  # information on el, 1/rad^2, of a point at 4 m and 0.2 rad: at elevation 0 and at 0.05 rad
    "heave": (448.74, 450.99),
    "roll": (192.50, 192.89),
    "surge, looking down": (167.39, 190.24),
    "pitch": (7.984, 8.143),
    "planar": (0.0, 1.641),
    "surge": (0.0, 1.268),
    "sway": (0.0, 0.3155),
    "yaw": (0.0, 0.0),
}


def second_view(step: str, h: Array) -> tuple[Array, Array]:
    """(r, az) (n, 2) of the second view and their derivative (n, 2, 3) by (r, az, el) of the first."""
    p, dp = cartesian(h)
    q, (_, R_inv) = point_in_frame(SE3, np.tile(SE3.exp(STEP[step]), (len(h), 1)), p)
    z, J = range_azimuth(q)
    return z, J @ R_inv @ dp


def information(step: str, r: float = 4.0, az: float = 0.2, el: float = 0.0) -> float:
    """Of el, 1/rad^2: I_el,el - I_el,o I_o,o^-1 I_o,el with o = (r, az)."""
    _, H_2 = second_view(step, np.array([[r, az, el]]))
    A = np.concatenate([np.eye(3)[:2], H_2[0]]) / np.tile(SIGMAS, 2)[:, None]
    I = A.T @ A
    return float(I[2, 2] - I[2, :2] @ np.linalg.solve(I[:2, :2], I[:2, 2]))


TINY = 1e-10  # of informations of 10 to 1000
AZIMUTHS = (-0.25, 0.0, 0.2)


@pytest.mark.parametrize("step", ["surge", "sway", "planar"])
def test_motion_in_the_plane_says_nothing_at_elevation_0_and_little_beside_it(step: str) -> None:
    """The derivative is proportional to sin el, the information to its square; up and down look the same."""
    for az in AZIMUTHS:
        assert abs(information(step, az=az, el=0.0)) < TINY
        found = [information(step, az=az, el=el) for el in (0.025, 0.05, 0.1)]
        same(np.array(found[1:]) / found[:-1], 4.0, rtol=0.05)
    h = np.random.default_rng(1).uniform([1.0, -0.25, -0.2], [6.0, 0.25, 0.2], size=(50, 3))
    same(second_view(step, h)[0], second_view(step, h * [1, 1, -1])[0], atol=1e-14)
    _, H = second_view(step, h * [1, 1, 0])
    same(H[:, :, 2], 0.0, atol=1e-15)  # Gauss-Newton started at elevation 0 never leaves it


def test_the_table() -> None:
    for step, row in TABLE.items():
        assert [information(step, el=el) for el in (0.0, 0.05)] == pytest.approx(row, rel=1e-3, abs=TINY), step
