"""Beacons and calibrations of a solution, with the columns of the files they are read from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import Diagonal, Isotropic, Prior, Range
from models import SE3, R
from nls.missions.folder.columns import COLUMNS, OPTIONAL
from nls.missions.folder.table import Table
from nls.missions.results import beacons_text, calibration_text

x, b, scale = nls.kinds("x", "b", "dvl_scale")


def test_beacons_and_calibrations_read_back(tmp_path: Path) -> None:
    poses = np.array([[0.0, 0, 0], [10, 0, 1], [0, 10, 2], [7, 7, 5]])
    X = np.column_stack([poses, np.zeros((4, 3)), np.ones(4)])
    places = np.array([[3.0, 4.0, 9.0], [-20.0, 5.0, 12.0]])
    z = np.linalg.norm(places[0] - poses, axis=1)
    graph = nls.FactorGraph(
        [
            Prior(x[np.arange(4)], X, Isotropic(1e-3)),
            Range(x[np.arange(4)], b[np.zeros(4, dtype=int) + 7], z, Isotropic(0.1)),
            Range(x[0], b[9], [np.linalg.norm(places[1])], Isotropic(0.1)),  # free
            Prior(scale[0], [0.01], Diagonal([0.002])),
        ]
    )
    values = nls.Values({x: (SE3, X), b: (R(3), places, [7, 9]), scale: (R(1), [[0.01]])})
    marginals = nls.Marginals(graph, values)
    known, free = beacons_text(values, marginals).decode().splitlines()[1:]
    assert free == "9,-20.0,5.0,12.0,,,"
    file = tmp_path / "beacons.csv"
    file.write_text("\n".join([",".join(["beacon", *COLUMNS["beacons"][1:4], *COLUMNS["beacons"][6:]]), known]))
    table = Table(file, COLUMNS["beacons"], OPTIONAL["beacons"])
    assert table.floats("x_m", "y_m", "z_m").tolist() == [[3, 4, 9]]
    sigma = np.sqrt(np.diag(marginals.covariance(b[7])))
    assert table.floats("sigma_x_m", "sigma_y_m", "sigma_z_m")[0] == pytest.approx(sigma)
    assert beacons_text(values, None).decode().splitlines()[1] == "7,3.0,4.0,9.0,,,"
    (tmp_path / "calibration.csv").write_bytes(calibration_text(values, marginals))
    table = Table(tmp_path / "calibration.csv", COLUMNS["calibration"])
    assert (table.text_of("name"), table.floats("value", "sigma")[0]) == (["dvl_scale"], pytest.approx([0.01, 0.002]))
