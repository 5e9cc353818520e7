r"""dvl.csv, with the attitude and depth of a raw log, as the factors of a track: legs integrated from pose to pose.

A row with `earth_axes` 1 has the velocity north, east and down. It is turned by the inverse of the attitude.
A row counts that is marked valid, has three beams or more on the bottom, and an altitude above 0. It must lie within a
gate of the median of five rows. All this as far as the file has these columns.

**Calibration.** The DVL reads (1 + s) Rz(a)' times the velocity along the axes of its mounting, so v = Rz(a) v_read /
(1 + s) with the stated s and a.

**Water.** Where there is no bottom but the DVL sees its way through the water, v = v_water + R' c with the current c,
the mean over the rows that have both, in world axes:

    c = mean d,    d = R (v_bottom - v_water),    sigma_row^2 = sigma_v^2 + N std(d)^2

The error of c is the same for all N rows of a loss of the bottom. Rows of a log count as independent. So each has N
times its variance, and the way over the whole of the loss is as well known as it is.

**Legs.** A leg z with covariance Sigma (`models.dead_reckoning.integrate`) becomes levelled odometry at the measured
tilt of its first pose, X_i = (0, Ry(pitch_i) Rx(roll_i)):

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

**Holes** in ahrs.csv and depth.csv: `nls.missions.folder.attitude`. A pose in a hole of ahrs.csv has no `Heading`; the
legs to and from it say how the yaw went on, as a random walk from the even turn between the rows. All legs over a hole
say x and y given that turn:

    Omega = W'W,    W = L^-1 of (yaw, x, y), L L' = Sigma_XYH + diag(0, 0, 2 sigma_yaw^2)

with all its rows where a pose is in the hole, without the row of the yaw where `Heading` measures it at both ends. Its
tilt is that of the line, with the sigmas of the hole. In a hole of depth.csv the line is that of the depth less the way
down by the DVL. So the depth follows the DVL and meets the rows at both ends.
"""

import numpy as np

from factors import XYH, ZPR, Diagonal, DvlLeg, Shifted, SqrtInformation
from factors.base import Factor
from factors.keys import kinds
from models import SE3, SO3, euler, wrap
from models.algebra import Array, Index, Mask, Numbers, apply
from models.dead_reckoning import Legs, integrate
from models.errors import GraphError, GraphFileError, OptionError
from models.manifolds.euler import quaternion_from_angles
from models.manifolds.so3 import rotation3
from models.sensors import levelled
from nls.missions.folder.attitude import (
    CLOCK,
    Attitude,
    attitude_of,
    depths_of,
    gyro_biases,
    headings,
    holes_of,
    turn_covariance,
)
from nls.missions.folder.columns import ANGLES, GYRO, PLACE, VELOCITY, WATER_TRACK
from nls.missions.folder.rows import Assembly, noise_of, one_row
from nls.missions.folder.table import Table
from nls.missions.folder.timeline import poses_of_log, poses_of_rows

SCALE, YAW = "dvl_scale", "dvl_yaw_rad"
GIVEN = 1e-9  # rad: what is left of the noise of the heading in legs given the heading; 1 nm after a meter


def bottom_lock(dvl: Table, notes: list[str]) -> Mask:
    """Which rows (n,) see the bottom, by all columns that say so; notes count those that a column rules out."""
    valid = np.ones(len(dvl), dtype=bool)
    if not (dvl.has("valid") or dvl.has("beams")):
        cure = "expected valid, 1 where the DVL had bottom lock, else 0, or beams, how many of its beams saw the bottom"
        raise GraphFileError(f"has no column 'valid' and none 'beams'; {cure}", dvl.path)
    if dvl.has("valid"):
        valid &= dvl.flags("valid", "1 where the DVL had bottom lock, else 0")
    if dvl.has("beams"):
        beams = dvl.integers("beams")
        outside = (beams < 0) | (beams > 16)  # no DVL has more
        dvl.refuse_rows(outside, lambda k: f"beams is {beams[k]}; expected how many see the bottom, 0 to 16")
        valid = _locked(dvl, valid, beams >= 3, "fewer than 3 beams on the bottom", notes)
    if dvl.has("altitude_m"):
        altitude = dvl.measured("altitude_m", rows=valid)[:, 0]
        valid = _locked(dvl, valid, altitude > 0, "an altitude that is not above 0", notes)
    return valid


