r"""The sensors of a survey along a track, each with the noise and the errors that its table states.

    DVL       v_d = (1 + scale) R_bd' (v + w x a) + noise,   R_bd = Rz(yaw of the mounting)
    AHRS      roll, pitch, yaw - declination, + noise, stamped late by the error of its clock
    depth     z + noise
    GPS       x, y of the antenna + noise, at the surface
    LBL       t_1 - t_0 + noise:   |p(t_0) - b| + |p(t_1) - b| = c (t_1 - t_0 - turn-around),   c = 1500 / (1 + error)
    USBL      range, bearing and elevation of the vehicle in the axes of the ship, + noise

p is where the transducer or antenna is, b a beacon. A travel time stands for the middle between sending and receiving:
its delay is half of it. The USBL knows the speed of sound, and its transponder is at the center of the vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians

import numpy as np

from models import SE3, euler
from models.algebra import Array, Mask, wrap
from models.geodesy import LocalPlane
from models.sensors import dvl_velocity, spherical
from sim.survey_log import Tables
from sim.survey_track import TrueTrack, every, ship_pose, sounded, wandering

__all__ = ["Errors", "Sensors"]

DVL_PERIOD, AHRS_PERIOD, DEPTH_PERIOD, GPS_PERIOD = 0.2, 0.1, 0.25, 1.0  # s
LBL_PERIOD, USBL_PERIOD, SHIP_PERIOD = 4.0, 5.0, 0.5  # s
DVL_ARM = (0.4, 0.0, 0.15)  # m, on the vehicle
ANTENNA, TRANSDUCER = (-0.3, 0.0, -0.4), (-0.6, 0.0, -0.2)
SIGMA_V, SIGMA_BRIDGE = 0.02, 0.03  # m/s, m/s after a second
SIGMA_RPY = (radians(0.1), radians(0.1), radians(0.1))
SIGMA_Z, SIGMA_GPS = 0.02, 1.5  # m
SIGMA_TRAVEL_TIME = 2.5e-4  # s: 0.19 m of range
SIGMA_USBL = (0.5, radians(0.5), radians(0.5))
SIGMA_BEACON = 0.3  # m, along each axis
TURN_AROUND, SOUND_SPEED = 0.05, 1500.0  # s, m/s
BURST = 2.0  # s: how long a loss of bottom lock lasts, on average
BEFORE, DRIFT_KNOTS = 1.0, 300.0  # s: the AHRS runs before and after the others; time scale of its slow error
WRONG_RANGE = 80.0  # m: a wrong USBL fix is this far off, or more, up to twice
KERNEL = "cauchy:2.385"  # of usbl.csv, where some of it is wrong


@dataclass(frozen=True)
class Errors:
    """Errors of the sensors that no noise describes: those of calibration.csv, and a slow one of the heading, rad."""

    dvl_scale: float
    dvl_yaw: float
    ahrs_clock: float
    sound_speed: float
    declination: float
    heading_drift: float

    @property
    def calibration(self) -> dict[str, float]:
        """By the names of calibration.csv."""
        named = dict(zip(PRIORS, (self.dvl_scale, self.dvl_yaw, self.ahrs_clock, self.sound_speed), strict=True))
        return named | ({"declination_rad": self.declination} if self.declination else {})


PRIORS = {"dvl_scale": 0.02, "dvl_yaw_rad": 0.05, "ahrs_clock_s": 0.5, "sound_speed_scale": 0.03}  # sigmas


@dataclass(frozen=True)
class Sensors:
    """Draws what the sensors measure; noise_scale is a factor on the drawn noise, weights stay."""

    rng: np.random.Generator
    track: TrueTrack
    errors: Errors
    plane: LocalPlane
    noise_scale: float

    def noise(self, n: int, *sigmas: float) -> Array:
        """Draws (n, k) with these standard deviations."""
        return np.asarray(self.noise_scale * self.rng.standard_normal((n, len(sigmas))) * sigmas)

    def placed(self, t: Array, arm: tuple[float, ...]) -> Array:
        """Where (n, 3) a point of the vehicle is at times (n,), m."""
        return SE3.act(self.track.pose(t), np.array([arm]))

    def dvl(self, drop_outs: float) -> dict[str, Array]:
        """The rows of dvl.csv; `drop_outs` of them, in bursts, without bottom lock and with zeros."""
        t = every(DVL_PERIOD, 0.0, self.track.duration)
        mount = euler.to_se3([[0.0, 0.0, self.errors.dvl_yaw, *DVL_ARM]])
        v, _ = dvl_velocity(*self.track.velocity(t), mount)
        v = (1 + self.errors.dvl_scale) * v + self.noise(len(t), SIGMA_V, SIGMA_V, SIGMA_V)
        lost = self.lost(len(t), drop_outs)
        v[lost] = 0.0
        place = self.placed(t, DVL_ARM)
        altitude = np.round(sounded(place[:, :2]) - place[:, 2], 2)
        rows = {"time_s": t, **columns(("vx_m_s", "vy_m_s", "vz_m_s"), v), "valid": (~lost).astype(int)}
        return {**rows, "altitude_m": altitude}

    def lost(self, n: int, part: float) -> Mask:
        """Which of n pings are lost: bursts of a random length, so long and so often that they are this part."""
        leave = DVL_PERIOD / BURST
        enter = min(1.0, leave * part / (1 - part)) if part < 1 else 1.0
        u, lost = self.rng.random(n), np.zeros(n, dtype=bool)
        for k in range(1, n):  # the first ping has bottom lock
            lost[k] = u[k] >= leave if lost[k - 1] else u[k] < enter
        return lost

    def ahrs(self) -> dict[str, Array]:
        """The rows of ahrs.csv."""
        t = every(AHRS_PERIOD, -BEFORE, self.track.duration + BEFORE)
        rpy = self.track.attitude(t) + self.noise(len(t), *SIGMA_RPY)
        rpy[:, 2] += wandering(self.rng, t, self.noise_scale * self.errors.heading_drift, DRIFT_KNOTS)
        rpy[:, 2] = wrap(rpy[:, 2] - self.errors.declination)
        stamps = np.round(t + self.errors.ahrs_clock, 9)
        return {"time_s": stamps, **columns(("roll_rad", "pitch_rad", "yaw_rad"), rpy)}

    def depth(self) -> dict[str, Array]:
        """The rows of depth.csv."""
        t = every(DEPTH_PERIOD, 0.0, self.track.duration)
        return {"time_s": t, "z_m": self.track.position(t)[:, 2] + self.noise(len(t), SIGMA_Z)[:, 0]}

    def fixes(self) -> dict[str, Array]:
        """The rows of fixes.csv: GPS at the surface, before and after the dive."""
        t = every(GPS_PERIOD, 0.0, self.track.duration)
        t = t[self.track.surfaced(t)]
        xy = self.placed(t, ANTENNA)[:, :2] + self.noise(len(t), SIGMA_GPS, SIGMA_GPS)
        sigma = np.full(len(t), SIGMA_GPS)
        return {"time_s": t, **self.on_earth(xy), "sigma_x_m": sigma, "sigma_y_m": sigma, **armed(ANTENNA, len(t))}

    def ranges(self, beacons: Array) -> dict[str, Array]:
        """The rows of ranges.csv: the beacons (k, 3) in turn, round trips, stamped when the answer arrives."""
        sent = every(LBL_PERIOD, LBL_PERIOD / 2, self.track.duration - LBL_PERIOD)
        beacon = np.arange(len(sent)) % len(beacons)
        c = SOUND_SPEED / (1 + self.errors.sound_speed)
        there = np.linalg.norm(self.placed(sent, TRANSDUCER) - beacons[beacon], axis=1)
        received = sent + TURN_AROUND + 2 * there / c
        for _ in range(4):  # the vehicle moves by 1/1000 of the way of the sound: exact to rounding
            back = np.linalg.norm(self.placed(received, TRANSDUCER) - beacons[beacon], axis=1)
            received = sent + TURN_AROUND + (there + back) / c
        n, t = len(sent), np.round(received, 6)
        return {
            "time_s": t,
            "beacon": beacon + 1,
            "travel_time_s": received - sent + self.noise(n, SIGMA_TRAVEL_TIME)[:, 0],
            "sigma_travel_time_s": np.full(n, SIGMA_TRAVEL_TIME),
            "turn_around_s": np.full(n, TURN_AROUND),
            "delay_s": np.round((received - sent) / 2, 6),
            **armed(TRANSDUCER, n),
        }

    def usbl(self, anchor: Array, outliers: float) -> tuple[dict[str, Array], Mask]:
        """The rows of usbl.csv, of a ship at an anchor (2,), and which of them are wrong."""
        t = every(USBL_PERIOD, USBL_PERIOD / 2, self.track.duration - USBL_PERIOD)
        ship = euler.to_se3(ship_pose(t, anchor))
        h, _ = spherical(SE3.act(SE3.inverse(ship), self.track.position(t)))
        n = len(t)
        z = h + self.noise(n, *SIGMA_USBL)
        wrong = np.zeros(n, dtype=bool)
        wrong[self.rng.permutation(n)[: round(outliers * n)]] = True
        count = int(wrong.sum())
        z[wrong, 0] += WRONG_RANGE * self.rng.uniform(1.0, 2.0, count)
        z[wrong, 1] = self.rng.uniform(-np.pi, np.pi, count)
        z[:, 1] = wrap(z[:, 1])
        sigmas = np.tile(SIGMA_USBL, (n, 1))
        names = ("range_m", "bearing_rad", "elevation_rad")
        rows = {"time_s": t, **columns(names, z), **columns([f"sigma_{name}" for name in names], sigmas)}
        return rows | ({"kernel": np.full(n, KERNEL)} if count else {}), wrong

    def ship(self, anchor: Array) -> dict[str, Array]:
        """The rows of ship.csv."""
        t = every(SHIP_PERIOD, 0.0, self.track.duration)
        pose = ship_pose(t, anchor)
        return {
            "time_s": t,
            **self.on_earth(pose[:, 3:5]),
            "z_m": pose[:, 5],
            **columns(("roll_rad", "pitch_rad", "yaw_rad"), pose[:, :3]),
        }

    def on_earth(self, xy: Array) -> dict[str, Array]:
        """Columns of latitude and longitude of places (n, 2), to a tenth of a millimeter."""
        lat, lon = self.plane.geodetic(xy)
        return {"lat_deg": np.round(lat, 9), "lon_deg": np.round(lon, 9)}

    def constants(self, beacons: Array) -> Tables:
        """Files that the operator writes, with the beacons (k, 3) where they were surveyed to be."""
        surveyed = beacons + self.noise(len(beacons), *[SIGMA_BEACON] * 3)
        believed = {name: (0.0, sigma) for name, sigma in PRIORS.items()}
        if self.errors.declination:
            believed["declination_rad"] = (self.errors.declination, 0.0)
        sigmas = dict(zip(("sigma_roll_rad", "sigma_pitch_rad", "sigma_yaw_rad"), SIGMA_RPY, strict=True))
        noise = {"sigma_v_m_s": SIGMA_V, "scale": 0.0, "sigma_bridge_m_s_sqrt_s": SIGMA_BRIDGE, **sigmas}
        mount = dict(zip(("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad"), (*DVL_ARM, 0, 0, 0), strict=True))
        one = {"noise": {**noise, "sigma_z_m": SIGMA_Z}, "dvl_mount": mount}
        one["origin"] = {"lat_deg": self.plane.lat, "lon_deg": self.plane.lon}
        value, sigma = np.array(list(believed.values())).T
        return {
            **{file: {name: np.array([float(value)]) for name, value in row.items()} for file, row in one.items()},
            "beacons": {
                "beacon": np.arange(1, len(beacons) + 1),
                **self.on_earth(surveyed[:, :2]),
                "z_m": surveyed[:, 2],
                **{f"sigma_{axis}_m": np.full(len(beacons), SIGMA_BEACON) for axis in "xyz"},
            },
            "calibration": {"name": np.array(list(believed)), "value": value, "sigma": sigma},
        }


def columns(names: tuple[str, ...] | list[str], rows: Array) -> dict[str, Array]:
    """Columns (n,) by name of rows (n, k), to nine decimals."""
    return {name: np.round(column, 9) for name, column in zip(names, rows.T, strict=True)}


def armed(arm: tuple[float, ...], n: int) -> dict[str, Array]:
    """The columns of a lever arm."""
    return {f"arm_{axis}_m": np.full(n, value) for axis, value in zip("xyz", arm, strict=True)}
