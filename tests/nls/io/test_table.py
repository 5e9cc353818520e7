"""Values as a table, and poses as trajectories, by `nls.save`."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

import nls
import sim
from models import SE3, R
from nls import Values, kinds
from nls.io import read_tum
from nls.io.table import values_text

x, l = kinds("x", "l")


def test_numbers_read_back_and_cells_stay_empty() -> None:
    X = SE3.exp(np.random.default_rng(0).normal(size=(3, 6)))
    values = Values({x: (SE3, X, [5, 6, 9]), l: (R(2), [[1 / 3, 2.0]])})
    report = nls.LoadReport("a", "g2o", "3-D", "log", vertex_times={"x": np.array([0.1, 0.2, 0.7])})
    rows = list(csv.DictReader(values_text("a.csv", "csv", nls.FactorGraph(), values, report)[0].decode().splitlines()))
    columns = ("x", "y", "z", "qx", "qy", "qz", "qw")
    assert list(rows[0]) == ["kind", "number", "time_s", *columns]
    assert [[float(row[c]) for c in columns] for row in rows[:3]] == X.tolist()
    assert [(row["kind"], row["number"], row["time_s"]) for row in rows[2:]] == [("x", "9", "0.7"), ("l", "0", "")]
    assert [rows[3][c] for c in columns] == [repr(1 / 3), "2.0", "", "", "", "", ""]
    assert values_text("a.csv", "csv", nls.FactorGraph(), Values(), None)[0] == b"kind,number\n"


def test_save_goes_by_the_suffix(tmp_path: Path) -> None:
    world = sim.sphere(np.random.default_rng(0), rings=4, per_ring=6)
    for suffix in ("tum", "kitti", "csv"):
        nls.save(tmp_path / f"poses.{suffix}", world.graph, world.start)
    times, poses = read_tum(tmp_path / "poses.tum")
    assert times.tolist() == list(range(24))
    np.testing.assert_array_equal(poses, world.start[x])
    assert len((tmp_path / "poses.kitti").read_text().splitlines()) == 24
    assert len((tmp_path / "poses.csv").read_text().splitlines()) == 25
