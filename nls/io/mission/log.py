r"""A raw log (DVL, AHRS, depth) as the factors of a track: legs integrated from pose to pose, attitude and depth there.

A leg z with covariance Sigma (`models.dead_reckoning.integrate`) becomes levelled odometry at the measured tilt of its
first pose, X_i = (0, Ry(pitch_i) Rx(roll_i)):

    XYH = h(X_i, X_i o z),    Sigma_XYH = H_j Sigma H_j'

`ZPR` and `Heading` are the depth and the attitude interpolated at the poses. The yaw of a leg is the difference of the
headings at its ends, so dead reckoning follows the headings as measured.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors import XYH, ZPR, Covariance, Diagonal, Heading, Isotropic
from factors.base import Factor
from factors.keys import kinds
from models import SE3, euler, wrap
from models.algebra import Array
from models.dead_reckoning import integrate
from models.errors import GraphError, GraphFileError, OptionError
from models.sensors import levelled
from nls.io.mission.columns import ANGLES, PLACE
from nls.io.mission.report import MissionReport
from nls.io.mission.table import Table

__all__ = ["integrated"]

Numbers = npt.NDArray[np.int64]
EVERY = 1.0  # s from pose to pose where poses.csv does not say when they are


def integrated(tables: dict[str, Table], report: MissionReport) -> tuple[Numbers, list[Factor]]:
    """Numbers of the poses, rising in time, and `XYH`, `ZPR` and `Heading` between and at them.

    Raises
    ------
    GraphFileError
        Times that do not rise, a pose before or after the log, a log that cannot be integrated.
    """
    dvl, ahrs, depth = (tables[name] for name in ("dvl", "ahrs", "depth"))
    t_v, t_a, t_z = (table.rising("time_s") for table in (dvl, ahrs, depth))
    numbers, b = _poses(tables, {"dvl.csv": t_v, "ahrs.csv": t_a, "depth.csv": t_z})
    rpy = np.unwrap(ahrs.floats(*ANGLES), axis=0)
    roll, pitch, yaw = (np.interp(b, t_a, angle) for angle in rpy.T)
    z = np.interp(b, t_z, depth.floats("z_m")[:, 0])

    valid = dvl.integers("valid")
    if (strange := ~np.isin(valid, (0, 1))).any():
        k = int(np.argmax(strange))
        raise dvl.at(k, f"valid is {valid[k]}; expected 1 where the DVL had bottom lock, else 0")
    noise = _one_row(tables["noise"])
    tables["noise"].positive(*(name for name in noise if name not in ("scale", "sigma_bridge_m_s_sqrt_s")))
    sigmas = np.array([noise[f"sigma_{name}"] for name in ANGLES])
    mount = SE3.identity()[0]
    if (table := tables.get("dvl_mount")) is not None:
        mounted = _one_row(table)
        mount = euler.to_se3([mounted[name] for name in (*ANGLES, *PLACE)])
    else:
        report.notes.append("there is no dvl_mount.csv: the DVL is taken to be at the center of the vehicle, aligned")
    try:
        legs = integrate(
            t_v,
            dvl.floats("vx_m_s", "vy_m_s", "vz_m_s"),
            boundaries=b,
            attitude=euler.quaternion_from_angles(wrap(rpy)),
            t_w=t_a,
            sigma_v=noise["sigma_v_m_s"],
            sigma_attitude=sigmas,
            valid=valid == 1,
            sigma_bridge=noise["sigma_bridge_m_s_sqrt_s"],
            scale=noise["scale"],
            mount=mount,
        )
    except (GraphError, OptionError) as error:
        raise GraphFileError(f"cannot be integrated: {error}", dvl.path) from error
    report.notes.append(f"dead reckoning: {legs}")
    report.vertex_times["x"] = b[np.argsort(numbers)]

    (x,) = kinds("x")
    zero = np.zeros(len(b))
    X = euler.to_se3(np.column_stack([roll, pitch, zero, zero, zero, zero]))[:-1]
    xyh, (_, H_j) = levelled(X, SE3.compose(X, legs.z))
    Sigma = H_j @ legs.Sigma @ H_j.mT
    return np.sort(numbers), [
        XYH(x[numbers[:-1]], x[numbers[1:]], xyh, Covariance((Sigma + Sigma.mT) / 2)),
        ZPR(x[numbers], np.column_stack([z, pitch, wrap(roll)]), Diagonal([noise["sigma_z_m"], sigmas[1], sigmas[0]])),
        Heading(x[numbers], wrap(yaw), Isotropic(sigmas[2])),
    ]


def _poses(tables: dict[str, Table], logs: dict[str, Array]) -> tuple[Numbers, Array]:
    """Numbers and times (n,) of the poses, rising in time: those of poses.csv, or one a second while all logs run."""
    begin, end = max(t[0] for t in logs.values()), min(t[-1] for t in logs.values())
    if (table := tables.get("poses")) is None:
        count = int(np.floor((end - begin) / EVERY)) + 1
        if count < 2:
            raise GraphFileError(f"the logs have less than a second in common: {_ranges(logs)}", tables["dvl"].path)
        return np.arange(count), begin + EVERY * np.arange(count)
    numbers, b = table.unique("i", "pose"), table.rising("time_s")
    if (out := (b < begin) | (b > end)).any():
        k = int(np.argmax(out))
        raise table.at(k, f"pose {numbers[k]} is at {float(b[k])!r} s, not within all logs: {_ranges(logs)}")
    if len(b) < 2:
        raise table.at(0, "one pose; a track has at least two")
    return numbers, b


def _ranges(logs: dict[str, Array]) -> str:
    return ", ".join(f"{name} {float(t[0])!r} to {float(t[-1])!r} s" for name, t in logs.items())


def _one_row(table: Table) -> dict[str, float]:
    """The numbers of a table of one row, by column."""
    if len(table) > 1:
        raise table.at(1, "a second row; expected one")
    return dict(zip(table.names, table.floats(*table.names)[0].tolist(), strict=True))
