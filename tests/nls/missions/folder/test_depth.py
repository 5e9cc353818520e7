"""Pressure in place of depth: by density or latitude, with the atmosphere and the tide."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
from factors import ZPR
from models.errors import GraphFileError
from models.pressure import depth_unesco
from tests.nls.missions.folder.mission_files import folder
from tests.nls.missions.folder.test_velocity import T, log

PRESSURE = 101325.0 + 1025.0 * 9.80665 * 30.0
ORIGIN = {"origin": "lat_deg,lon_deg\n60,5\n"}


def files(water: str = "", tide: str = "", pressure: float = PRESSURE) -> dict[str, str]:
    out = log({"valid": 1})
    del out["depth"]
    out["pressure"] = "time_s,pressure_pa\n" + "".join(f"{float(t)!r},{pressure!r}\n" for t in T)
    return out | ({"water": water} if water else {}) | ({"tide": f"time_s,tide_m\n{tide}"} if tide else {})


def depths(path: Path, tables: dict[str, str]) -> tuple[np.ndarray, str]:
    graph, _, report = nls.load(folder(path, tables))
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


def test_what_is_not_known_is_refused(tmp_path: Path) -> None:
    both = {**files("density_kg_m3\n1025\n"), "depth": log({"valid": 1})["depth"]}
    for k, (tables, problem) in enumerate(
        (
            (files(), r"pressure\.csv:2: nothing says how heavy the water is; add water\.csv"),
            (files("density_kg_m3,latitude_deg\n1025,60\n"), r"water\.csv:2: .* both say how heavy"),
            (files("density_kg_m3\n1025\n1000\n"), r"water\.csv:3: a second row"),
            (files("density_kg_m3\n-3\n"), r"water\.csv:2: density_kg_m3 is -3\.0; expected a number above 0"),
            (files("latitude_deg\n100\n"), r"water\.csv:2: latitude_deg is 100\.0; expected -90 to 90"),
            (files("density_kg_m3\n1025\n", "0,1\n20,2\n"), r"tide\.csv:2: the tide is known from 0\.0 to 20\.0 s"),
            (both, r"has depth\.csv and pressure\.csv, the depth twice"),
            ({**log({"valid": 1}), "tide": "time_s,tide_m\n0,1\n"}, r"tide\.csv:2: depth\.csv has depths"),
        )
    ):
        with pytest.raises(GraphFileError, match=problem):
            nls.load(folder(tmp_path / str(k), tables))
