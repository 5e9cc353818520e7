"""A lawn-mower survey as raw logs, exact or noisy, with sensors that are off by known amounts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

import nls
from factors import Isotropic, Position
from models import SE3, euler
from models.algebra import Array
from models.manifolds.so3 import rotation3
from nls import FactorGraph, Values
from nls.missions import MissionReport
from nls.missions.folder.columns import COLUMNS, GYRO
from nls.missions.folder.table import csv_text
from tests.nls.missions.folder.mission_files import RAW, folder

RATE, LENGTH = 200, 240  # Hz of the truth, s
SIGMA = {"v": 0.005, "tilt": 0.002, "yaw": 0.005, "z": 0.02, "fix": 0.2}
(x,) = nls.kinds("x")


class Survey:
    """Legs of 40 s at 1 m/s, turned by half a circle within 15 s each, with a little pitch and roll.

    off : true values by the name of calibration.csv, and gyro_bias, rad/s.
    straight : without the turns.
    """

    def __init__(self, seed: int | None = 0, straight: bool = False, arm: Array | None = None, **off: float) -> None:
        self.off, self.rng = off, np.random.default_rng(seed)
        self.noisy = 0.0 if seed is None else 1.0
        t = self.t = np.arange(0.0, LENGTH + 6.0, 1 / RATE)
        phase = (t - 3.0) % 110.0
        turn = np.pi / 15.0 * (((phase > 40) & (phase < 55)) * 1.0 - ((phase > 95) & (phase < 110)) * 1.0)
        rate = np.zeros(len(t)) if straight else np.convolve(turn, np.ones(RATE) / RATE, "same")
        yaw = 0.3 + np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) / RATE))
        self.rpy = np.column_stack([0.06 * np.sin(0.31 * t), 0.05 * np.cos(0.23 * t), yaw])
        R = rotation3(euler.quaternion_from_angles(self.rpy))
        self.v = np.column_stack([1 + 0.2 * np.sin(0.11 * t), 0.05 * np.sin(0.4 * t), 0.02 * np.cos(0.3 * t)])
        world = np.einsum("nij,nj->ni", R, self.v)
        self.p = np.zeros((len(t), 3))
        self.p[1:] = np.cumsum(0.5 * (world[1:] + world[:-1]) / RATE, axis=0)
        self.p[:, 2] += 20.0
        # the DVL is at an arm: v + w x arm, w of the body by differences of R
        self.arm = np.zeros(3) if arm is None else np.asarray(arm)
        dR = np.gradient(R, 1 / RATE, axis=0)
        W = np.einsum("nji,njk->nik", R, dR)
        self.w = np.column_stack([W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]])
        self.at_dvl = self.v + np.cross(self.w, self.arm)

    def noise(self, sigma: float, *shape: int) -> Array:
        return self.noisy * self.rng.normal(0, sigma, shape)

    def tables(self, gyro: bool = False) -> dict[str, tuple[Sequence[str], tuple[object, ...]]]:
        """Columns of the files by name."""
        every = {"dvl": RATE // 5, "ahrs": RATE // 10, "depth": RATE // 2, "gyro": RATE // 20}
        rows = {name: np.arange(3 * RATE, (LENGTH + 3) * RATE + 1, step) for name, step in every.items()}
        k, off = rows["dvl"], self.off
        a, scale = off.get("dvl_yaw_rad", 0.0), 1 + off.get("dvl_scale", 0.0)
        turned = np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]])
        v = scale * self.at_dvl[k] @ turned.T + self.noise(SIGMA["v"], len(k), 3)
        ones = np.ones(len(k), dtype=int)
        out: dict[str, tuple[Sequence[str], tuple[object, ...]]] = {
            "dvl": (RAW["dvl"], (self.t[k], v, ones)),
            "dvl_mount": (COLUMNS["dvl_mount"], (np.append(self.arm, np.zeros(3))[None],)),
        }
        k = rows["ahrs"]
        late = np.column_stack([np.interp(self.t[k] - off.get("ahrs_clock_s", 0.0), self.t, y) for y in self.rpy.T])
        late[:, 2] -= off.get("declination_rad", 0.0)
        late += self.noise(1.0, len(k), 3) * [SIGMA["tilt"], SIGMA["tilt"], SIGMA["yaw"]]
        out["ahrs"] = (RAW["ahrs"][: 4 - gyro], (self.t[k], late[:, : 3 - gyro]))
        depth = rows["depth"]
        out["depth"] = (RAW["depth"], (self.t[depth], self.p[depth, 2:] + self.noise(SIGMA["z"], len(depth), 1)))
        noise = ["sigma_v_m_s", "scale", "sigma_bridge_m_s_sqrt_s", "sigma_roll_rad", "sigma_pitch_rad", "sigma_z_m"]
        sigmas = [SIGMA["v"], 0.0, 0.05, SIGMA["tilt"], SIGMA["tilt"], SIGMA["z"]]
        if gyro:
            k, density = rows["gyro"], 3e-4
            bias = off.get("gyro_bias", 0.0)
            w = self.w[k] + [0.0, 0.0, bias] + self.noise(density * np.sqrt(RATE / every["gyro"]), len(k), 3)
            out["gyro"] = (RAW["gyro"], (self.t[k], w))
            noise, sigmas = [*noise, *GYRO], [*sigmas, density, 0.005, 1e-6]
        else:
            noise, sigmas = [*noise, "sigma_yaw_rad"], [*sigmas, SIGMA["yaw"]]
        out["noise"] = (noise, ([sigmas],))
        return out

    def load(
        self,
        path: Path,
        calibration: dict[str, tuple[float, float]],
        fixes: int = 20,
        gyro: bool = False,
        replace: dict[str, str] | None = None,
    ) -> tuple[FactorGraph, Values, MissionReport]:
        """The mission with this calibration.csv, and a position every so many poses; 0 for none."""
        texts = {name: csv_text(names, *columns).decode() for name, (names, columns) in self.tables(gyro).items()}
        if calibration:
            numbers = np.array(list(calibration.values()), dtype=float)
            texts["calibration"] = csv_text(COLUMNS["calibration"], list(calibration), numbers).decode()
        texts["anchor"] = self.anchor([0], 0.01)
        graph, values, report = nls.load(folder(path, {**texts, **(replace or {})}))
        if fixes:
            i = np.arange(0, LENGTH - 1, fixes)
            z = self.p[(3 + i) * RATE, :2] + self.noise(SIGMA["fix"], len(i), 2)
            graph.add(Position(x[i], z, Isotropic(SIGMA["fix"]), components=("x", "y")))
        return graph, values, report

    def anchor(self, i: npt.ArrayLike, sigma: float) -> str:
        """The file of the true places of poses, and of their headings, which are hardly known."""
        i = np.asarray(i)
        k = (3 + i) * RATE
        level = np.column_stack([self.p[k, :2], self.rpy[k, 2], np.tile([sigma, sigma, 0.5], (len(i), 1))])
        return csv_text(COLUMNS["anchor"], i, level).decode()

    def true(self, values: Values) -> Array:
        """True Euler vectors (n, 6) of the poses."""
        k = (3 + values.stack("x").numbers) * RATE
        return np.column_stack([self.rpy[k], self.p[k]])


def away(survey: Survey, values: Values) -> Array:
    """Distances (n,) in x and y of the poses from the truth."""
    return np.asarray(np.linalg.norm(SE3.position(values.stack("x").X)[:, :2] - survey.true(values)[:, 3:5], axis=1))
