"""Public logs of vehicles among landmarks: what their readers make of them, and what they refuse."""

from __future__ import annotations

import gzip
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tests.combinations import for_all
from tests.nls.io.g2o_files import assert_refused, cases

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


SCRIPT = "logs"


def written(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder


def test_an_mrclam_log(tmp_path: Path, evidence: Any) -> None:
    log = evidence.read_mrclam(written(tmp_path, MRCLAM), 7)
    np.testing.assert_allclose(log.t, [0.5, 0.6])
    np.testing.assert_array_equal(log.u, [[0.1, 0.2], [0.5, 0.6]])  # of two rows at one time the last
    np.testing.assert_allclose(log.t_seen, [0.7, 0.7, 0.8])
    np.testing.assert_array_equal(log.subject, [6, 1, 0])
    np.testing.assert_array_equal(log.z, [[-0.25, 2.5], [0.5, 3.5], [1.0, 4.5]])
    np.testing.assert_array_equal(log.landmarks, [6, 7])
    np.testing.assert_array_equal(log.places, [[0.5, -4.25], [0.75, -4.5]])
    np.testing.assert_allclose(log.true_poses(np.array([0.5, 1.0])), [[1.5, 2.5, 3 + (np.pi - 3) / 2], [2, 3, -np.pi]])


def test_a_victoria_park_log(tmp_path: Path, evidence: Any) -> None:
    folder = written(tmp_path, PARK)
    scans = folder / "LASER_TREE.txt"
    (folder / "LASER_TREE.txt.gz").write_bytes(gzip.compress(scans.read_bytes()))
    scans.unlink()
    log = evidence.read_victoria_park(folder)
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
def test_every_mistake_has_its_line(case: list[str], tmp_path: Path, evidence: Any) -> None:
    name, text, line, words = case
    place = written(written(tmp_path, MRCLAM), PARK)
    (place / name).write_text(text)
    reader = partial(evidence.read_mrclam, robot=7) if name in MRCLAM else evidence.read_victoria_park
    assert assert_refused(int(line), words, reader, place).path.endswith(name)
