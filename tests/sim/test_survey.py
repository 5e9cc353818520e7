"""The survey: its way, sensors with the noise that their tables state, the same log in the words of loggers."""

from __future__ import annotations

from math import radians

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

import sim
from models.errors import GraphError, OptionError
from sim.files import survey_files
from sim.survey_sensors import ANTENNA, DVL_ARM, TRANSDUCER
from sim.survey_track import TrueTrack
from tests.combinations import for_all

Array = npt.NDArray[np.float64]
same = np.testing.assert_allclose
WRONG = {"declination": radians(3.0), "heading_drift": 0.0}  # and the others by their defaults


def made(seed: int = 0, **options: object) -> sim.SurveyLog:
    return sim.survey(np.random.default_rng(seed), **{"legs": 3, "leg": 60.0, **options})  # type: ignore[arg-type]


def rotation(rpy: Array) -> Rotation:
    return Rotation.from_euler("ZYX", rpy[:, ::-1])


def at(track: TrueTrack, t: Array, arm: tuple[float, ...]) -> Array:
    return np.asarray(track.position(t) + rotation(track.attitude(t)).apply(arm))


def stacked(table: dict[str, Array], *names: str) -> Array:
    return np.column_stack([table[name] for name in names])


def residuals(log: sim.SurveyLog) -> dict[str, Array]:
    """Of each sensor at the truth, in standard deviations, from the definitions and by finite differences."""
    tables, track, true = log.tables, log.track, log.calibration
    noise = {name: float(column[0]) for name, column in tables["noise"].items()}
    out = {}

    dvl, h = tables["dvl"], 1e-4
    t = dvl["time_s"][dvl["valid"] == 1]
    v = (at(track, t + h, DVL_ARM) - at(track, t - h, DVL_ARM)) / (2 * h)  # of the DVL itself, over the ground
    v = Rotation.from_euler("z", true["dvl_yaw_rad"]).inv().apply(rotation(track.attitude(t)).inv().apply(v))
    e = stacked(dvl, "vx_m_s", "vy_m_s", "vz_m_s")[dvl["valid"] == 1] - (1 + true["dvl_scale"]) * v
    out["dvl"] = e / noise["sigma_v_m_s"]

    ahrs = tables["ahrs"]
    rpy = track.attitude(ahrs["time_s"] - true["ahrs_clock_s"])
    rpy[:, 2] -= true.get("declination_rad", 0.0)
    e = stacked(ahrs, "roll_rad", "pitch_rad", "yaw_rad") - rpy
    out["ahrs"] = (e + np.pi) % (2 * np.pi) - np.pi
    out["ahrs"] /= [noise[f"sigma_{angle}_rad"] for angle in ("roll", "pitch", "yaw")]

    depth = tables["depth"]
    out["depth"] = (depth["z_m"] - track.position(depth["time_s"])[:, 2]) / noise["sigma_z_m"]

    fixes = tables["fixes"]
    e = log.plane.local(fixes["lat_deg"], fixes["lon_deg"]) - at(track, fixes["time_s"], ANTENNA)[:, :2]
    out["fixes"] = e / stacked(fixes, "sigma_x_m", "sigma_y_m")

    ranges = tables["ranges"]
    middle = at(track, ranges["time_s"] - ranges["delay_s"], TRANSDUCER)  # one place for the whole round trip
    r = np.linalg.norm(middle - log.beacons[ranges["beacon"].astype(int) - 1], axis=1)
    c = 1500.0 / (1 + true["sound_speed_scale"])
    e = ranges["travel_time_s"] - ranges["turn_around_s"] - 2 * r / c
    out["ranges"] = e / ranges["sigma_travel_time_s"]

    usbl, ship = tables["usbl"], tables["ship"]
    t = usbl["time_s"]
    lat, lon, yaw, roll, pitch, z = (
        np.interp(t, ship["time_s"], ship[name])
        for name in ("lat_deg", "lon_deg", "yaw_rad", "roll_rad", "pitch_rad", "z_m")
    )
    p = track.position(t) - np.column_stack([log.plane.local(lat, lon), z])
    x, y, down = rotation(np.column_stack([roll, pitch, yaw])).inv().apply(p).T
    r = np.sqrt(x * x + y * y + down * down)
    h_usbl = np.column_stack([r, np.arctan2(y, x), np.arctan2(down, np.hypot(x, y))])
    names = ("range_m", "bearing_rad", "elevation_rad")
    e = stacked(usbl, *names) - h_usbl
    e[:, 1] = (e[:, 1] + np.pi) % (2 * np.pi) - np.pi
    out["usbl"] = (e / stacked(usbl, *(f"sigma_{name}" for name in names)))[~log.wrong]

    if "contacts" in tables:
        contacts, sonar = tables["contacts"], tables["sonar"]
        t = tables["poses"]["time_s"][contacts["i"]]
        arm = tuple(float(sonar[name][0]) for name in ("x_m", "y_m", "z_m"))
        to_world = rotation(track.attitude(t)) * Rotation.from_euler("y", float(sonar["pitch_rad"][0]))
        x, y, down = to_world.inv().apply(log.landmarks[contacts["landmark"]] - at(track, t, arm)).T
        assert np.abs(np.arctan2(down, np.hypot(x, y))).max() < sonar["aperture_rad"][0] / 2
        h_sonar = np.column_stack([np.sqrt(x * x + y * y + down * down), np.arctan2(y, x)])
        e = stacked(contacts, "range_m", "azimuth_rad") - h_sonar
        out["contacts"] = e / stacked(contacts, "sigma_range_m", "sigma_azimuth_rad")

    beacons = tables["beacons"]
    place = np.column_stack([log.plane.local(beacons["lat_deg"], beacons["lon_deg"]), beacons["z_m"]])
    out["beacons"] = (place - log.beacons) / stacked(beacons, "sigma_x_m", "sigma_y_m", "sigma_z_m")
    return out


