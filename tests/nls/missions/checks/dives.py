"""Missions of one vehicle that dives 720 m in 12 minutes, as tables that a test spoils."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

import nls
from models import SE3
from models.algebra import apply
from models.manifolds.euler import quaternion_from_angles
from models.manifolds.so3 import rotation3
from nls.missions.folder.table import csv_text

__all__ = ["COLUMNS", "Dive", "Tables"]

Array = npt.NDArray[np.float64]
Tables = dict[str, dict[str, Array]]
BEACONS = np.array([[60.0, -40.0, 40.0], [-30.0, 90.0, 35.0], [140.0, 60.0, 42.0]])
SHIP = np.array([40.0, 20.0, 2.0])
STEP = 0.5  # s
COLUMNS = {
    "noise": ("sigma_v_m_s", "scale", "sigma_bridge_m_s_sqrt_s", "sigma_roll_rad", "sigma_pitch_rad", "sigma_yaw_rad"),
}
(x,) = nls.kinds("x")


class Dive:
    """The truth of a dive: legs with turns to both sides, down to 20 m and up again.

    Parameters
    ----------
    seed : of the noise.
    aids : files besides those of dead reckoning: ``fixes`` in the first and the last 6 s, ``usbl``, ``ranges``.
    """

    def __init__(self, seed: int = 1, aids: tuple[str, ...] = ("fixes",)) -> None:
        rng = np.random.default_rng(seed)
        t = self.t = np.arange(0.0, 720.0 + STEP / 2, STEP)
        n = len(t)
        rate = np.where((t % 90 > 75) & (t > 60), np.where((t // 90) % 3 == 0, -1.0, 1.0) * 0.1, 0.0)
        yaw = 0.6 + np.cumsum(rate) * STEP + 0.1 * np.sin(t / 17)
        pitch = np.where((t > 20) & (t < 80), -0.33, np.where((t > 640) & (t < 700), 0.33, 0.0))
        pitch = np.convolve(np.pad(pitch, 10, mode="edge"), np.ones(21) / 21, mode="valid") + 0.02 * np.sin(t / 5)
        roll = 0.05 * np.sin(t / 4)
        rpy = np.column_stack([roll, pitch, yaw])
        body = np.column_stack([1 + 0.1 * np.sin(t / 23), 0.06 * np.sin(t / 11), 0.03 * np.sin(t / 9)])
        v = apply(rotation3(quaternion_from_angles(rpy)), body)
        self.p = np.vstack([np.zeros(3), np.cumsum(0.5 * (v[1:] + v[:-1]) * STEP, axis=0)])
        self.p[:, 2] += 0.5 - min(0.0, float(self.p[:, 2].min()))
        angles = rpy + rng.normal(0, 0.005, (n, 3))
        self.tables: Tables = {
            "dvl": table("time_s vx_m_s vy_m_s vz_m_s valid", t, body + rng.normal(0, 0.02, (n, 3)), np.ones(n)),
            "ahrs": table("time_s roll_rad pitch_rad yaw_rad", t, angles),
            "depth": table("time_s z_m", t, self.p[:, 2] + rng.normal(0, 0.05, n)),
            "noise": table(
                "sigma_v_m_s scale sigma_bridge_m_s_sqrt_s sigma_roll_rad sigma_pitch_rad sigma_yaw_rad sigma_z_m",
                np.array([[0.02, 0.001, 0.05, 0.005, 0.005, 0.005, 0.05]]),
            ),
        }
        self.rpy, self.rng = rpy, rng
        for aid in aids:
            getattr(self, f"_{aid}")()

    def _fixes(self) -> None:
        t = np.concatenate([np.arange(0.0, 6.5), np.arange(714.0, 720.5)])
        p = self.at(t)[:, :2] + self.rng.normal(0, 0.5, (len(t), 2))
        self.tables["fixes"] = table("time_s x_m y_m sigma_x_m sigma_y_m", t, p, np.full((len(t), 2), 0.5))

    def _usbl(self) -> None:
        t = np.arange(4.0, 718.0, 4.0)
        d = self.at(t) - SHIP
        r, heading = np.linalg.norm(d, axis=1), 0.4
        bearing = np.arctan2(d[:, 1], d[:, 0]) - heading
        z = np.column_stack([r, bearing, np.arcsin(d[:, 2] / r)]) + self.rng.normal(0, [0.2, 0.01, 0.01], (len(t), 3))
        z[:, 1] = np.remainder(z[:, 1] + np.pi, 2 * np.pi) - np.pi
        names = "time_s range_m bearing_rad elevation_rad sigma_range_m sigma_bearing_rad sigma_elevation_rad"
        self.tables["usbl"] = table(names, t, z, np.tile([0.2, 0.01, 0.01], (len(t), 1)))
        ship = np.array([[0, *SHIP, 0, 0, heading], [720, *SHIP, 0, 0, heading]])
        self.tables["ship"] = table("time_s x_m y_m z_m roll_rad pitch_rad yaw_rad", ship)

    def _ranges(self) -> None:
        t, k = np.arange(5.0, 718.0, 3.0), np.arange(238) % 3
        r = np.linalg.norm(self.at(t) - BEACONS[k], axis=1) + self.rng.normal(0, 0.3, len(t))
        self.tables["ranges"] = table("time_s beacon range_m sigma_range_m", t, k, r, np.full(len(t), 0.3))
        places = np.column_stack([np.arange(3), BEACONS, np.full((3, 3), 0.1)])
        self.tables["beacons"] = table("beacon x_m y_m z_m sigma_x_m sigma_y_m sigma_z_m", places)

    def at(self, t: Array) -> Array:
        """True places (n, 3)."""
        return np.column_stack([np.interp(t, self.t, column) for column in self.p.T])

    def write(self, folder: Path, *spoils: Callable[[Tables], object]) -> str:
        """The folder with the tables, spoiled; as a name."""
        tables = {name: {key: np.array(column) for key, column in rows.items()} for name, rows in self.tables.items()}
        for spoil in spoils:
            spoil(tables)
        folder.mkdir(parents=True, exist_ok=True)
        for name, rows in tables.items():
            whole = ("valid", "beacon", "i")
            columns = [column.astype(int) if key in whole else column for key, column in rows.items()]
            (folder / f"{name}.csv").write_bytes(csv_text(list(rows), *columns))
        return str(folder)

    def error(self, values: nls.Values, report: nls.io.LoadReport) -> float:
        """Root mean square of the horizontal distances from the truth, m."""
        away = SE3.position(values[x])[:, :2] - self.at(report.vertex_times["x"])[:, :2]
        return float(np.sqrt(np.square(away).sum(axis=1).mean()))


def table(names: str, *columns: npt.ArrayLike) -> dict[str, Array]:
    """Columns (n,) by name, of arrays (n,) or (n, k)."""
    numbers = np.column_stack([np.asarray(column, dtype=float) for column in columns])
    return dict(zip(names.split(), numbers.T, strict=True))
