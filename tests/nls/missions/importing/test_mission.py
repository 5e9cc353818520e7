"""Logs as missions: places on the Earth, one zero of time, several sections, and the public sets by their mappings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nls
from models.geodesy import LocalPlane
from nls import OptionError
from nls.cli import main
from nls.missions.importing import draft, write_imported
from tests.combinations import for_all
from tests.nls.missions.importing.logs import imported, line, table

MISSIONS = Path(__file__).parents[4] / "docs" / "missions"


@for_all(unit=["deg", "rad"])
def test_latitudes_become_meters_and_come_back_within_a_millimeter(unit: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    lat, lon = 54.1 + rng.uniform(-0.05, 0.05, 50), 10.2 + rng.uniform(-0.05, 0.05, 50)
    shown = (lat, lon) if unit == "deg" else (np.radians(lat), np.radians(lon))
    rows = "\n".join(f"{k},{a!r},{b!r}" for k, (a, b) in enumerate(zip(*(s.tolist() for s in shown), strict=True)))
    mapping = f'[landmarks]\nlandmark = "k"\nlat_deg = "N [{unit}]"\nlon_deg = "E [{unit}]"\nz_m = 3'
    result = imported(tmp_path, mapping, log=f"k,N [{unit}],E [{unit}]\n{rows}\n")
    places, origin = table(result, "landmarks"), [column[0] for column in table(result, "origin").values()]
    assert origin == pytest.approx([lat[0], lon[0]], abs=1e-13)
    plane = LocalPlane(*origin)
    back = plane.geodetic(np.column_stack([places["x_m"], places["y_m"]]))
    assert np.abs(plane.local(*back) - plane.local(lat, lon)).max() < 1e-3
    assert np.abs(back[0] - lat).max() * 111e3 < 1e-3
    assert 1000 < np.abs(places["x_m"]).max() < 15000


def test_an_origin_that_is_given_counts(tmp_path: Path) -> None:
    fixes = '[fixes]\ntime_s = "t [s]"\nlat_deg = "la [deg]"\nlon_deg = "lo [deg]"\nsigma_x_m = 2\nsigma_y_m = 2'
    log = "t [s],la [deg],lo [deg]\n0,54.001,10.002\n"
    result = imported(tmp_path, f"origin = {{ lat_deg = 54, lon_deg = 10 }}\n{fixes}", log=log)
    assert result.files["origin.csv"] == b"lat_deg,lon_deg\n54.0,10.0\n"
    assert line(result, "fixes", 0) == "time_s,lat_deg,lon_deg,sigma_x_m,sigma_y_m"
    assert line(result, "fixes") == "0.0,54.001,10.002,2.0,2.0"


def test_the_origin_is_the_first_row_that_is_a_fix(tmp_path: Path) -> None:
    mapping = 'fixes = { time_s = "t", lat_deg = "lat", lon_deg = "lon", sigma_x_m = 1, sigma_y_m = 1 }'
    result = imported(tmp_path, mapping, log="t,lat,lon\n0,0,0\n1,0,0\n2,54.25,10.5\n3,54.25001,10.5\n")
    assert line(result, "origin") == "54.25,10.5"
    assert "the origin x = y = 0 is the first place of [fixes]: 54.25, 10.5 deg" in result.notes


def test_all_tables_share_one_zero(tmp_path: Path) -> None:
    """Nanoseconds and ISO 8601 in two zones; the zero is the whole second before the first of all."""
    mapping = 'depth = { time_s = "ns", z_m = "z [m]" }\nposes = { i = "i", time_s = "at" }'
    nav = "at,i\n2024-12-05T23:12:34.75+01:00,1\n2024-12-05T22:12:35.5Z,2\n"
    result = imported(tmp_path, mapping, a="ns,z [m]\n1733436755000000001,1\n1733436755250000000,2\n", b=nav)
    assert table(result, "depth")["time_s"].tolist() == [1.000000001, 1.25]
    assert table(result, "poses")["time_s"].tolist() == [0.75, 1.5]
    assert any(note.startswith("time_zero 2024-12-05T22:12:34.0") for note in result.notes)
    assert b"time_zero 2024-12-05T22:12:34.0" in result.files["README.txt"]
    zero = 'time_zero = "2024-12-05T22:12:00Z"\n'
    given = imported(tmp_path, zero + mapping, a="ns,z [m]\n1733436755000000000,1\n", b=nav)
    assert table(given, "poses")["time_s"].tolist() == [34.75, 35.5]


def test_sections_of_one_table_are_joined_in_the_order_of_time(tmp_path: Path) -> None:
    part = '[[ranges]]\nbeacon = {k}\ntime_s = "t [s]"\nsigma_range_m = 0.5\n'
    part += 'range_m = {{ column = "r{k}", missing = -1 }}\n'
    log = "t [s],r0,r1\n0,5,7\n1,-1,8\n2,6,-1\n"
    rows = table(imported(tmp_path, part.format(k=0) + part.format(k=1), log=log), "ranges")
    joined = [rows[name].tolist() for name in ("time_s", "beacon", "range_m")]
    assert joined == [[0, 0, 1, 2], [0, 1, 1, 0], [5, 7, 8, 6]]


def test_a_log_is_never_replaced(tmp_path: Path) -> None:
    result = imported(tmp_path, 'depth = { time_s = "t [s]", z_m = "z [m]" }', depth="t [s],z [m]\n0,1\n1,2\n")
    with pytest.raises(OptionError, match=r"depth\.csv there is a log that is read"):
        write_imported(tmp_path, result, [tmp_path / "depth.csv"])
    assert (tmp_path / "depth.csv").read_text().startswith("t [s]")


def solved(mapping: Path, logs: list[str], folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[str, Any]:
    """The notes of an import, and dead reckoning against the truth."""
    if not MISSIONS.is_dir():
        pytest.skip("there are no docs here (an installed copy has none)")
    assert main(["import", *logs, "--map", str(mapping), "-o", str(folder)]) == 0
    notes = capsys.readouterr().out
    assert main(["solve", str(folder), "--json", "-"]) == 0
    return notes, json.loads(capsys.readouterr().out)["mission"]["dead_reckoning"]


@pytest.mark.parametrize("mapped", ["by ten lines", "by a draft"])
def test_the_real_auv(mapped: str, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Measured: 0.54 % of 754 m, ATE 2.87 m."""
    logs = [str(data / "underwater-auv-dvl" / f"{kind}_trajectory1.csv") for kind in ("DVL", "GT")]
    mapping = MISSIONS / "auv-dvl.toml"
    if mapped == "by a draft":
        mapping = tmp_path / "mapping.toml"
        mapping.write_text(draft(logs))
    _, reckoned = solved(mapping, logs, tmp_path / "m", capsys)
    assert mapped == "by a draft" or len(mapping.read_text().splitlines()) <= 10
    assert 0.4 < reckoned["drift_percent"] < 0.7
    assert mapped == "by a draft" or 2.5 < reckoned["ate_rmse_m"] < 3.2