def _locked(dvl: Table, valid: Mask, kept: Mask, reason: str, notes: list[str]) -> Mask:
    """The valid rows that are kept; a note counts the others."""
    if (left_out := valid & ~kept).any():
        many = int(left_out.sum())
        rows = "this row has" if many == 1 else f"{many} rows, this one the first, have"
        notes.append(f"{dvl.place(int(np.argmax(left_out)))}: {rows} {reason}: without bottom lock")
    return valid & kept


def velocities(
    mission: Assembly, attitude: Attitude, mount: Array, noise: dict[str, float], t: Array, bottom: Mask
) -> tuple[Array, Mask, Array]:
    """Velocities along the axes of the mounting of the DVL; notes say how many rows do not count, and why.

    Parameters
    ----------
    mission, attitude, mount, noise : of the log.
    t, bottom : (n,) times of the rows, s, and which of them see the bottom.

    Returns
    -------
    v : (n, 3) over the bottom, m/s, with the stated calibration; 0 where they do not count.
    valid : (n,) which count.
    sigma : (n,) standard deviations along each axis, m/s.

    Raises
    ------
    GraphFileError
        Fewer than two rows with bottom lock; numbers that cannot be.
    """
    dvl, notes, calibrations = mission.tables["dvl"], mission.report.notes, mission.calibrations
    valid, v = bottom, np.where(bottom[:, None], dvl.measured(*VELOCITY, rows=bottom), 0.0)
    if dvl.has("earth_axes"):
        earth = dvl.flags("earth_axes", "1 where the velocity is north, east and down")
        v = np.where(earth[:, None], apply(_orientation(t, attitude, mount).mT, v), v)
    if "gate_v_m_s" in noise:
        valid = _within_gate(dvl, v, valid, noise["gate_v_m_s"], notes)
    if (count := int(valid.sum())) < 2:
        raise GraphFileError(f"{count} of {len(valid)} rows are valid; expected two or more with bottom lock", dvl.path)
    sigma = np.full(len(t), noise["sigma_v_m_s"])
    if dvl.has("sigma_v_m_s"):
        sigma = np.where(valid, dvl.measured("sigma_v_m_s")[:, 0], sigma)
        dvl.refuse_numbers(~(sigma > 0), sigma, "a number above 0", "sigma_v_m_s")
    if dvl.has(*WATER_TRACK[:3]):
        v, valid, sigma = _through_water(dvl, v, valid, sigma, _orientation(t, attitude, mount), notes)
    return _turned(v, calibrations.value(YAW)) / (1 + calibrations.value(SCALE)), valid, sigma


def _orientation(t: Array, attitude: Attitude, mount: Array) -> Array:
    """Rotations (n, 3, 3) of the axes of the DVL's mounting into the world at times t (n,)."""
    q = quaternion_from_angles(attitude.at(t))
    return np.asarray(rotation3(SO3.compose(q, np.broadcast_to(mount[3:], q.shape))))


def _turned(v: Array, angle: float) -> Array:
    """Vectors (n, 3) turned about z, from x towards y."""
    return np.asarray(np.cos(angle) * v * [1, 1, 0] + np.sin(angle) * _quarter(v) + v * [0, 0, 1])


def _quarter(v: Array) -> Array:
    """Vectors (n, 3) turned by 90 degrees about z, without their z."""
    return np.column_stack([-v[:, 1], v[:, 0], 0 * v[:, 2]])


