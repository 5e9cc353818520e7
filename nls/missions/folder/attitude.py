r"""The attitude of a raw log: ahrs.csv with the heading of a compass, or with that of a gyro from gyro.csv.

**A compass.** A reading is the heading at its time less the declination D, at a clock that is late by c:

    z(t) = psi(t - c) - D,    Heading + G c - D,    G = -d psi / dt

`Heading` with `Shifted` of each of the two that is a variable; the clock shifts pitch, roll and the legs, too. The rate
is that of means over a second (or two rows) before and after a pose: the noise of single readings hardly counts.

**A gyro.** The yaw is the integral of the rate about the vertical, from 0 at its first row,

    d psi / dt = (w_y sin(roll) + w_z cos(roll)) / cos(pitch)

and is no measurement of the heading. The step from pose to pose has its turn, with the variance sigma_w^2 dt of white
noise. It has a bias b, the same for a minute, which then walks: `Shifted` by G = dt. A turn with an error that is new
at every time swings the way (x, y) of its leg, by half and a third of its variance:

    cov(yaw) = q,    cov((x, y), yaw) = q/2 (-y, x)',    cov((x, y)) = q/3 (-y, x)'(-y, x)
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from factors import Between, Diagonal, Heading, Isotropic, Prior, Shifted
from factors.base import Factor
from factors.keys import Keys, Kind
from models import wrap
from models.algebra import Array, Index
from models.dead_reckoning.drop_outs import bridged_variance, longest_step
from models.errors import GraphFileError
from nls.missions.folder.calibration import Calibrations
from nls.missions.folder.columns import ANGLES, GYRO
from nls.missions.folder.holes import holes_of
from nls.missions.folder.report import MissionReport
from nls.missions.folder.table import Table

__all__ = ["BIAS", "CLOCK", "Attitude", "attitude_of", "gyro_biases", "headings", "turn_covariance"]

SMOOTH = 1.0  # s before and after a pose, whose means say how fast the heading turns
MINUTE = 60.0  # s that a gyro has the same bias
BIAS = Kind("gyro_bias")
CLOCK = "ahrs_clock_s"


@dataclass(frozen=True)
class Attitude:
    """Roll, pitch and yaw as measured.

    Attributes
    ----------
    ahrs : the table of roll and pitch.
    t_a : (m,) its times, s, with the clock as believed.
    tilt : (m, 2) roll and pitch, rad.
    t : (k,) times of all three angles, s: those of the table, or of the gyro.
    rpy : (k, 3) angles at t, no turn missing, rad.
    gyro : the table of the gyro, where there is no compass.
    rate : (k,) d psi / dt at t by the gyro, rad/s.
    """

    ahrs: Table = field(repr=False)
    t_a: Array = field(repr=False)
    tilt: Array = field(repr=False)
    t: Array = field(repr=False)
    rpy: Array = field(repr=False)
    gyro: Table | None = None
    rate: Array | None = field(default=None, repr=False)

    @property
    def logs(self) -> dict[str, Array]:
        """The times of the logs by the names of their files."""
        return {"ahrs.csv": self.t_a} if self.gyro is None else {"ahrs.csv": self.t_a, "gyro.csv": self.t}

    def rates(self, b: Array) -> Array:
        """Rates (n, 3) of roll, pitch and yaw at times b (n,), rad/s."""
        return np.column_stack([_rate(self.t, angle, b) for angle in self.rpy.T])

    def at(self, t: Array) -> Array:
        """Roll, pitch and yaw (n, 3) at times t (n,); before the first and after the last row those of it."""
        return np.column_stack([np.interp(t, self.t, angle) for angle in self.rpy.T])


def attitude_of(tables: dict[str, Table], calibrations: Calibrations) -> Attitude:
    """The attitude of ahrs.csv, or of ahrs.csv without a yaw and gyro.csv; beside motion.csv what is not there is 0.

    Raises
    ------
    GraphFileError
        Both or neither say how the yaw goes; times that do not rise; angles that cannot be.
    """
    ahrs, gyro = tables["ahrs"], tables.get("gyro")
    t_a = ahrs.rising("time_s")
    if ahrs.has("yaw_rad") or "motion" in tables:
        if gyro is not None:
            raise GraphFileError(
                "gives the yaw, and ahrs.csv has a column yaw_rad; leave gyro.csv out, or that column", gyro.path
            )
        angles = [ahrs.attitude(name) if ahrs.has(name) else np.zeros((len(ahrs), 1)) for name in ANGLES]
        rpy, t_a = np.unwrap(np.hstack(angles), axis=0), t_a - calibrations.value(CLOCK)
        return Attitude(ahrs, t_a, rpy[:, :2], t_a, rpy)
    if gyro is None:
        raise GraphFileError(
            "has no column 'yaw_rad', and there is no gyro.csv; one of the two says how the yaw goes", ahrs.path
        )
    tilt = np.unwrap(ahrs.attitude(*ANGLES[:2]), axis=0)
    t, w = gyro.rising("time_s"), gyro.measured("wx_rad_s", "wy_rad_s", "wz_rad_s")
    roll, pitch = (np.interp(t, t_a, angle) for angle in tilt.T)
    rate = (w[:, 1] * np.sin(roll) + w[:, 2] * np.cos(roll)) / np.cos(pitch)
    yaw = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t)))
    return Attitude(ahrs, t_a, tilt, t, np.column_stack([roll, pitch, yaw]), gyro, rate)


def headings(attitude: Attitude, poses: Keys, b: Array, sigma: Array, calibrations: Calibrations) -> Factor:
    """Headings of poses at times b (n,) by the compass, with sigmas (n,), clock and declination."""
    yaw = np.interp(b, attitude.t, attitude.rpy[:, 2])
    declination = calibrations.variable("declination_rad")
    if declination is None:
        yaw = yaw + calibrations.value("declination_rad")
    heading = Heading(poses, wrap(yaw)[:, None], Isotropic(sigma))
    compass = calibrations.shifted(heading, CLOCK, -attitude.rates(b)[:, 2:])
    return compass if declination is None else Shifted(compass, [[-1.0]], declination)


def _rate(t: Array, y: Array, b: Array) -> Array:
    """Rates (n,) of y (m,) at times b: the mean after less the mean before, over half of the time of both."""
    total = np.append(0.0, np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t)))

    def integral(s: Array) -> Array:
        k = np.minimum(np.searchsorted(t, s, side="right") - 1, len(t) - 2)
        return np.asarray(total[k] + 0.5 * (y[k] + np.interp(s, t, y)) * (s - t[k]))

    reach = max(SMOOTH, longest_step(t))
    low, high = np.maximum(b - reach, t[0]), np.minimum(b + reach, t[-1])
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return np.asarray((integral(high) - 2 * integral(middle) + integral(low)) / half**2)


def turn_covariance(attitude: Attitude, b: Array, xyh: Array, sigma_w: float, report: MissionReport) -> Array:
    """Covariances (n - 1, 3, 3) of x, y and yaw of legs (n - 1, 3) by a gyro, whose error is new at every time."""
    q = _turn_variance(attitude, b, sigma_w, report)
    swing = np.column_stack([-xyh[:, 1], xyh[:, 0]])
    Sigma = np.empty((len(q), 3, 3))
    Sigma[:, :2, :2] = swing[:, :, None] * swing[:, None, :] / 3
    Sigma[:, :2, 2] = Sigma[:, 2, :2] = swing / 2
    Sigma[:, 2, 2] = 1.0
    return np.asarray(q[:, None, None] * Sigma)


def _turn_variance(attitude: Attitude, b: Array, sigma_w: float, report: MissionReport) -> Array:
    """Variances (n - 1,) of the turn between poses at times b (n,) by a gyro, rad^2; more over holes in its log."""
    q = sigma_w**2 * np.diff(b)
    assert attitude.gyro is not None
    assert attitude.rate is not None
    t, rate = attitude.t, attitude.rate[:, None]
    beta = holes_of(attitude.gyro, t, rate, b, "turn evenly from row to row, with a larger sigma", report).density[:, 0]
    for a in np.flatnonzero(beta):
        inside = np.clip(b, t[a], t[a + 1]) - t[a]
        q += beta[a] ** 2 * bridged_variance(inside[:-1], inside[1:], np.full(len(q), t[a + 1] - t[a]))
    return np.asarray(q)


def gyro_biases(b: Array, noise: dict[str, float], calibrations: Calibrations) -> tuple[Index, list[Factor]]:
    """The bias (n - 1,) of every leg between poses at times b (n,), by number, and what is known of the biases."""
    legs = ((b[:-1] - b[0]) / MINUTE).astype(int)
    numbers, minute = np.unique(legs, return_inverse=True)
    count = len(numbers)
    calibrations.add(BIAS, count, noise[GYRO[1]])
    known: list[Factor] = [Prior(BIAS[0], [0.0], Diagonal([noise[GYRO[1]]]))]
    if count > 1:
        walk = noise[GYRO[2]] * np.sqrt(MINUTE * np.diff(numbers))
        k = np.arange(count)
        known.append(Between(BIAS[k[:-1]], BIAS[k[1:]], np.zeros((count - 1, 1)), Isotropic(walk)))
    return minute, known
