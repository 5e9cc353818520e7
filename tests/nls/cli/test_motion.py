"""``nls`` on a vehicle without a DVL: its log from import to chart, and no number of what nothing measures."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from nls.missions.folder.poses import read_poses
from tests.nls.cli.shell import Shell, row

ROWS = [f"{k},{48 + k * 1e-5},-123.0,{263 + k},{10 + k / 10}\n" for k in range(5)]
PLACES = """
time_s = "t"
[motion]
sigma_walk_m_sqrt_s = 1.0
[fixes]
lat_deg = { column = "lat", unit = "deg" }
lon_deg = { column = "lon", unit = "deg" }
sigma_x_m = 1.0
sigma_y_m = 1.0
"""
WALK = "[motion]\nsigma_walk_m_sqrt_s = 1.0\n"
COMPASS = """
[ahrs]
yaw_rad = { column = "heading", unit = "deg" }
[depth]
z_m = { column = "depth", unit = "m" }
[noise]
sigma_yaw_rad = 0.035
sigma_z_m = 0.1
"""


@pytest.fixture
def log(shell: Shell) -> Shell:
    (shell / "log.csv").write_text("t,lat,lon,heading,depth\n" + "".join(ROWS))
    return shell


def _filled(shell: Shell, name: str) -> set[str]:
    """Columns with a number in every row; the others have none."""
    rows = list(csv.DictReader((shell / name).read_text().splitlines()))
    count = {column: sum(bool(row[column]) for row in rows) for column in rows[0]}
    assert set(count.values()) <= {0, len(rows)}
    return {column for column, filled in count.items() if filled}


PLACED = {"i", "time_s", "lat_deg", "lon_deg", "x_m", "y_m", "sigma_x_m", "sigma_y_m"}


def test_a_log_of_latitudes_alone_is_a_map_with_empty_cells(log: Shell) -> None:
    (log / "map.toml").write_text(PLACES)
    log("import log.csv --map map.toml -o m")
    out = log("solve m -o s --covariance c.csv")
    assert "nothing measures roll, pitch, yaw, z: empty cells in trajectory.csv; 0 in trajectory.tum" in out
    assert _filled(log, "s/trajectory.csv") == PLACED
    known = _filled(log, "c.csv") - {"kind", "number", "status"}
    assert known == {"world_x_x", "world_x_y", "world_y_y"}
    track = json.loads((log / "s" / "track.geojson").read_text())["features"][0]
    assert np.shape(track["geometry"]["coordinates"]) == (5, 2)
    assert track["properties"]["sigma_depth_m"] == [None] * 5
    assert None not in track["properties"]["sigma_north_m"]
    weakest = log("explain m").split("least certain")[1].split("note")[0]
    assert [line.split()[1] for line in weakest.splitlines()[1:] if line] == ["x", "y"]
    assert not read_poses(log / "s" / "trajectory.csv").oriented
    assert read_poses(log / "s" / "trajectory.tum").X[:, 2:] == pytest.approx(np.tile([0, 0, 0, 0, 1], (5, 1)))


def test_compass_and_depth_beside_it_are_in_the_files(log: Shell) -> None:
    (log / "map.toml").write_text(PLACES + COMPASS)
    out = log("import log.csv --map map.toml -o m")
    assert "nls solve needs" not in out
    log("solve m -o s")
    assert _filled(log, "s/trajectory.csv") == PLACED | {"z_m", "yaw_rad", "sigma_z_m", "sigma_yaw_rad"}
    table = np.genfromtxt(log / "s" / "trajectory.csv", delimiter=",", names=True)
    assert np.degrees(table["yaw_rad"]) % 360 == pytest.approx(263 + np.arange(5), abs=0.01)
    assert table["sigma_yaw_rad"] == pytest.approx(0.035, rel=0.01)
    assert table["z_m"] == pytest.approx(10 + np.arange(5) / 10)
    (place, *_) = json.loads((log / "s" / "track.geojson").read_text())["features"][0]["geometry"]["coordinates"]
    assert place[2] == pytest.approx(-10)


def test_a_depth_of_0_in_the_mapping_is_measured(log: Shell) -> None:
    (log / "map.toml").write_text(PLACES + "z_m = 0\nsigma_z_m = 0.5\n")
    log("import log.csv --map map.toml -o m")
    assert "nothing measures roll, pitch, yaw:" in log("solve m -o s")
    assert _filled(log, "s/trajectory.csv") == PLACED | {"z_m", "sigma_z_m"}


def test_a_mapping_without_a_dvl_is_told_of_the_walk_and_its_sigmas(log: Shell) -> None:
    (log / "map.toml").write_text(PLACES.replace(WALK, "") + COMPASS)
    out = log("import log.csv --map map.toml -o m")
    assert "nls solve needs dvl.csv besides" in out
    cure = out.split("without a DVL write `")[1].split("` in [motion]")[0]
    (log / "map.toml").write_text(f"{PLACES.replace(WALK, '')}{COMPASS}[motion]\n{cure}\n")
    assert "nls solve needs" not in log("import log.csv --map map.toml -o m")
    log("solve m -o s")
    (log / "map.toml").write_text(PLACES + COMPASS.split("[noise]")[0])
    assert "nls solve needs noise.csv besides" in log("import log.csv --map map.toml -o n")
    _, error = log.both("solve n", 2)
    assert "write noise.csv with one row of sigma_yaw_rad" in error


def test_each_of_several_dives_has_its_own_empty_cells(log: Shell) -> None:
    for name, mapping in (("a", PLACES), ("b", PLACES + COMPASS)):
        (log / "map.toml").write_text(mapping + "[origin]\nlat_deg = 48.0\nlon_deg = -123.0\n")
        log(f"import log.csv --map map.toml -o {name}")
    out = log("solve a b -o s --covariance c.csv")
    assert "the place" in row(out, "unchecked")
    assert not {"world_z_z", "world_yaw_yaw"} & _filled(log, "c.csv")  # of none, as one dive has none
    assert _filled(log, "s/a/trajectory.csv") == PLACED
    assert _filled(log, "s/b/trajectory.csv") == PLACED | {"z_m", "yaw_rad", "sigma_z_m", "sigma_yaw_rad"}


def test_what_nothing_checks_is_in_the_table_the_report_and_the_page(log: Shell) -> None:
    (log / "map.toml").write_text(PLACES + COMPASS)
    log("import log.csv --map map.toml -o m")
    out = log("solve m --json r.json --report page.html")
    words = "the depth of depth.csv; the heading of ahrs.csv; the place, the clock of fixes.csv"
    assert row(out, "unchecked") == f"{words}: no other measurement would show an error"
    assert words in (log / "page.html").read_text()
    unchecked = json.loads((log / "r.json").read_text())["mission"]["unchecked"]
    assert [entry["quantity"] for entry in unchecked] == ["depth", "heading", "place", "clock"]
