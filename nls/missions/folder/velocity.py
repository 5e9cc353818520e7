r"""The velocities of dvl.csv: which rows count, how good each is, and what the track through the water adds.

A row with `earth_axes` 1 has the velocity north, east and down. It is turned by the inverse of the attitude.
A row counts that is marked valid, has three beams or more on the bottom, and an altitude above 0. It must lie within a
gate of the median of five rows. All this as far as the file has these columns.

**Calibration.** The DVL reads (1 + s) Rz(a)' times the velocity along the axes of its mounting, so v = Rz(a) v_read /
(1 + s) with s and a as they are believed to be.

**Water.** Where there is no bottom but the DVL sees its way through the water, v = v_water + R' c with the current c,
the mean over the rows that have both, in world axes:

    c = mean d,    d = R (v_bottom - v_water),    sigma_row^2 = sigma_v^2 + N std(d)^2

The error of c is the same for all N rows of a loss of the bottom. Rows of a log count as independent. So each has N
times its variance, and the way over the whole of the loss is as well known as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from models import SO3
from models.algebra import Array, Mask, apply
from models.errors import GraphFileError
from models.manifolds.euler import quaternion_from_angles
from models.manifolds.so3 import rotation3
from nls.missions.folder.attitude import Attitude
from nls.missions.folder.bottom_lock import bottom_lock, locked_rows
from nls.missions.folder.columns import VELOCITY
from nls.missions.folder.report import MissionReport
from nls.missions.folder.rows import Assembly
from nls.missions.folder.table import Table

__all__ = ["Velocities", "orientation", "quarter", "turned", "velocities"]

NEIGHBOURS = 5  # rows whose median a velocity is compared with, itself among them
WATER = ("water_vx_m_s", "water_vy_m_s", "water_vz_m_s")


@dataclass(frozen=True)
class Velocities:
    """Velocities along the axes of the mounting of the DVL.

    Attributes
    ----------
    t : (n,) times, s.
    v : (n, 3) over the bottom, m/s, with the calibration as believed; 0 where they do not count.
    valid : (n,) which count.
    sigma : (n, 3) standard deviations, m/s.
    """

    t: Array = field(repr=False)
    v: Array = field(repr=False)
    valid: Mask = field(repr=False)
    sigma: Array = field(repr=False)


def velocities(mission: Assembly, attitude: Attitude, mount: Array, noise: dict[str, float]) -> Velocities:
    """The velocities of dvl.csv; notes say how many rows do not count, and why.

    Raises
    ------
    GraphFileError
        No column that says where there is bottom lock; fewer than two rows with it; numbers that cannot be.
    """
    dvl, report, calibrations = mission.tables["dvl"], mission.report, mission.calibrations
    t, valid = dvl.rising("time_s"), bottom_lock(dvl, report.notes)
    v = np.where(valid[:, None], dvl.measured(*VELOCITY, rows=valid), 0.0)
    if dvl.has("earth_axes"):
        earth = dvl.flags("earth_axes", "1 where the velocity is north, east and down")
        v = np.where(earth[:, None], apply(orientation(t, attitude, mount).mT, v), v)
    if "gate_v_m_s" in noise:
        valid &= _within_gate(dvl, v, valid, noise["gate_v_m_s"], report)
    if (count := int(valid.sum())) < 2:
        raise GraphFileError(f"{count} of {len(valid)} rows are valid; expected two or more with bottom lock", dvl.path)
    sigma = np.full(len(t), noise["sigma_v_m_s"])
    if dvl.has("sigma_v_m_s"):
        sigma = np.where(valid, dvl.measured("sigma_v_m_s")[:, 0], sigma)
        dvl.refuse_rows(~(sigma > 0), lambda k: f"sigma_v_m_s is {float(sigma[k])!r}; expected a number above 0")
    if dvl.has(*WATER):
        v, valid, sigma = _through_water(dvl, v, valid, sigma, orientation(t, attitude, mount), report)
    v = turned(v, calibrations.value("dvl_yaw_rad")) / (1 + calibrations.value("dvl_scale"))
    return Velocities(t, v, valid, np.repeat(sigma[:, None], 3, axis=1))


def orientation(t: Array, attitude: Attitude, mount: Array) -> Array:
    """Rotations (n, 3, 3) of the axes of the DVL's mounting into the world at times t (n,)."""
    q = quaternion_from_angles(attitude.at(t))
    return np.asarray(rotation3(SO3.compose(q, np.broadcast_to(mount[3:], q.shape))))


def turned(v: Array, angle: float) -> Array:
    """Vectors (n, 3) turned about z, from x towards y."""
    return np.asarray(np.cos(angle) * v * [1, 1, 0] + np.sin(angle) * quarter(v) + v * [0, 0, 1])


def quarter(v: Array) -> Array:
    """Vectors (n, 3) turned by 90 degrees about z, without their z."""
    return np.column_stack([-v[:, 1], v[:, 0], 0 * v[:, 2]])


def _within_gate(dvl: Table, v: Array, valid: Mask, gate: float, report: MissionReport) -> Mask:
    """Which rows (n,) are within the gate of the median of their neighbours, along each axis."""
    beside = np.pad(v[valid], ((NEIGHBOURS // 2, NEIGHBOURS // 2), (0, 0)), mode="edge")
    median = np.median(np.lib.stride_tricks.sliding_window_view(beside, NEIGHBOURS, axis=0), axis=-1)
    near = np.ones(len(v), dtype=bool)
    near[valid] = (np.abs(v[valid] - median) <= gate).all(axis=1)
    reason = f"a velocity further than gate_v_m_s, {gate:g} m/s, from the median of {NEIGHBOURS} rows"
    return locked_rows(dvl, valid, near, reason, report.notes)


def _through_water(
    dvl: Table, v: Array, valid: Mask, sigma: Array, R: Array, report: MissionReport
) -> tuple[Array, Mask, Array]:
    """Velocities, valid rows and sigmas (n,) with the way through the water where there is no bottom."""
    water = np.ones(len(v), dtype=bool)
    if dvl.has("water_valid"):
        water = dvl.flags("water_valid", "1 where the DVL saw its way through the water, else 0")
    through = np.where(water[:, None], dvl.measured(*WATER, rows=water), 0.0)
    both, alone = valid & water, water & ~valid
    if not alone.any():
        return v, valid, sigma
    if both.sum() < 2:
        report.notes.append(
            f"{dvl.place(int(np.argmax(alone)))}: {int(alone.sum())} rows without bottom lock have a velocity through "
            "the water that is not used: fewer than two rows have both, so the current is not known"
        )
        return v, valid, sigma
    d = apply(R[both], v[both] - through[both])
    current, spread = d.mean(axis=0), float(np.sqrt(d.var(axis=0, ddof=1).max()))
    v = np.where(alone[:, None], through + apply(R.mT, np.broadcast_to(current, through.shape)), v)
    run = np.cumsum(np.diff(alone.astype(int), prepend=0) == 1)
    length = np.bincount(run[alone], minlength=run[-1] + 1)
    sigma = np.where(alone, np.sqrt(sigma**2 + spread**2 * length[run]), sigma)
    north, east, down = current.tolist()
    report.notes.append(
        f"{dvl.place(int(np.argmax(alone)))}: {int(alone.sum())} rows without bottom lock have the velocity through "
        f"the water and the current, north {north:.3g}, east {east:.3g}, down {down:.3g} m/s, of the "
        f"{int(both.sum())} rows with both (sigma of one {spread:.2g} m/s)"
    )
    return v, valid | alone, sigma
