"""Public logs: what their readers make of them or refuse, dead reckoning against their truth, and mappings."""

from __future__ import annotations

import gzip
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models import SE3
from tests.combinations import for_all
from tests.nls.io.g2o_files import assert_refused, cases

SCRIPT = "real_logs"


def test_auv_at_sea(data: Path, evidence: Any) -> None:
    """400 s and 670 to 890 m: below 1 % of the distance, with the true attitude and with a simulated sensor."""
    log = evidence.read_auv_dvl(data / "underwater-auv-dvl", 3)
    true, sensor = evidence.auv_dvl(log, "true"), evidence.auv_dvl(log, "sensor", 3)
    assert 650 < true.distance < 900
    assert 0.2 < true.drift < 0.95
    assert 1.5 < true.ate < 4.0
    assert sensor.drift < 1.1
    assert sensor.ate != true.ate


def test_holoocean(data: Path, evidence: Any) -> None:
    """Exact with the true attitude; by the gyro the heading goes; heights hold the depth."""
    log = evidence.read_holoocean(data / "underwater-holoocean" / "underwater_data.txt.gz")
    exact, gyro, graph = evidence.holoocean(log)
    assert exact.drift < 0.05
    assert exact.ate < 0.015
    assert 10 < gyro.drift < 25
    assert gyro.height > 0.8
    assert graph.height < 0.03
    assert graph.ate < 0.9 * gyro.ate


def test_holoocean_legs_obey_the_noise_of_the_dvl(data: Path, evidence: Any) -> None:
    """With the true attitude the rest is DVL noise: NEES of the positions inside 95 %, and only with the mounting."""
    log = evidence.read_holoocean(data / "underwater-holoocean" / "underwater_data.txt.gz")
    k = np.arange(0, len(log.t), 100)
    legs = evidence.holoocean_legs(log, k, True)
    e = SE3.local(legs.z, SE3.between(log.X[k[:-1]], log.X[k[1:]]))[:, :3]
    nees = np.einsum("ki,kij,kj->k", e, np.linalg.inv(legs.Sigma[:, :3, :3]), e)
    assert len(nees) == 36
    assert abs(nees.mean() - 3) < 1.96 * np.sqrt(2 * 3 / len(nees))


def test_caves(data: Path, evidence: Any) -> None:
    """A sixth of the time without bottom lock, said; the distances of the published track, and of the tape, are kept.

    The heading is the course of that track, so nothing is claimed about the heading.
    """
    log = evidence.read_caves(data / "underwater-caves")
    track, legs = evidence.caves(log)
    assert (len(log.t), int(log.valid.sum()), log.t_track[0]) == (5564, 5082, 0.0)
    gaps = np.diff(log.t[log.valid])
    lost = np.diff(np.flatnonzero(log.valid)) > 1
    inside = gaps[lost].sum()
    assert legs.bridged.sum() == pytest.approx(inside, abs=10)  # less what lies before and behind the published track
    assert 320 < legs.bridged.sum() < 340
    reckoned = np.linalg.norm(np.diff(track.X[:, :2], axis=0), axis=1).sum()
    assert reckoned == pytest.approx(track.distance, rel=0.05)
    assert track.drift < 2
    assert track.ate < 4
    for a, b, tape, found, published, _ in evidence.cones(log):
        assert abs(found - published) < 2.0, (a, b)
        assert abs(found - tape) < 3.2, (a, b)


def test_every_log_has_its_mapping_and_its_origin(script: Callable[[str], Any]) -> None:
    evidence = script("public_logs")
    text = (evidence.FOLDER / "logs.toml").read_text(encoding="utf-8")
    logs = [evidence.Log(**entry) for entry in tomllib.loads(text)["log"]]
    assert len({log.repository for log in logs}) >= 10
    mappings = {path.stem for path in evidence.FOLDER.glob("*.toml")} - {"logs"}
    assert mappings == {log.name for log in logs}
    for log in logs:
        clone, *shows = log.commands()
        assert log.repository in clone
        assert len(log.commit) == 40
        assert all(log.commit in show for show in shows)


MRCLAM = {
    "Robot7_Odometry.dat": "# time v w\n100.5 0.1 0.2\n100.6 0.3 0.4\n\n100.6 0.5 0.6\n",
    "Robot7_Measurement.dat": "# time barcode range bearing\n100.7 63 2.5 -0.25\n100.7 5 3.5 0.5\n100.8 99 4.5 1.0\n",
    "Robot7_Groundtruth.dat": "100 1 2 3.0\n102 3 4 -3.0\n",
    "Barcodes.dat": "# subject barcode\n1 5\n6 63\n7 81\n",
    "Landmark_Groundtruth.dat": "# subject x y sigmas\n6 0.5 -4.25 1e-4 1e-4\n7 0.75 -4.5 1e-4 1e-4\n",
}
PARK = {
    "DRS.txt": "1.0 0.5 0.01\n1.025 0.6 0.02\n",
    "GPS.txt": "0 1 2\n1.2 3 4\n",
    "LASER_TREE.txt": "0.85 20.5 -0.5 12.5 0.25\n1.06\n1.28 7.5 1.0\n",
}


