"""Pressure in place of depth: by density or latitude, with the atmosphere and the tide."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import ZPR
from models.pressure import depth_unesco
from tests.nls.missions.folder.mission_files import folder
from tests.nls.missions.folder.positioned import csv
from tests.nls.missions.folder.test_velocity import T, log

PRESSURE = 101325.0 + 1025.0 * 9.80665 * 30.0
ORIGIN = {"origin": "lat_deg,lon_deg\n60,5\n"}


def files(water: str = "", tide: str = "", pressure: float = PRESSURE) -> dict[str, str]:
    out = log({"valid": 1}) | {"pressure": csv("time_s,pressure_pa", T, np.full(len(T), pressure))}
    out |= {"water": water} if water else {}
    out |= {"tide": f"time_s,tide_m\n{tide}"} if tide else {}
    return out


def depths(path: Path, tables: dict[str, str]) -> tuple[np.ndarray, str]:
    graph, _, report = nls.load(folder(path, tables, depth=None))
    return next(f for f in graph.factors if isinstance(f, ZPR)).z[:, 0], "\n".join(report.notes)


def test_density_latitude_atmosphere_and_tide(tmp_path: Path) -> None:
    density = "density_kg_m3\n1025\n"
    z, notes = depths(tmp_path / "density", files(density))
    assert z == pytest.approx(30.0)
    assert "pressure.csv: 101325 Pa of it are taken for the atmosphere" in notes
    z, notes = depths(tmp_path / "air", files("density_kg_m3,atmosphere_pa\n1025,100000\n", pressure=PRESSURE - 1325))
    assert z == pytest.approx(30.0)
    assert "atmosphere" not in notes
    z, _ = depths(tmp_path / "tide", files(density, "-10,1.0\n50,4.0\n"))
    assert z == pytest.approx(30.0 - np.interp(np.arange(41.0), [-10, 50], [1.0, 4.0]))
    below = float(depth_unesco(PRESSURE - 101325.0, 60.0))
    assert depths(tmp_path / "latitude", files("latitude_deg\n60\n"))[0] == pytest.approx(below)
    z, notes = depths(tmp_path / "origin", files() | ORIGIN)
    assert z == pytest.approx(below)
    assert "by the formula of UNESCO at 60 degrees, of origin.csv" in notes
