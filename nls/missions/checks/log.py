r"""A raw log as arrays, and what it says twice: the depth by the DVL, and the way from fix to fix.

    (d, D)(t) = sum of R(t) R_mount v_d(t) dt - (R(t) - R(0)) a

d north and east, D down, a and R_mount the mounting of the DVL on the vehicle, the trapezoidal rule from row to row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models import SO3, euler
from models.algebra import Array, Index, Mask, apply
from models.geodesy import LocalPlane
from models.manifolds.euler import quaternion_from_angles
from models.manifolds.so3 import rotation3
from nls.missions.checks.findings import Cause, Reading
from nls.missions.folder.bottom_lock import bottom_lock
from nls.missions.folder.calibration import Calibrations
from nls.missions.folder.columns import ANGLES, PLACE, VELOCITY
from nls.missions.folder.table import Table


@dataclass(frozen=True)
class Fixes:
    """Positions: times t (n,), p (n, 2) north and east, m, standard deviation (n,), m; and the columns of p.

    `rows` are those of the table; `others` places (n, 2), m, with latitude and longitude exchanged, or of another side.
    """

    t: Array
    p: Array
    sigma: Array
    columns: tuple[str, str]
    rows: Index
    others: tuple[tuple[Reading, Array], ...] = ()


@dataclass(frozen=True)
class Log:
    """The tables of a raw log as numbers, SI.

    Attributes
    ----------
    t_v, v, valid : times (n,), velocities (n, 3) along the axes of the DVL, and which rows have bottom lock.
    t_a, rpy : times (m,) and angles (m, 3) as in the file.
    t_z, z : times and depths (k,).
    mount : (7,) pose of the DVL on the vehicle, SE3.
    sigmas : of one velocity, angle and depth, by name of noise.csv.
    fixes : None where there are none.
    """

    t_v: Array
    v: Array
    valid: Mask
    t_a: Array
    rpy: Array
    t_z: Array
    z: Array
    mount: Array
    sigmas: dict[str, float]
    fixes: Fixes | None = None

    def thinned(self) -> Log:
        """Without lost samples and single outliers of DVL and depth, about a sample a second, at most 10,000."""
        t, v = self.t_v[self.valid], middle(self.v[self.valid])
        step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
        chosen = np.arange(0, len(t), max(1, int(1 / step)))[:10_000]
        return replace(self, t_v=t[chosen], v=v[chosen], valid=np.ones(len(chosen), dtype=bool), z=middle(self.z))

    def _attitude(self) -> Array:
        """Attitude (n, 4) at the times of the DVL."""
        rpy = np.column_stack([np.interp(self.t_v, self.t_a, angle) for angle in np.unwrap(self.rpy, axis=0).T])
        return quaternion_from_angles(rpy)

    def axes(self) -> Array:
        """Rotations (n, 3, 3) of the axes of the DVL into north, east and down."""
        q = self._attitude()
        return np.asarray(rotation3(SO3.compose(q, np.broadcast_to(self.mount[3:], q.shape))))

    def way(self) -> Array:
        """North, east and down (n, 3) by the DVL at each of its times, m, from the first."""
        q, w = self._attitude(), apply(self.axes(), self.v)
        steps = 0.5 * (w[1:] + w[:-1]) * np.diff(self.t_v)[:, None]
        arm = apply(rotation3(q), np.broadcast_to(self.mount[:3], (len(q), 3)))
        return np.asarray(np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]) - (arm - arm[0]))


def middle(y: Array) -> Array:
    """The middle one of each number and its two neighbors, along the first axis.

    Examples
    --------
    >>> middle(np.array([1.0, 2.0, 90.0, 4.0, 5.0])).tolist()
    [1.0, 2.0, 4.0, 5.0, 5.0]
    """
    out = np.array(y)
    if len(y) > 2:
        a, b, c = y[:-2], y[1:-1], y[2:]
        out[1:-1] = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
    return out


def read_log(tables: dict[str, Table], plane: LocalPlane | None) -> Log | None:
    """The raw log of a mission; None where it is too short, or has a number that the reader refuses.

    None also with gyro.csv and pressure.csv, whose mistakes are others.

    Raises
    ------
    GraphFileError
        A cell that is no number, a time that does not rise.
    """
    if {"gyro", "pressure"} & tables.keys() or not tables["ahrs"].has("yaw_rad"):
        return None
    dvl, ahrs, depth = (tables[name] for name in ("dvl", "ahrs", "depth"))
    t_v, t_a, t_z = (table.rising("time_s") for table in (dvl, ahrs, depth))
    valid, largest = bottom_lock(dvl, []), 1e9  # of a number, as the reader has it
    mount = tables["dvl_mount"].floats(*ANGLES, *PLACE)[0] if "dvl_mount" in tables else np.zeros(6)
    noise = tables["noise"]
    v, rpy, z = dvl.floats(*VELOCITY), ahrs.floats(*ANGLES), depth.floats("z_m")
    if min(len(t_v[valid]), len(t_a), len(t_z)) < 5:
        return None
    if not max(float(np.abs(y).max()) for y in (v[valid], rpy, z, mount)) < largest:
        return None
    v = np.where(valid[:, None] | (np.abs(v) < largest), v, 0.0)
    sigmas = dict(zip(noise.names, noise.floats(*noise.names)[0].tolist(), strict=True))
    fixes = read_fixes(tables.get("fixes"), plane)
    log = Log(t_v, v, valid, t_a, rpy, t_z, z[:, 0], euler.to_se3(mount), sigmas, fixes)
    if dvl.has("earth_axes"):
        earth = dvl.flags("earth_axes", "1 where the velocity is north, east and down")
        log = replace(log, v=np.where(earth[:, None], apply(log.axes().mT, log.v), log.v))
    return _calibrated(log, Calibrations(tables.get("calibration")))


def _calibrated(log: Log, calibrations: Calibrations) -> Log:
    """The log with the numbers of calibration.csv."""
    c = calibrations.value
    turn = c("dvl_yaw_rad")
    R = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    return replace(
        log,
        v=log.v @ R.T / (1 + c("dvl_scale")),
        t_a=log.t_a - c("ahrs_clock_s"),
        rpy=log.rpy + np.array([0.0, 0.0, c("declination_rad")]),
        fixes=log.fixes and replace(log.fixes, t=log.fixes.t - c("fixes_clock_s")),
    )


def read_fixes(table: Table | None, plane: LocalPlane | None) -> Fixes | None:
    """Positions with times; None without any, or where only the numbers of poses are given."""
    if table is None or not table.has("time_s"):
        return None
    sigma = np.hypot(*table.floats("sigma_x_m", "sigma_y_m").T)
    t = table.floats("time_s")[:, 0]
    order: Index = np.argsort(t, kind="stable")
    if table.has("x_m", "y_m"):
        return Fixes(t[order], table.floats("x_m", "y_m")[order], sigma[order], ("x_m", "y_m"), order)
    if not table.has("lat_deg", "lon_deg") or plane is None:
        return None
    lat, lon = table.floats("lat_deg", "lon_deg")[order].T
    others = (
        (Reading(Cause.SWAPPED, "fixes.csv", "lat_deg, lon_deg"), plane.local(lon, lat)),
        (Reading(Cause.SIGN, "fixes.csv", "lon_deg", -1.0), plane.local(lat, -lon)),
        (Reading(Cause.SIGN, "fixes.csv", "lat_deg", -1.0), plane.local(-lat, lon)),
    )
    return Fixes(t[order], plane.local(lat, lon), sigma[order], ("lat_deg", "lon_deg"), order, others)