def written(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder


def test_an_mrclam_log(tmp_path: Path, script: Callable[[str], Any]) -> None:
    log = script("logs").read_mrclam(written(tmp_path, MRCLAM), 7)
    np.testing.assert_allclose(log.t, [0.5, 0.6])
    np.testing.assert_array_equal(log.u, [[0.1, 0.2], [0.5, 0.6]])  # of two rows at one time the last
    np.testing.assert_allclose(log.t_seen, [0.7, 0.7, 0.8])
    np.testing.assert_array_equal(log.subject, [6, 1, 0])
    np.testing.assert_array_equal(log.z, [[-0.25, 2.5], [0.5, 3.5], [1.0, 4.5]])
    np.testing.assert_array_equal(log.landmarks, [6, 7])
    np.testing.assert_array_equal(log.places, [[0.5, -4.25], [0.75, -4.5]])
    np.testing.assert_allclose(log.true_poses(np.array([0.5, 1.0])), [[1.5, 2.5, 3 + (np.pi - 3) / 2], [2, 3, -np.pi]])


def test_a_victoria_park_log(tmp_path: Path, script: Callable[[str], Any]) -> None:
    folder = written(tmp_path, PARK)
    scans = folder / "LASER_TREE.txt"
    (folder / "LASER_TREE.txt.gz").write_bytes(gzip.compress(scans.read_bytes()))
    scans.unlink()
    log = script("logs").read_victoria_park(folder)
    np.testing.assert_array_equal(log.u, [[0.5, 0.01], [0.6, 0.02]])
    np.testing.assert_array_equal(log.t_scan, [0.85, 1.06, 1.28])
    np.testing.assert_array_equal(log.scan, [0, 0, 2])
    np.testing.assert_array_equal(log.z, [[-0.5, 20.5], [0.25, 12.5], [1.0, 7.5]])
    np.testing.assert_array_equal(log.gps, [[2, 1], [4, 3]])  # east and north


MISTAKES = cases("""
Robot7_Odometry.dat | # only\\n | 1 | has no row; expected lines of 3 numbers: time
Robot7_Odometry.dat | 1 2 3\\n1 2\\n | 2 | 2 numbers, expected 3
Robot7_Odometry.dat | #\\n2 0 0\\n1 0 0\\n | 3 | time 1.0 is before the 2.0
Robot7_Odometry.dat | 1 fast 3\\n | 1 | 'fast'
Robot7_Measurement.dat | 1 63 2 0\\n\\n1 63 0 0\\n | 3 | range
Robot7_Measurement.dat | 1 6.5 2 0\\n | 1 | id '6.5'
Robot7_Measurement.dat | 1 100000000000000000000 2 0\\n | 1 | id '10
Robot7_Groundtruth.dat | 1 2 3 nan\\n | 1 | 'nan'
Barcodes.dat | 1 5\\n6 5\\n | 2 | barcode 5 was given before
Barcodes.dat | 6 5\\n6 7\\n | 2 | subject 6 was given before
Landmark_Groundtruth.dat | 6 1 2 1 1\\n6 3 4 1 1\\n | 2 | subject 6 was given before
Landmark_Groundtruth.dat | 6 1 2 3\\n | 1 | 4 numbers, expected 5: subject, x, y
DRS.txt | 1 0 0\\n1 0 0\\n | 2 | time 1.0 does not rise over 1.0
GPS.txt | 1 0\\n | 1 | 2 numbers, expected 3: time, north, east
LASER_TREE.txt | \\n | 1 | has no scan
LASER_TREE.txt | 1 20 0.5\\n2 20 0.5 7\\n | 2 | 4 numbers, expected a time and pairs
LASER_TREE.txt | 1 20 0.5\\n2 -20 0.5\\n | 2 | range
LASER_TREE.txt | 1 20 0.5\\n\\n2 2_0 0.5\\n | 3 | '2_0'
LASER_TREE.txt | 2 20 0.5\\n1\\n | 2 | time 1.0 does not rise over 2.0
""")


@for_all(case=MISTAKES)
def test_every_mistake_has_its_line(case: list[str], tmp_path: Path, script: Callable[[str], Any]) -> None:
    name, text, line, words = case
    place = written(written(tmp_path, MRCLAM), PARK)
    (place / name).write_text(text)
    reader = partial(script("logs").read_mrclam, robot=7) if name in MRCLAM else script("logs").read_victoria_park
    assert assert_refused(int(line), words, reader, place).path.endswith(name)
