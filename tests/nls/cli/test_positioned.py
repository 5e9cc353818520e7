"""``nls`` on a mission with fixes, beacons and calibrations: what holds it, its files, and robust kernels by type."""

from __future__ import annotations

import csv as csv_reader
import json
from pathlib import Path

import numpy as np
import pytest

import nls
from nls.missions.folder.table import Table
from tests.nls.cli.shell import Shell, row
from tests.nls.missions.folder.mission_files import folder
from tests.nls.missions.folder.positioned import BEACONS, Positioned, csv
from tests.nls.missions.folder.test_acoustic import HEARD, KNOWN, RANGE, SIGMA, T


def test_beacons_and_calibrations_are_written_with_their_sigmas(shell: Shell, tmp_path: Path) -> None:
    truth = Positioned(tmp_path / "truth", T)
    ranges = csv(RANGE, T, HEARD, 1.02 * truth.ranges(T, HEARD), SIGMA)
    fixes = csv("time_s,x_m,y_m,sigma_x_m,sigma_y_m", T[:9], truth.places(T[:9])[:, :2], np.full((9, 2), 0.3))
    calibration = "name,value,sigma\nsound_speed_scale,0.0,0.05\n"
    beacons = "\n".join(KNOWN.splitlines()[:3])
    m = folder(shell / "m", truth.files, ranges=ranges, fixes=fixes, beacons=beacons, calibration=calibration)
    out = shell("solve m -o out --json r.json")
    assert row(out, "ATE").endswith("(no alignment: held in the world by fixes.csv, beacons.csv)")
    assert json.loads((shell / "r.json").read_text())["mission"]["anchor"] == "fixes.csv, beacons.csv"
    columns = ("beacon", "x_m", "y_m", "z_m", "sigma_x_m", "sigma_y_m", "sigma_z_m")
    estimated = Table(shell / "out" / "beacons.csv", columns)
    assert estimated.integers("beacon").tolist() == list(BEACONS)
    p, sigmas = estimated.floats(*columns[1:4]), estimated.floats(*columns[4:])
    error = np.abs(p - list(BEACONS.values()))
    assert (error < 3 * sigmas).all()
    assert (sigmas[2] > 0.15).all()  # the one that was not known
    rows = list(csv_reader.DictReader((shell / "out" / "calibration.csv").read_text().splitlines()))
    assert [r["name"] for r in rows] == ["sound_speed_scale"]
    assert float(rows[0]["value"]) == pytest.approx(0.02, abs=3 * float(rows[0]["sigma"]))
    (m / "beacons.csv").write_bytes((shell / "out" / "beacons.csv").read_bytes())  # an estimate is a table
    assert nls.load(m)[1].stack("b").numbers.tolist() == list(BEACONS)
    assert "robust kernel ScaledRange=cauchy:2" in shell("solve m --robust ScaledRange=cauchy:2")
    assert "ScaledRange" in shell("explain m")
    assert "ranges.csv" in shell("info m")
