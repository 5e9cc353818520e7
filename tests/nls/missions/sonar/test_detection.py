"""Detections: the stated rate of false alarms, echoes in their cells, walls on their line, and refusals."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import comb, radians
from typing import get_args

import numpy as np
import pytest

import sim
from models.errors import GraphError, OptionError
from models.sensors import DIDSON_HIGH, OCULUS_M750D, ImagingSonar
from nls.missions.sonar import detect
from nls.missions.sonar.detection import Detector, false_alarm_rate, multiplier
from tests.combinations import for_all

NEAR = replace(OCULUS_M750D, window=(0.5, 20.5))
DETECTORS = get_args(Detector)
TRAIN, GUARD = 20, 5


def rates(sonar: ImagingSonar, images: int, detector: str, false_alarms: float, nu: float | None = None) -> np.ndarray:
    """Share of noise cells detected in the middle, and in the first and last bins where the window is cut."""
    reach, counts = TRAIN + GUARD, np.zeros(2)
    for seed in range(images):
        speckle = "rayleigh" if nu is None else "k"
        image = sim.sonar_image(np.zeros((0, 3)), sonar, np.random.default_rng(seed), speckle=speckle, nu=nu)
        bin = sonar.bin(detect(image, sonar, detector, false_alarms, TRAIN, GUARD).range)
        cut = (bin < reach) | (bin >= sonar.bins - reach)
        counts += [(~cut).sum(), cut.sum()]
    return counts / (images * sonar.beams * np.array([sonar.bins - 2 * reach, 2 * reach]))


@for_all(detector=DETECTORS, false_alarms=[1e-2, 1e-3])
def test_the_rate_of_false_alarms_in_rayleigh_noise_is_the_stated_one(detector: str, false_alarms: float) -> None:
    """2.0 million cells, 102,000 of them with a cut window: 100 false alarms there at 1e-3."""
    middle, cut = rates(NEAR, 4, detector, false_alarms)
    assert middle == pytest.approx(false_alarms, rel=0.1)
    assert cut == pytest.approx(false_alarms, rel=0.2 if false_alarms > 1e-3 else 0.4)


def test_the_rate_in_spiky_noise_is_higher() -> None:
    """The more so the smaller the shape: a multiplier for Rayleigh noise is not one for K-distributed noise."""
    spiky, spikier = (rates(NEAR, 2, "soca", 1e-3, nu)[0] for nu in (4.0, 0.5))
    assert 2e-3 < spiky < spikier
    assert spikier > 2e-2


def test_multipliers_agree_with_the_sums_of_the_papers() -> None:
    """Smallest-of: the sum of Gandhi and Kassam. Both sides of one cell each, by hand: 2 / (2 + T) for the smaller."""
    for T in (0.05, 0.45, 2.0):
        series = 2 * sum(comb(19 + k, k) * (2 + T) ** -(20 + k) for k in range(20))
        assert false_alarm_rate("soca", 2, 20, T) == pytest.approx(series, rel=1e-12)
        both = false_alarm_rate("soca", 2, 20, T) + false_alarm_rate("goca", 2, 20, T)
        assert both == pytest.approx(2 * (1 + T) ** -20.0)  # min and max of the two sums are the two sums
        assert false_alarm_rate("soca", 2, 1, T) == pytest.approx(2 / (2 + T))
        assert false_alarm_rate("os", 2, 2, T) == pytest.approx(4 * 3 * 2 / (4 + T) / (3 + T) / (2 + T))
    for detector, sides, rate in product(DETECTORS, (1, 2), (0.5, 1e-3, 1e-12)):
        T = multiplier(detector, sides, 20, rate)
        assert false_alarm_rate(detector, sides, 20, T) == pytest.approx(rate, rel=1e-8)


@for_all(detector=DETECTORS, guard=[0, 2])
def test_windows_are_the_stated_cells(detector: str, guard: int) -> None:
    """Cell by cell, as the definition reads; a cut window is its other side."""
    sonar, train, rate = ImagingSonar("small", 3, 30, 1.0, 0.2, (1.0, 4.0)), 4, 0.3
    image = np.random.default_rng(4).rayleigh(1.0, (3, 30))
    expected = []
    for b, k in np.ndindex(3, 30):
        x = image[b] ** 2
        sides = [x[k - guard - train : k - guard], x[k + guard + 1 : k + guard + train + 1]]
        whole = [side for side, fits in zip(sides, (k >= guard + train, k + guard + train < 30), strict=True) if fits]
        T, sums = multiplier(detector, len(whole), train, rate), [side.sum() for side in whole]
        ordered = np.sort(np.concatenate(whole))
        Z = {"ca": sum(sums), "soca": min(sums), "goca": max(sums), "os": ordered[3 * len(ordered) // 4 - 1]}[detector]
        expected += [(b, k)] if x[k] > T * Z else []
    detections = detect(image, sonar, detector, rate, train, guard)
    beam, bin = sonar.beam(detections.azimuth), sonar.bin(detections.range)
    assert list(zip(beam.tolist(), bin.tolist(), strict=True)) == expected
    assert 15 < len(expected) < 40


@for_all(detector=DETECTORS, bin=[0, 24, 25, 300, 486, 487, 511], level=[1e-3, 1e3])
def test_an_echo_is_detected_in_its_cell(detector: str, bin: int, level: float) -> None:
    image = np.random.default_rng(1).rayleigh(level, (96, 512))
    image[70, bin] = 30 * level
    detections = detect(image, DIDSON_HIGH, detector, 1e-7)
    assert DIDSON_HIGH.beam(detections.azimuth).tolist() == [70]
    assert DIDSON_HIGH.bin(detections.range).tolist() == [bin]
    assert detections.azimuth[0] == pytest.approx((70.5 / 96 - 0.5) * radians(28.8))  # starboard
    assert detections.intensity.tolist() == [30 * level]
    np.testing.assert_allclose(detections.sigma, [[10 / 512 / 12**0.5, radians(0.3) / 12**0.5]])


def test_a_second_echo_in_the_window_masks_the_first_only_for_the_mean() -> None:
    image = np.random.default_rng(2).rayleigh(0.05, (96, 512))
    image[40, 200], image[40, 212] = 0.5, 2.0
    seen = [name for name in DETECTORS if 200 in DIDSON_HIGH.bin(detect(image, DIDSON_HIGH, name).range)]
    assert seen == ["soca", "os"]


def test_guard_cells_keep_an_echo_out_of_its_own_threshold() -> None:
    image = np.random.default_rng(3).rayleigh(0.05, (96, 512))
    image[40, 200:206] = 0.5
    bare, guarded = (detect(image, DIDSON_HIGH, "ca", 1e-6, guard=guard).azimuth for guard in (0, 5))
    assert np.sum(DIDSON_HIGH.beam(bare) == 40) < np.sum(DIDSON_HIGH.beam(guarded) == 40) == 6


def test_floor_and_thin() -> None:
    image = np.zeros((96, 512))
    image[10, [100, 101, 102, 400]] = [1.0, 3.0, 2.0, 0.5]
    assert detect(image, DIDSON_HIGH).intensity.tolist() == [1.0, 3.0, 2.0, 0.5]
    assert detect(image, DIDSON_HIGH, floor=1.0).intensity.tolist() == [1.0, 3.0, 2.0]
    assert detect(image, DIDSON_HIGH, thin=0.5).intensity.tolist() == [3.0, 0.5]
    assert len(detect(np.zeros((96, 512)), DIDSON_HIGH, thin=0.5)) == 0


def test_from_a_scene_to_points_on_its_wall() -> None:
    """A quay 8 m ahead, seen askew: points on its line within the cell and the spread of the echo."""
    scene = sim.Scene(walls=[[[8.0, -30.0], [8.0, 30.0]]], piles=[[4.0, -1.0, 0.3]])
    x, y, yaw = 1.0, 0.5, 0.3
    image = sim.sonar_image(scene, NEAR, np.random.default_rng(0), pose=[x, y, yaw], background=0.02)
    detections = detect(image, NEAR, "soca", 1e-6, guard=10, floor=0.2)
    ahead, starboard = detections.points.T
    north = x + ahead * np.cos(yaw) - starboard * np.sin(yaw)
    east = y + ahead * np.sin(yaw) + starboard * np.cos(yaw)
    on_pile = np.abs(np.hypot(north - 4, east + 1) - 0.3) < 0.2
    off = np.abs(north - 8)[~on_pile]
    cell = np.hypot(0.02, np.hypot(ahead, starboard) * NEAR.fan / NEAR.beams)[~on_pile]
    assert on_pile.sum() > 20
    assert len(off) > 500
    assert np.quantile(off / cell, 0.95) < 2.5
    assert np.median(off) < 0.03
    assert not on_pile[north > 4.3].any()
    behind = np.abs(np.arctan2(starboard, ahead) - (np.arctan2(-1.5, 3.0) - yaw)) < 0.05  # 5.4 deg to both sides
    assert on_pile[behind].all()


def test_mistakes_are_named() -> None:
    image = np.ones((96, 512))
    with pytest.raises(GraphError, match=r"shape \(512, 96\), DIDSON.*makes \(96, 512\): beams, bins"):
        detect(image.T, DIDSON_HIGH)
    for value in (np.nan, np.inf, -1.0):
        spoiled = image.copy()
        spoiled[3, 4:6] = value
        with pytest.raises(GraphError, match=r"image\[3, 4\] is .*, one of 2 such cells"):
            detect(spoiled, DIDSON_HIGH)
    for options, match in (
        ({"detector": "soka"}, "did you mean 'soca'"),
        ({"false_alarms": 0.0}, "false_alarms"),
        ({"false_alarms": 1.0}, "false_alarms"),
        ({"train": 0}, "train"),
        ({"guard": -1}, "guard"),
        ({"train": 250, "guard": 6}, r"window of 2 \(train \+ guard\) \+ 1 = 513 bins is longer than a beam of DIDSON"),
        ({"floor": np.nan}, "floor"),
        ({"thin": -1.0}, "thin"),
    ):
        with pytest.raises(OptionError, match=match):
            detect(image, DIDSON_HIGH, **options)
    assert len(detect(image, DIDSON_HIGH, train=250, guard=5)) == 0
