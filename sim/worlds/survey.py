"""The survey: a vehicle mows the sea floor between two fixes at the surface, and its sensors write a raw log."""

from __future__ import annotations

from math import radians

import numpy as np

from models.errors import OptionError
from models.geodesy import LocalPlane
from models.options import check_positive, is_number
from sim.checks import check_fraction, check_not_negative, check_rng, check_size
from sim.survey_log import SurveyLog, Tables
from sim.survey_sensors import USBL_PERIOD, Errors, Sensors
from sim.survey_sonar import sonar_tables
from sim.survey_track import TrueTrack, sounded
from sim.world import seed_of

__all__ = ["survey"]

ORIGIN = LocalPlane(54.1, 10.2)
AROUND = 50.0  # m from the legs to the beacons and to the ship
LOUDEST = 1e5  # factor on the noise: GPS fixes with more would leave the local plane of 1,000 km
SHALLOWEST, DEEPEST = 5.0, 25.0  # m, of a survey over a bottom that is 31 to 45 m deep


def survey(
    rng: np.random.Generator,
    legs: int = 8,
    leg: float = 200.0,
    spacing: float = 30.0,
    depth: float = 20.0,
    speed: float = 1.5,
    drop_outs: float = 0.03,
    usbl_outliers: float = 0.0,
    landmarks: int = 0,
    dvl_scale: float = 0.01,
    dvl_yaw: float = radians(1.0),
    ahrs_clock: float = 0.3,
    sound_speed_error: float = 0.02,
    declination: float = 0.0,
    heading_drift: float = radians(0.01),
    noise_scale: float = 1.0,
) -> SurveyLog:
    """An underwater vehicle mows an area of some hundred meters for 28 minutes; its sensors write a raw log.

    The vehicle has GPS at the surface, dives, mows legs there and back, 2.5 m deeper on every other one, and surfaces
    for GPS. The DVL pings five times a second and loses the bottom in bursts; the AHRS gives the attitude ten times a
    second, the depth sensor four times. Every 4 s one of four beacons answers, every 5 s a ship at anchor measures
    range and direction of the vehicle by USBL. Scale and mounting of the DVL, the clock of the AHRS and the speed of
    sound are off. calibration.csv has them with a standard deviation, the truth apart their values.

    Parameters
    ----------
    rng : source of the small motions and of the noise.
    legs : at least 1.
    leg : length of a leg, m.
    spacing : from leg to leg, m, 10 or more.
    depth : of the survey, m, 5 to 25.
    speed : over the ground, m/s, 0.5 to 3.
    drop_outs : part of the pings of the DVL without bottom lock.
    usbl_outliers : part of the USBL fixes that is wrong: another bearing, and a range that is 80 to 160 m too long.
    landmarks : marks on the bottom; with them an imaging sonar looks ahead, and poses.csv numbers the poses of its
        contacts.
    dvl_scale : scale error of the DVL, a fraction.
    dvl_yaw : the DVL is turned by this on the vehicle, rad.
    ahrs_clock : the stamps of the AHRS are late by this, s, up to 0.9.
    sound_speed_error : the speed of sound is taken to be too high by this fraction.
    declination : of the compass, rad; calibration.csv says it where it is not 0.
    heading_drift : standard deviation of a slow error of the heading, over 5 minutes, rad; no file says it.
    noise_scale : factor on the drawn noise, at most 100,000; 0 gives exact measurements with the same weights.

    Returns
    -------
    SurveyLog

    Raises
    ------
    OptionError
        A size, part or error that is not possible.
    GraphError
        Landmarks, and none that is seen three times.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> log = sim.survey(np.random.default_rng(1), legs=2, leg=60)
    >>> log.duration, len(log.tables["dvl"]["time_s"]), sorted(log.tables)[:4]
    (402, 2011, ['ahrs', 'beacons', 'calibration', 'depth'])
    >>> {name: round(value, 4) for name, value in log.calibration.items()}
    {'dvl_scale': 0.01, 'dvl_yaw_rad': 0.0175, 'ahrs_clock_s': 0.3, 'sound_speed_scale': 0.02}
    """
    check_rng(rng)
    check_size("legs", legs, 1)
    check_size("landmarks", landmarks, 0)
    check_positive(leg=leg)
    check_fraction(drop_outs=drop_outs, usbl_outliers=usbl_outliers)
    check_not_negative(heading_drift=heading_drift)
    for option, value, least, most, unit in (
        ("spacing", spacing, 10.0, 1000.0, "m"),
        ("depth", depth, SHALLOWEST, DEEPEST, "m"),
        ("speed", speed, 0.5, 3.0, "m/s"),
        ("drop_outs", drop_outs, 0.0, 0.9, "a part"),
        ("dvl_scale", dvl_scale, -0.5, 0.5, "a fraction"),
        ("dvl_yaw", dvl_yaw, -radians(45), radians(45), "rad"),
        ("ahrs_clock", ahrs_clock, -0.9, 0.9, "s"),
        ("sound_speed_error", sound_speed_error, -0.2, 0.2, "a fraction"),
        ("declination", declination, -radians(45), radians(45), "rad"),
        ("noise_scale", noise_scale, 0.0, LOUDEST, "a factor"),
    ):
        if not (is_number(value) and least <= value <= most):
            raise OptionError(option, value, f"a number from {least:.4g} to {most:.4g}, {unit}")

    track = TrueTrack(rng, legs, leg, spacing, depth, speed)
    errors = Errors(dvl_scale, dvl_yaw, ahrs_clock, sound_speed_error, declination, heading_drift)
    sensors = Sensors(rng, track, errors, ORIGIN, noise_scale)
    (north, east), out = track.size, AROUND
    corners = np.array([[-out, -out], [north + out, -out], [north + out, east + out], [-out, east + out]])
    beacons = np.column_stack([corners, sounded(corners) - 2.0])  # 2 m above the bottom
    anchor = np.array([0.6 * north, -0.8 * out])
    tables: Tables = {
        "dvl": sensors.dvl(drop_outs),
        "ahrs": sensors.ahrs(),
        "depth": sensors.depth(),
        "fixes": sensors.fixes(),
        "ranges": sensors.ranges(beacons),
        "ship": sensors.ship(anchor),
        **sensors.constants(beacons),
    }
    tables["usbl"], wrong = sensors.usbl(anchor, usbl_outliers)  # last: wrong fixes leave the noise of all others
    points = np.zeros((0, 3))
    if landmarks:
        sighted, points = sonar_tables(rng, track, landmarks, noise_scale, tables)
        tables |= sighted
    description = (
        f"Survey: {legs} legs of {leg:g} m, {spacing:g} m apart, {depth:g} m deep, flown at {speed:g} m/s over the "
        f"ground. Wrong and to be estimated: DVL scale {dvl_scale:g} and mounting {np.degrees(dvl_yaw):.4g} deg, clock "
        f"of the AHRS {ahrs_clock:g} s, speed of sound {sound_speed_error:g}. DVL without bottom lock: {drop_outs:g} "
        f"of its pings. Wrong USBL fixes: {int(wrong.sum())} of {len(wrong)}, one each {USBL_PERIOD:g} s"
        f"{'' if noise_scale == 1 else f'. Noise drawn {noise_scale:g} times as large'}."
    )
    return SurveyLog(
        "survey", tables, track, beacons, points, errors.calibration, wrong, ORIGIN, seed_of(rng), description
    )
