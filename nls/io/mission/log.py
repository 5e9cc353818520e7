r"""A raw log (DVL, AHRS, depth) as the factors of a track: legs integrated from pose to pose, attitude and depth there.

A leg z with covariance Sigma (`models.dead_reckoning.integrate`) becomes levelled odometry at the measured tilt of its
first pose, X_i = (0, Ry(pitch_i) Rx(roll_i)):

    XYH = h(X_i, X_i o z),    Sigma_XYH = H_j Sigma H_j'

`ZPR` and `Heading` are the depth and the attitude interpolated at the poses. The yaw of a leg is the difference of the
headings at its ends, so dead reckoning follows the headings as measured. But `Heading` says all that was measured of
the yaw: as a measurement of its own that difference would count the same readings a second time (yaw then has a mean
NEES of 1.65, where 1 is right). So `XYH` gives no information about yaw, and x and y count as they are *given the
heading* of their leg, Sigma without the noise of the yaw:

    Omega = [[Sigma_xy^-1, 0], [0, 0]]

What is assumed: the error of the heading lasts through a leg, so it turns the leg as a whole, by the error that
`Heading` leaves to the yaw of its first pose. For one that changes within the leg, from sample to sample, x and y
across the track are known better than that: as far as the heading goes, the covariances are on the safe side.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors import XYH, ZPR, Diagonal, Heading, Isotropic, SqrtInformation
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
MOST = 10_000_000  # such poses: four months, or times that are no seconds
MAY_BE_0 = ("scale", "sigma_bridge_m_s_sqrt_s")
GIVEN = 1e-9  # rad: what is left of the noise of the heading in legs given the heading; 1 nm after a meter


def integrated(tables: dict[str, Table], report: MissionReport) -> tuple[Numbers, list[Factor]]:
    """Numbers of the poses, rising in time, and `XYH`, `ZPR` and `Heading` between and at them.

    Raises
    ------
    GraphFileError
        Times that do not rise, a pose before or after the log, a log that cannot be integrated.
    """
    dvl, ahrs, depth = (tables[name] for name in ("dvl", "ahrs", "depth"))
    t_v, t_a, t_z = (table.rising("time_s") for table in (dvl, ahrs, depth))
    valid = _bottom_lock(dvl)
    numbers, b = _poses(tables, {"dvl.csv": t_v, "ahrs.csv": t_a, "depth.csv": t_z}, t_v[valid], report)
    rpy = np.unwrap(ahrs.attitude(*ANGLES), axis=0)
    roll, pitch, yaw = (np.interp(b, t_a, angle) for angle in rpy.T)
    z = np.interp(b, t_z, depth.measured("z_m")[:, 0])

    noise = _one_row(tables["noise"])
    tables["noise"].positive(*(name for name in noise if name not in MAY_BE_0))
    for name, number in zip(MAY_BE_0, tables["noise"].measured(*MAY_BE_0)[0].tolist(), strict=True):
        if number < 0:
            raise tables["noise"].at(0, f"{name} is {number!r}; expected 0 or above")
    sigmas = np.array([noise[f"sigma_{name}"] for name in ANGLES])
    mount = SE3.identity()[0]
    if (table := tables.get("dvl_mount")) is not None:
        mounted = _one_row(table)
        table.measured(*ANGLES, *PLACE)
        mount = euler.to_se3([mounted[name] for name in (*ANGLES, *PLACE)])
    else:
        report.notes.append("there is no dvl_mount.csv: the DVL is taken to be at the center of the vehicle, aligned")
    try:
        legs = integrate(
            t_v,
            dvl.measured("vx_m_s", "vy_m_s", "vz_m_s", rows=valid),
            boundaries=b,
            attitude=euler.quaternion_from_angles(wrap(rpy)),
            t_w=t_a,
            sigma_v=noise["sigma_v_m_s"],
            sigma_attitude=[*sigmas[:2], GIVEN],
            valid=valid,
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
    Sigma = (H_j @ legs.Sigma @ H_j.mT)[:, :2, :2]
    W = np.zeros((len(xyh), 3, 3))
    try:
        W[:, :2, :2] = np.linalg.inv(np.linalg.cholesky((Sigma + Sigma.mT) / 2))
    except np.linalg.LinAlgError as error:
        raise tables["noise"].at(0, "with this, a leg has a direction without error beyond rounding") from error
    return np.sort(numbers), [
        XYH(x[numbers[:-1]], x[numbers[1:]], xyh, SqrtInformation(W)),
        ZPR(x[numbers], np.column_stack([z, pitch, wrap(roll)]), Diagonal([noise["sigma_z_m"], sigmas[1], sigmas[0]])),
        Heading(x[numbers], wrap(yaw), Isotropic(sigmas[2])),
    ]


def _bottom_lock(dvl: Table) -> npt.NDArray[np.bool_]:
    """Which rows (n,) of dvl.csv are valid."""
    valid = dvl.integers("valid")
    if (strange := ~np.isin(valid, (0, 1))).any():
        k = int(np.argmax(strange))
        raise dvl.at(k, f"valid is {valid[k]}; expected 1 where the DVL had bottom lock, else 0")
    if (count := int(valid.sum())) < 2:
        raise GraphFileError(f"{count} of {len(valid)} rows are valid; expected two or more with bottom lock", dvl.path)
    return np.asarray(valid == 1)


def _poses(
    tables: dict[str, Table], logs: dict[str, Array], locked: Array, report: MissionReport
) -> tuple[Numbers, Array]:
    """Numbers and times (n,) of the poses, rising in time: those of poses.csv, or one a second while all logs run.

    The log of the DVL runs from its first to its last time with bottom lock: nothing is extrapolated.
    """
    t_v = logs["dvl.csv"]
    late, early = float(locked[0] - t_v[0]), float(t_v[-1] - locked[-1])
    if late or early:
        logs = {"dvl.csv with bottom lock": locked} | {name: t for name, t in logs.items() if name != "dvl.csv"}
    begin, end = max(t[0] for t in logs.values()), min(t[-1] for t in logs.values())
    if (table := tables.get("poses")) is None:
        if (end - begin) / EVERY > MOST:
            raise GraphFileError(
                f"the logs last {end - begin:.6g} s, with a pose a second too many for a graph: {_ranges(logs)}; are "
                "these seconds? poses.csv says when there are poses",
                tables["dvl"].path,
            )
        b = begin + EVERY * np.arange(max(0, int((end - begin) / EVERY) + 2))
        b = b[b <= end]  # 12.46 + 68.0 is more than 80.46 by a rounding
        if len(b) < 2:
            raise GraphFileError(f"the logs have less than a second in common: {_ranges(logs)}", tables["dvl"].path)
        if late or early:
            report.notes.append(
                f"the DVL has no bottom lock in its first {late:.6g} s and its last {early:.6g} s: left out"
            )
        return np.arange(len(b)), b
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