def _within_gate(dvl: Table, v: Array, valid: Mask, gate: float, notes: list[str]) -> Mask:
    """The valid rows (n,) that are within the gate of the median of five rows, itself in their middle, on each axis."""
    beside = np.pad(v[valid], ((2, 2), (0, 0)), mode="edge")
    median = np.median(np.lib.stride_tricks.sliding_window_view(beside, 5, axis=0), axis=-1)
    near = np.ones(len(v), dtype=bool)
    near[valid] = (np.abs(v[valid] - median) <= gate).all(axis=1)
    rest = f"{gate:g} m/s, from the median of 5 rows"
    return _locked(dvl, valid, near, f"a velocity further than gate_v_m_s, {rest}", notes)


def _through_water(
    dvl: Table, v: Array, valid: Mask, sigma: Array, R: Array, notes: list[str]
) -> tuple[Array, Mask, Array]:
    """Velocities, valid rows and sigmas (n,) with the way through the water where there is no bottom."""
    water = np.ones(len(v), dtype=bool)
    if dvl.has("water_valid"):
        water = dvl.flags("water_valid", "1 where the DVL saw its way through the water, else 0")
    through = np.where(water[:, None], dvl.measured(*WATER_TRACK[:3], rows=water), 0.0)
    both, alone = valid & water, water & ~valid
    if not alone.any():
        return v, valid, sigma
    rows = f"{dvl.place(int(np.argmax(alone)))}: {int(alone.sum())} rows without bottom lock have"
    if both.sum() < 2:
        reason = "fewer than two rows have both, so the current is not known"
        notes.append(f"{rows} a velocity through the water that is not used: {reason}")
        return v, valid, sigma
    d = apply(R[both], v[both] - through[both])
    current, spread = d.mean(axis=0), float(np.sqrt(d.var(axis=0, ddof=1).max()))
    v = np.where(alone[:, None], through + apply(R.mT, np.broadcast_to(current, through.shape)), v)
    run = np.cumsum(np.diff(alone.astype(int), prepend=0) == 1)
    length = np.bincount(run[alone], minlength=run[-1] + 1)
    sigma = np.where(alone, np.sqrt(sigma**2 + spread**2 * length[run]), sigma)
    north, east, down = current.tolist()
    rest = f"down {down:.3g} m/s, of the {int(both.sum())} rows with both (sigma of one {spread:.2g} m/s)"
    notes.append(f"{rows} the velocity through the water and the current, north {north:.3g}, east {east:.3g}, {rest}")
    return v, valid | alone, sigma


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
    noise, mount = noise_of(tables["noise"], used), _mount(tables, report.notes)
    attitude = attitude_of(tables, calibrations)
    ahrs, gyro, dvl = attitude.ahrs, attitude.gyro, tables["dvl"]
    depth, t_z, depths = depths_of(tables, report)
    t_v, bottom = dvl.rising("time_s"), bottom_lock(dvl, report.notes)
    v_dvl, valid, sigma_v = velocities(mission, attitude, mount, noise, t_v, bottom)
    if dvl.has("altitude_m"):
        report.soundings = np.column_stack([t_v, dvl.measured("altitude_m", rows=bottom)])[bottom]
    logs = {"dvl.csv": t_v, "ahrs.csv": attitude.t_a, **({} if gyro is None else {"gyro.csv": attitude.t})}
    logs[f"{'depth' if 'depth' in tables else 'pressure'}.csv"] = t_z
    numbers, b = poses_of_log(tables, mission.times, logs, t_v[valid], report.notes)
    roll, pitch = (np.interp(b, attitude.t_a, angle) for angle in attitude.tilt.T)
    effect = "have no heading of their own, their pitch and roll" if gyro is None else "have a pitch and roll with"
    angles = attitude.rpy if gyro is None else attitude.tilt
    turning = holes_of(ahrs, attitude.t_a, angles, b, f"{effect} larger sigmas", report.notes)
    if turning.inside.all():
        raise GraphFileError("no pose has an attitude measured at its time: all are in holes", ahrs.path)
    t_d, down = t_v[valid], _way_down(t_v[valid], v_dvl[valid], attitude, mount)
    off = depths - np.interp(t_z, t_d, down)[:, None]
    diving = holes_of(depth, t_z, off, b, "have the depth of the DVL, with a larger sigma", report.notes)
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
            sigma_v=np.repeat(sigma_v[:, None], 3, axis=1),
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

    s, a = (calibrations.variable(name) for name in (SCALE, YAW))
    X, ways = _tilted(roll[:-1], pitch[:-1]), None
    try:
        legs = legs_of(v_dvl)
        xyh, (_, H_j) = levelled(X, SE3.compose(X, legs.z))
        if s is not None or a is not None:  # the parts (k, 3, 2) that `DvlLeg` needs: a leg is linear in the velocities
            flat = v_dvl * [1, 1, 0]
            swing, p, q, both = (level(v)[:, :2] for v in (0 * flat, flat, _quarter(flat), v_dvl))
            ways = np.stack([p - swing, q - swing, both - p], axis=1)
        turns = np.zeros_like(xyh)  # by the time that the attitude is late: moved to and fro by half a second
        if gyro is None and calibrations.variable(CLOCK) is not None:
            turns[:, :2] = (level(v_dvl, 0.5) - level(v_dvl, -0.5))[:, :2]
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
            measured_turn = turn_covariance(attitude, b, xyh, noise[GYRO[0]], report.notes)
            W = np.linalg.inv(np.linalg.cholesky(0.5 * (Sigma + Sigma.mT) + measured_turn))
    except np.linalg.LinAlgError as error:
        raise tables["noise"].at(0, "with this, a leg has a direction without error beyond rounding") from error
    i, j, how = x[numbers[:-1]], x[numbers[1:]], SqrtInformation(W)
    at = (calibrations.value(SCALE), calibrations.value(YAW))
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
        biases, known = gyro_biases(b, noise, calibrations)
        mission.add(Shifted(steps, np.diff(b)[:, None, None] * [[0.0], [0.0], [1.0]], biases), of_legs)
        mission.add(zpr, of_poses)
        for factor in known:
            mission.add(factor, tables["noise"].source(np.zeros(len(factor), dtype=np.intp)))
        return np.sort(numbers)
    mission.add(calibrations.shifted(steps, CLOCK, -turns), of_legs)
    mission.add(calibrations.shifted(zpr, CLOCK, -attitude.tilting(b)), of_poses)
    heading = headings(attitude, x[numbers[by_row]], b[by_row], noise["sigma_yaw_rad"] * alike, calibrations)
    mission.add(heading, ahrs.source(_latest(attitude.t_a, b[by_row])))
    return np.sort(numbers)


def _tilted(roll: Array, pitch: Array) -> Array:
    """Poses (n, 7) at the origin with a roll and a pitch (n,)."""
    zero = np.zeros(len(roll))
    return np.asarray(euler.to_se3(np.column_stack([roll, pitch, zero, zero, zero, zero])))


def _mount(tables: dict[str, Table], notes: list[str]) -> Array:
    """The pose (7,) of the DVL on the vehicle."""
    if (table := tables.get("dvl_mount")) is None:
        notes.append("there is no dvl_mount.csv: the DVL is taken to be at the center of the vehicle, aligned")
        return np.asarray(SE3.identity()[0])
    one_row(table)
    return np.asarray(euler.to_se3(table.measured(*ANGLES, *PLACE)[0]))


def _latest(t: Array, b: Array) -> Index:
    """The latest rows, of rising times t, until the times b."""
    return t.searchsorted(b, side="right") - 1


def _way_down(t: Array, v_d: Array, attitude: Attitude, mount: Array) -> Array:
    """How far down (n,) the velocities v_d (n, 3) of a DVL lead, m; what its lever arm adds in a tilt is left out."""
    v = apply(_orientation(t, attitude, mount), v_d)[:, 2]
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
