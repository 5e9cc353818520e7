"""Which rows of dvl.csv count, and the way through the water where none does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import XYH
from models import SE3
from nls.io.report import LoadReport
from tests.nls.io.g2o_files import assert_refused
from tests.nls.missions.folder.mission_files import RAW, folder, tables
from tests.nls.missions.folder.positioned import csv

(x,) = nls.kinds("x")
T = np.arange(0.0, 40.01, 0.2)


def log(
    columns: dict[str, object], noise: str = "", value: str = "", yaw: float = 0.0, t: np.ndarray = T
) -> dict[str, str]:
    """1 m/s ahead at times t; columns of dvl.csv besides."""
    zero = np.zeros(len(t))
    table = {"time_s": t, "vx_m_s": 1 + zero, "vy_m_s": zero, "vz_m_s": zero, **columns}
    dvl = [np.broadcast_to(np.asarray(column), len(t)) for column in table.values()]
    names = ",".join(RAW["noise"])
    return {
        "dvl": csv(",".join(table), *dvl),
        **tables(ahrs=(t, zero, zero, yaw + zero), depth=(t, 5 + zero)),
        "noise": f"{names}{noise}\n0.01,0,0.05,0.002,0.002,0.01,0.05{value}\n",
    }


def way(path: Path, files: dict[str, str]) -> tuple[float, float, LoadReport]:
    """How far the dead reckoning ends from its begin, the largest sigma of a leg, the report."""
    graph, values, report = nls.load(folder(path, files))
    steps = next(factor for factor in graph.factors if isinstance(factor, XYH))
    W = steps.noise.sqrt_information(len(steps), ("x", "y", "yaw"))
    p = SE3.position(values.stack("x").X)
    return float(np.linalg.norm(p[-1] - p[0])), float(1 / W[:, 0, 0].min()), report


def test_beams_and_altitude_say_where_the_bottom_is(tmp_path: Path) -> None:
    lost = (T > 10) & (T < 12)
    v = np.where(lost, 77.0, 1.0)
    reference = way(tmp_path / "valid", log({"vx_m_s": v, "valid": 1 * ~lost}))
    for name, columns, reason in (
        ("beams", {"beams": np.where(lost, 2, 4)}, "fewer than 3 beams on the bottom"),
        ("altitude", {"valid": 1, "altitude_m": np.where(lost, 0.0, 9.0)}, "an altitude that is not above 0"),
    ):
        distance, sigma, report = way(tmp_path / name, log({"vx_m_s": v, **columns}))
        assert (distance, sigma) == pytest.approx(reference[:2])
        assert f"dvl.csv:53: 9 rows, this one the first, have {reason}: without bottom lock" in report.notes


def test_a_gate_leaves_out_what_no_vehicle_does(tmp_path: Path) -> None:
    v = np.where(np.isin(np.arange(len(T)), [50, 51, 120]), 3.0, 1.0)
    distance, _, report = way(tmp_path / "gate", log({"vx_m_s": v, "valid": 1}, ",gate_v_m_s", ",0.5"))
    assert distance == pytest.approx(40.0)
    words = "dvl.csv:52: 3 rows, this one the first, have a velocity further than gate_v_m_s, 0.5 m/s"
    assert words in str(report.notes)
    distance, _, report = way(tmp_path / "none", log({"vx_m_s": v, "valid": 1}))
    assert distance == pytest.approx(40.0 + 3 * 2 * 0.2)
    assert "gate" not in str(report.notes)


def test_each_row_has_its_sigma(tmp_path: Path) -> None:
    one = way(tmp_path / "noise", log({"valid": 1}))[1]
    assert way(tmp_path / "rows", log({"valid": 1, "sigma_v_m_s": 0.03}))[1] == pytest.approx(3 * one, rel=1e-6)
    zero = folder(tmp_path / "zero", log({"valid": 1, "sigma_v_m_s": 0.0}))
    assert_refused(2, "sigma_v_m_s is 0.0; expected a number above 0", nls.load, zero)


def test_the_way_through_the_water_and_the_current_go_on(tmp_path: Path) -> None:
    """Looking east over ground at 1 m/s, with a current of 0.3 m/s to the east: 0.7 m/s ahead through the water."""
    rng = np.random.default_rng(0)
    lost = (T > 15) & (T < 25)
    speed = np.where(lost, 1.0 + 0.5 * np.sin(np.pi * (T - 15) / 10), 1.0)  # which no bridge knows
    water = {"water_vx_m_s": speed - 0.3 + rng.normal(0, 0.02, len(T)), "water_vy_m_s": 0.0, "water_vz_m_s": 0.0}
    files = log({"vx_m_s": np.where(lost, 0.0, speed), "valid": 1 * ~lost, **water}, yaw=np.pi / 2)
    distance, sigma, report = way(tmp_path / "water", files)
    assert distance == pytest.approx(40 + 10 / np.pi, abs=0.15)
    assert "the velocity through the water and the current, north " in str(report.notes)
    assert "east 0.3" in str(report.notes)
    assert sigma < 0.2
    legs, spread = 10, 0.02  # the whole of the loss: its 49 rows have the error of the current in common
    assert sigma * np.sqrt(legs) == pytest.approx(spread * 10, rel=0.25)
    odd = folder(tmp_path / "odd", log({"valid": 1 * ~lost, **water, "water_valid": 2}))
    assert_refused(2, "water_valid is '2'; expected 0 or 1", nls.load, odd)
    blind = {**water, "water_valid": 1 * lost}
    alone = log({"vx_m_s": np.where(lost, 0, speed), "valid": 1 * ~lost, **blind})
    distance, _, report = way(tmp_path / "alone", alone)
    assert distance == pytest.approx(40.0)
    assert "is not used: fewer than two rows have both" in str(report.notes)
