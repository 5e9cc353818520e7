r"""A raw log (DVL, AHRS, depth) as the factors of a track: legs integrated from pose to pose, attitude and depth there.

A leg z with covariance Sigma (`models.dead_reckoning.integrate`) becomes levelled odometry at the measured tilt of its
first pose, X_i = (0, Ry(pitch_i) Rx(roll_i)):

    XYH = h(X_i, X_i o z),    Sigma_XYH = H_j Sigma H_j'

`ZPR` and `Heading` are the depth and the attitude interpolated at the poses. The yaw of a leg is the difference of the
headings at its ends, so dead reckoning follows the headings as measured. But `Heading` says all that was measured of
the yaw. As a measurement of its own that difference would count the same readings a second time. Yaw would then have a
mean NEES of 1.65, where 1 is right. So `XYH` gives no information about yaw. x and y count *given the heading* of their
leg, with Sigma without the noise of the yaw:

    Omega = [[Sigma_xy^-1, 0], [0, 0]]

What is assumed: the error of the heading lasts through a leg. So it turns the leg as a whole, by the error that
`Heading` leaves to the yaw of its first pose. For one that changes within the leg, from sample to sample, x and y
across the track are known better than that. As far as the heading goes, the covariances are on the safe side.

Poses may be denser than the rows of a sensor. Then the sigmas of their `Heading` and `ZPR` grow by the root of the
poses per row. So together they say what the rows say.

Holes in ahrs.csv and depth.csv: `nls.missions.folder.holes`. A pose in a hole of ahrs.csv has no `Heading`; the legs
to and from it say how the yaw went on, as a random walk from the even turn between the rows. All legs over a hole say
x and y given that turn:

    Omega = W'W,    W = L^-1 of (yaw, x, y), L L' = Sigma_XYH + diag(0, 0, 2 sigma_yaw^2)

with all its rows where a pose is in the hole, without the row of the yaw where `Heading` measures it at both ends. Its
tilt is that of the line, with the sigmas of the hole. In a hole of depth.csv the line is that of the depth less the way
down by the DVL. So the depth follows the DVL and meets the rows at both ends.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from factors import XYH, ZPR, Diagonal, DvlLeg, Shifted, SqrtInformation
from factors.base import Factor
from factors.keys import kinds
from models import SE3, euler, wrap
from models.algebra import Array, Index, Mask, Numbers, apply
from models.dead_reckoning import Legs, integrate
from models.errors import GraphError, GraphFileError, OptionError
from models.manifolds.euler import quaternion_from_angles
from models.sensors import levelled
from nls.missions.folder.attitude import BIAS, CLOCK, Attitude, attitude_of, gyro_biases, headings, turn_covariance
from nls.missions.folder.bottom_lock import bottom_lock
from nls.missions.folder.columns import ANGLES, GYRO, PLACE
from nls.missions.folder.depth import depths_of
from nls.missions.folder.holes import holes_of
from nls.missions.folder.report import MissionReport
from nls.missions.folder.rows import Assembly, noise_of, one_row
from nls.missions.folder.table import Table
from nls.missions.folder.timeline import poses_of_rows, united
from nls.missions.folder.velocity import Velocities, orientation, quarter, velocities

DVL = ("dvl_scale", "dvl_yaw_rad")
LATE = 0.5  # s that an attitude is moved to and fro to tell how a leg depends on its clock
EVERY = 1.0  # s from pose to pose where poses.csv does not say when they are
MOST = 10_000_000  # such poses: four months, or times that are no seconds
GIVEN = 1e-9  # rad: what is left of the noise of the heading in legs given the heading; 1 nm after a meter


def integrated(mission: Assembly) -> Numbers:
    """Numbers of the poses, rising in time; adds their steps, `ZPR` and what is known of the heading.

    Raises
    ------
    GraphFileError
        Times that do not rise, a pose before or after the log, a log that cannot be integrated; a hole in the attitude
        or depth that nothing tells how to bridge.
    """
    tables, report, calibrations = mission.tables, mission.report, mission.calibrations
    used = dict.fromkeys(GYRO, "gyro") if "gyro" in tables else {"sigma_yaw_rad": "ahrs"}
    noise, mount = noise_of(tables["noise"], used), _mount(tables, report)
    attitude = attitude_of(tables, calibrations)
    ahrs, gyro = attitude.ahrs, attitude.gyro
    depth, t_z, depths = depths_of(tables, report)
    dvl = tables["dvl"]
    velocity = velocities(mission, attitude, mount, noise)
    t_v, valid = velocity.t, velocity.valid
    if dvl.has("altitude_m"):
        bottom = bottom_lock(dvl, [])
        report.soundings = np.column_stack([t_v, dvl.measured("altitude_m", rows=bottom)])[bottom]
    logs = {"dvl.csv": t_v, **attitude.logs, f"{'depth' if 'depth' in tables else 'pressure'}.csv": t_z}
    numbers, b = _poses(mission, logs, t_v[valid])
    roll, pitch = (np.interp(b, attitude.t_a, angle) for angle in attitude.tilt.T)
    effect = "have no heading of their own, their pitch and roll" if gyro is None else "have a pitch and roll with"
    angles = attitude.rpy if gyro is None else attitude.tilt
    turning = holes_of(ahrs, attitude.t_a, angles, b, f"{effect} larger sigmas", report)
    if turning.inside.all():
        raise GraphFileError("no pose has an attitude measured at its time: all are in holes", ahrs.path)
    t_d, down = t_v[valid], _way_down(t_v[valid], velocity.v[valid], attitude, mount)
    off = depths - np.interp(t_z, t_d, down)[:, None]
    diving = holes_of(depth, t_z, off, b, "have the depth of the DVL, with a larger sigma", report)
    z = np.interp(b, t_z, depths[:, 0])
    z[diving.inside] = (np.interp(b, t_z, off[:, 0]) + np.interp(b, t_d, down))[diving.inside]

    def legs_of(v: Array, late: float = 0.0) -> Legs:
        """Legs by velocities (n, 3) and an attitude whose times are late by this, s."""
        return integrate(
            t_v,
            v,
            boundaries=b,
            attitude=quaternion_from_angles(wrap(attitude.at(attitude.t + late))),
            t_w=attitude.t,
            sigma_v=velocity.sigma,
            sigma_attitude=[noise["sigma_roll_rad"], noise["sigma_pitch_rad"], GIVEN],
            valid=valid,
            sigma_bridge=noise["sigma_bridge_m_s_sqrt_s"],
            sigma_turn=turning.density if gyro is None else 0.0,  # of the angles: of the body's axes at a small tilt
            scale=noise["scale"],
            mount=mount,
        )

    def level(v: Array, late: float = 0.0) -> Array:
        """Levelled steps (k, 3) by velocities and such an attitude."""
        X = _tilted(*attitude.at(b[:-1] + late)[:, :2].T)
        return levelled(X, SE3.compose(X, legs_of(v, late).z))[0]

    X = _tilted(roll[:-1], pitch[:-1])
    s, a = (calibrations.variable(name) for name in DVL)
    try:
        legs = legs_of(velocity.v)
        xyh, (_, H_j) = levelled(X, SE3.compose(X, legs.z))
        ways = None if s is None and a is None else _ways(level, velocity)
        turns = np.zeros_like(xyh)  # by the time that the attitude is late
        if gyro is None and calibrations.variable(CLOCK) is not None:
            turns[:, :2] = (level(velocity.v, LATE) - level(velocity.v, -LATE))[:, :2] / (2 * LATE)
    except (GraphError, OptionError) as error:
        raise GraphFileError(f"cannot be integrated: {error}", dvl.path) from error
    report.notes.append(f"dead reckoning: {legs}")
    report.vertex_times["x"] = b[np.argsort(numbers)]

    (x,) = kinds("x")
    Sigma = H_j @ legs.Sigma @ H_j.mT
    try:
        if gyro is None:
            W = _given_the_yaw(Sigma, noise["sigma_yaw_rad"], legs.unturned > 0, turning.inside)
        else:
            measured_turn = turn_covariance(attitude, b, xyh, noise[GYRO[0]], report)
            W = np.linalg.inv(np.linalg.cholesky(0.5 * (Sigma + Sigma.mT) + measured_turn))
    except np.linalg.LinAlgError as error:
        raise tables["noise"].at(0, "with this, a leg has a direction without error beyond rounding") from error
    i, j, how = x[numbers[:-1]], x[numbers[1:]], SqrtInformation(W)
    at = (calibrations.value(DVL[0]), calibrations.value(DVL[1]))
    steps: Factor = XYH(i, j, xyh, how) if ways is None else DvlLeg(i, j, xyh, how, ways, s, a, at)
    tilts = np.hypot(
        [noise["sigma_z_m"], noise["sigma_pitch_rad"], noise["sigma_roll_rad"]],
        np.hstack([diving.sigma, turning.sigma[:, [1, 0]]]),
    )
    by_row = ~diving.inside
    tilts[by_row, 0] *= poses_of_rows(t_z, b[by_row])
    by_row = ~turning.inside
    alike = poses_of_rows(attitude.t_a, b[by_row])
    tilts[by_row, 1:] *= alike[:, None]
    zpr = ZPR(x[numbers], np.column_stack([z, pitch, wrap(roll)]), Diagonal(tilts))
    of_legs, of_poses = dvl.source(_latest(t_v, b[:-1])), depth.source(_latest(t_z, b))
    if gyro is not None:
        minute, known = gyro_biases(b, noise, calibrations)
        mission.add(Shifted(steps, np.diff(b)[:, None, None] * [[0.0], [0.0], [1.0]], BIAS[minute]), of_legs)
        mission.add(zpr, of_poses)
        for factor in known:
            mission.add(factor, tables["noise"].source(np.zeros(len(factor), dtype=np.intp)))
        return np.sort(numbers)
    tilting = np.column_stack([np.zeros(len(b)), attitude.rates(b)[:, [1, 0]]])
    mission.add(calibrations.shifted(steps, CLOCK, -turns), of_legs)
    mission.add(calibrations.shifted(zpr, CLOCK, -tilting), of_poses)
    heading = headings(attitude, x[numbers[by_row]], b[by_row], noise["sigma_yaw_rad"] * alike, calibrations)
    mission.add(heading, ahrs.source(_latest(attitude.t_a, b[by_row])))
    return np.sort(numbers)


def _tilted(roll: Array, pitch: Array) -> Array:
    """Poses (n, 7) at the origin with a roll and a pitch (n,)."""
    zero = np.zeros(len(roll))
    return np.asarray(euler.to_se3(np.column_stack([roll, pitch, zero, zero, zero, zero])))


def _mount(tables: dict[str, Table], report: MissionReport) -> Array:
    """The pose (7,) of the DVL on the vehicle."""
    if (table := tables.get("dvl_mount")) is None:
        report.notes.append("there is no dvl_mount.csv: the DVL is taken to be at the center of the vehicle, aligned")
        return np.asarray(SE3.identity()[0])
    mounted = one_row(table)
    table.measured(*ANGLES, *PLACE)
    return np.asarray(euler.to_se3([mounted[name] for name in (*ANGLES, *PLACE)]))


def _ways(xyh_of: Callable[[Array], Array], velocity: Velocities) -> Array:
    """The parts (k, 3, 2) of the legs that `DvlLeg` needs: a leg is linear in the velocities."""
    level = velocity.v * [1, 1, 0]
    swing, p, q, both = (xyh_of(v)[:, :2] for v in (0 * level, level, quarter(level), velocity.v))
    return np.stack([p - swing, q - swing, both - p], axis=1)


def _latest(t: Array, b: Array) -> Index:
    """The latest rows, of rising times t, until the times b."""
    return t.searchsorted(b, side="right") - 1


def _way_down(t: Array, v_d: Array, attitude: Attitude, mount: Array) -> Array:
    """How far down (n,) the velocities v_d (n, 3) of a DVL lead, m; what its lever arm adds in a tilt is left out."""
    v = apply(orientation(t, attitude, mount), v_d)[:, 2]
    return np.append(0.0, np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t)))


def _given_the_yaw(Sigma: Array, sigma_yaw: float, bridged: Mask, inside: Mask) -> Array:
    """Square root information (k, 3, 3) of steps that know x and y given the yaw, and the yaw where nothing else does.

    Parameters
    ----------
    Sigma : (k, 3, 3) covariance of x, y and yaw, without the noise of the heading.
    bridged : (k,) steps over a hole in the attitude; the turn of others is as measured.
    inside : (k + 1,) poses in a hole.

    Raises
    ------
    LinAlgError
        A step with a direction without error.
    """
    yaw_x_y, x_y_yaw = [2, 0, 1], [1, 2, 0]
    C = 0.5 * (Sigma + Sigma.mT)
    C[~bridged, 2, :2] = C[~bridged, :2, 2] = 0.0
    C[:, 2, 2] += 2 * sigma_yaw**2  # of a row before and one after
    W = np.linalg.inv(np.linalg.cholesky(C[:, yaw_x_y][:, :, yaw_x_y]))
    W[~(inside[:-1] | inside[1:]), 0] = 0.0
    return np.asarray(W[:, x_y_yaw][:, :, x_y_yaw])


def _poses(mission: Assembly, logs: dict[str, Array], locked: Array) -> tuple[Numbers, Array]:
    """Numbers and times (n,) of the poses, rising in time: those of poses.csv, or one a second while all logs run and
    one at each of the times of other files.

    The log of the DVL runs from its first to its last time with bottom lock: nothing is extrapolated.
    """
    tables, t_v = mission.tables, logs["dvl.csv"]
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
            note = f"the DVL has no bottom lock in its first {late:.6g} s and its last {early:.6g} s: left out"
            mission.report.notes.append(note)
        b = united(b, end, mission.times, tables)
        return np.arange(len(b)), b
    numbers, b = table.unique("i", "pose"), table.rising("time_s")
    out = (b < begin) | (b > end)
    table.refuse_rows(out, lambda k: f"pose {numbers[k]} is at {float(b[k])!r} s, not within all logs: {_ranges(logs)}")
    if len(b) < 2:
        raise table.at(0, "one pose; a track has at least two")
    return numbers, b


def _ranges(logs: dict[str, Array]) -> str:
    return ", ".join(f"{name} {float(t[0])!r} to {float(t[-1])!r} s" for name, t in logs.items())
