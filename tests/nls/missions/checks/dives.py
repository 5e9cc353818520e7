"""Missions of one vehicle that dives 340 m in six minutes, as files that a test spoils."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import nls
from models import SE3
from models.algebra import apply, wrap
from models.manifolds.euler import quaternion_from_angles
from models.manifolds.so3 import rotation3
from tests.nls.missions.folder.positioned import csv

__all__ = ["Dive"]

Array = npt.NDArray[np.float64]
BEACONS = np.array([[60.0, -40.0, 40.0], [-30.0, 90.0, 35.0], [140.0, 60.0, 42.0]])
SHIP = np.array([40.0, 20.0, 2.0])
STEP, END = 1.0, 340.0  # s
NOISE = "sigma_v_m_s,scale,sigma_bridge_m_s_sqrt_s,sigma_roll_rad,sigma_pitch_rad,sigma_yaw_rad,sigma_z_m"
USBL = "time_s,range_m,bearing_rad,elevation_rad,sigma_range_m,sigma_bearing_rad,sigma_elevation_rad"
(x,) = nls.kinds("x")


class Dive:
    """The truth of a dive: legs with turns to both sides, down to 20 m and up again.

    Parameters
    ----------
    seed : of the noise.
    aid : the file besides those of dead reckoning: ``fixes`` in the first and the last 6 s, ``usbl``, or ``ranges``.

    Attributes
    ----------
    files : by name.
    """

    def __init__(self, seed: int = 1, aid: str = "fixes") -> None:
        rng = np.random.default_rng(seed)
        t = self.t = np.arange(0.0, END + STEP / 2, STEP)
        n = len(t)
        rate = np.where((t % 90 > 75) & (t > 60), np.where((t // 90) % 3 == 0, -1.0, 1.0) * 0.1, 0.0)
        yaw = 0.6 + np.cumsum(rate) * STEP + 0.1 * np.sin(t / 17)
        width = int(5 / STEP)  # of half a window
        pitch = np.where((t > 20) & (t < 80), -0.33, np.where((t > END - 80) & (t < END - 20), 0.33, 0.0))
        pitch = np.convolve(np.pad(pitch, width, "edge"), np.ones(2 * width + 1) / (2 * width + 1), "valid")
        rpy = np.column_stack([0.05 * np.sin(t / 4), pitch + 0.02 * np.sin(t / 5), yaw])
        body = np.column_stack([1 + 0.1 * np.sin(t / 23), 0.06 * np.sin(t / 11), 0.03 * np.sin(t / 9)])
        v = apply(rotation3(quaternion_from_angles(rpy)), body)
        self.p = np.vstack([np.zeros(3), np.cumsum(0.5 * (v[1:] + v[:-1]) * STEP, axis=0)])
        self.p[:, 2] += 0.5 - min(0.0, float(self.p[:, 2].min()))
        angles = rpy + rng.normal(0, 0.005, (n, 3))
        measured = body + rng.normal(0, 0.02, (n, 3))
        self.files = {
            "dvl": csv("time_s,vx_m_s,vy_m_s,vz_m_s,valid", t, measured, np.ones(n, dtype=int)),
            "ahrs": csv("time_s,roll_rad,pitch_rad,yaw_rad", t, angles),
            "depth": csv("time_s,z_m", t, self.p[:, 2] + rng.normal(0, 0.05, n)),
            "noise": csv(NOISE, [[0.02, 0.001, 0.05, 0.005, 0.005, 0.005, 0.05]]),
        }
        self.files |= getattr(self, f"_{aid}")(rng)

    def _fixes(self, rng: np.random.Generator) -> dict[str, str]:
        t = np.concatenate([np.arange(0.0, 6.5), np.arange(END - 6, END + 0.5)])
        p = self.at(t)[:, :2] + rng.normal(0, 0.5, (len(t), 2))
        return {"fixes": csv("time_s,x_m,y_m,sigma_x_m,sigma_y_m", t, p, np.full((len(t), 2), 0.5))}

    def _usbl(self, rng: np.random.Generator) -> dict[str, str]:
        t = np.arange(4.0, END - 2, 4.0)
        d = self.at(t) - SHIP
        r, heading, sigmas = np.linalg.norm(d, axis=1), 0.4, np.tile([0.2, 0.01, 0.01], (len(t), 1))
        z = np.column_stack([r, np.arctan2(d[:, 1], d[:, 0]) - heading, np.arcsin(d[:, 2] / r)]) + rng.normal(0, sigmas)
        z[:, 1] = wrap(z[:, 1])
        ship = [[0, *SHIP, 0, 0, heading], [END, *SHIP, 0, 0, heading]]
        names = "time_s,x_m,y_m,z_m,roll_rad,pitch_rad,yaw_rad"
        return {"usbl": csv(USBL, t, z, sigmas), "ship": csv(names, ship)}

    def _ranges(self, rng: np.random.Generator) -> dict[str, str]:
        t = np.arange(5.0, END - 2, 3.0)
        k = np.arange(len(t)) % 3
        r = np.linalg.norm(self.at(t) - BEACONS[k], axis=1) + rng.normal(0, 0.3, len(t))
        names = "beacon,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m"
        return {
            "ranges": csv("time_s,beacon,range_m,sigma_range_m", t, k, r, np.full(len(t), 0.3)),
            "beacons": csv(names, np.arange(3), BEACONS, np.full((3, 3), 0.1)),
        }

    def at(self, t: Array) -> Array:
        """True places (n, 3)."""
        return np.column_stack([np.interp(t, self.t, column) for column in self.p.T])

    def error(self, values: nls.Values, report: nls.io.LoadReport) -> float:
        """Root mean square of the horizontal distances from the truth, m."""
        away = SE3.position(values[x])[:, :2] - self.at(report.vertex_times["x"])[:, :2]
        return float(np.sqrt(np.square(away).sum(axis=1).mean()))