def test_holoocean_with_its_axes_up(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Measured: 0.55 m after 25.6 m; the wrong axes of the world or of the DVL give meters."""
    log = data / "underwater-holoocean" / "underwater_data.txt.gz"
    notes, reckoned = solved(MISSIONS / "holoocean.toml", [str(log)], tmp_path / "m", capsys)
    assert "NWU and FLU axes" in notes
    assert reckoned["end_error_m"] < 0.8


def test_contacts_without_their_sonar_are_named(tmp_path: Path) -> None:
    contacts = 'contacts = { time_s = "t", range_m = "range", azimuth_rad = "bearing", '
    contacts += "sigma_range_m = 0.1, sigma_azimuth_rad = 0.01 }"
    notes = imported(tmp_path, contacts, log="t,range,bearing\n0,4,0.1\n1,5,0.2\n").notes
    assert any("nls solve needs dvl.csv, ahrs.csv, depth.csv, noise.csv, sonar.csv besides" in note for note in notes)


def test_what_the_other_sets_lack_is_said(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = [str(data / "underwater-caves" / f"{name}.csv.gz") for name in ("dvl_linkquest", "depth_sensor")]
    assert main(["import", *logs, "--map", str(MISSIONS / "caves.toml"), "-o", str(tmp_path / "caves")]) == 0
    assert "nls solve needs ahrs.csv, noise.csv" in capsys.readouterr().out
    valid = np.genfromtxt(tmp_path / "caves" / "dvl.csv", delimiter=",", names=True)["valid"]
    assert (len(valid), valid.sum()) == (5564, 5082)
    log = str(data / "underwater-ugps" / "g2_acoustic.csv.gz")
    assert main(["import", log, "--map", str(MISSIONS / "ugps.toml"), "-o", str(tmp_path / "ugps")]) == 0
    assert "fixes 4484, beacons 4, ranges 17168, motion 1" in capsys.readouterr().out
    _, values, report = nls.load(tmp_path / "ugps")
    assert (len(values.stack("x")), len(values.stack("b"))) == (4824, 4)
    assert any("no sensor measures the motion" in note for note in report.notes)


def test_a_reckoned_path_is_as_far_from_the_truth_as_published(data: Path, tmp_path: Path) -> None:
    logs = [str(data / "aracati" / f"{name}.csv.gz") for name in ("keyframes", "truth")]
    assert main(["import", *logs, "--map", str(MISSIONS / "aracati.toml"), "-o", str(tmp_path / "m")]) == 0
    _, values, report = nls.load(tmp_path / "m")
    x = values.stack("x")
    assert (len(x), len(report.truth.stack("x"))) == (665, 665)
    error = nls.metrics.ate(np.asarray(x.X), np.asarray(report.truth.stack("x").X), align="rigid")
    assert error.rmse == pytest.approx(10.61, abs=0.01)


def test_files_of_an_import_are_of_text(tmp_path: Path) -> None:
    result = imported(tmp_path, 'calibration = { name = "dvl_scale", value = 0, sigma = 0.01 }')
    assert result.files["calibration.csv"] == b"name,value,sigma\ndvl_scale,0.0,0.01\n"