@pytest.mark.parametrize("seed", [1, 2])
def test_each_sensor_has_the_noise_its_table_states(seed: int) -> None:
    for name, e in residuals(made(seed, legs=4, leg=150.0, usbl_outliers=0.1, landmarks=80, **WRONG)).items():
        assert abs(np.sum(e**2) - e.size) < 3.5 * np.sqrt(2 * e.size), name


def test_without_noise_each_sensor_measures_the_truth() -> None:
    """To the rounding of the files; of the travel times to the one place that stands for two."""
    for name, e in residuals(made(3, noise_scale=0.0, drop_outs=0.2, landmarks=80, **WRONG)).items():
        assert np.abs(e).max() < (0.02 if name == "ranges" else 2e-4), name


def test_the_way_is_a_lawn_mower_between_two_dives() -> None:
    log = made(0, legs=4, leg=100.0, spacing=25.0)
    track, t = log.track, np.arange(0.0, log.duration, 0.5)
    x, y, z = track.position(t).T
    assert track.surfaced(t)[[0, -1]].all()
    same(z[track.surfaced(t)], 0.2, atol=1e-9)
    assert (y.min(), y.max()) == pytest.approx((0.0, 75.0), abs=0.01)
    for leg in range(4):
        on = (np.abs(y - 25.0 * leg) < 1e-3) & (x > 1) & (x < 99)
        same(z[on], 20.2 + 2.5 * (leg % 2), atol=1e-6)
        assert on.sum() > 98 / 1.5 * 2 * 0.9
    assert np.abs(np.diff(np.hypot(*np.diff([x, y], axis=1)) / 0.5)).max() < 0.1
    dvl = log.tables["dvl"]
    sounding = dvl["altitude_m"] + at(track, dvl["time_s"], DVL_ARM)[:, 2]
    assert 30 < sounding.min() < sounding.max() < 46
    course = np.unwrap(np.arctan2(np.diff(y), np.diff(x)))
    crab = track.attitude(t[:-1] + 0.25)[:, 2] - course
    assert np.abs(crab).max() < radians(9)
    assert 0.02 < np.abs(crab).mean()  # a current is there


def test_wrong_usbl_fixes_are_far_off_and_have_a_kernel() -> None:
    log = made(0, usbl_outliers=0.25)
    usbl, t = log.tables["usbl"], log.tables["usbl"]["time_s"]
    assert log.wrong.sum() == round(0.25 * len(t))
    anchor_free = made(0).tables["usbl"]
    assert "kernel" not in anchor_free
    assert set(usbl["kernel"]) == {"cauchy:2.385"}
    off = usbl["range_m"] - anchor_free["range_m"]
    assert (off[log.wrong] > 79).all()
    same(off[~log.wrong], 0.0, atol=1e-9)


def test_with_a_sonar_every_time_has_a_pose() -> None:
    log = made(0, landmarks=80)
    poses, contacts = log.tables["poses"]["time_s"], log.tables["contacts"]
    for name in ("fixes", "ranges", "usbl"):
        t = log.tables[name]["time_s"] - log.tables[name].get("delay_s", 0.0)
        assert np.abs(t[:, None] - poses).min(axis=1).max() < 1e-3
    assert np.diff(poses).min() > 1e-3
    assert (np.bincount(contacts["landmark"], minlength=len(log.landmarks)) >= 3).all()
    with pytest.raises(GraphError, match="none of 1 landmarks is seen 3 times"):
        made(0, depth=5.0, landmarks=1)  # too high above the bottom


def test_raw_is_the_same_log_in_the_units_of_loggers() -> None:
    log = made(5)
    files, _ = survey_files(log)

    def raw(name: str, *columns: str, separator: str = ",") -> list[list[str]]:
        head, *rows = files[f"raw/{name}.csv"].decode().splitlines()
        at = [head.split(separator).index(column) for column in columns]
        return [[row.split(separator)[k] for row in rows] for k in at]

    stamps, up = raw("dvl", "stamp_ns", "v_up_mm_s", separator=";")
    epoch = 1778572800 * 10**9
    same((np.array(stamps, dtype=np.int64) - epoch) * 1e-9, log.tables["dvl"]["time_s"], atol=1e-6)
    same(-1e-3 * np.array(up, dtype=float), log.tables["dvl"]["vz_m_s"], atol=1e-4)
    utc, heading = raw("ahrs", "utc", "heading_deg")
    late = np.array([stamp.rstrip("Z") for stamp in utc], dtype="datetime64[us]").astype(np.int64) * 1e-6
    same(late - 1778572800, log.tables["ahrs"]["time_s"], atol=1e-6)
    yaw = np.radians(np.array(heading, dtype=float)) - log.tables["ahrs"]["yaw_rad"]
    same(np.cos(yaw), 1.0, atol=1e-9)
    assert 0 <= min(map(float, heading)) < max(map(float, heading)) < 360
    (height,) = raw("depth", "height_m")
    same(-np.array(height, dtype=float), log.tables["depth"]["z_m"], atol=6e-4)


@for_all(sizes=[{"leg": 1.2e6}, {"legs": 10_000_000}, {"leg": 1.0, "legs": 200, "spacing": 1000.0, "speed": 0.5}])
def test_a_survey_of_more_than_two_days_is_refused(sizes: dict[str, float]) -> None:
    """Turns count as well: in the last one the legs are 200 m, the turns some 300 km."""
    leg = sizes.get("leg", 60.0)
    with pytest.raises(OptionError, match=rf"leg: {leg} is not possible; .* at most 48 h, not .* h, or fewer legs"):
        made(**sizes)
