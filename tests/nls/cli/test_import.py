"""``nls import`` and ``nls new``: logs become missions and charts, also paths and logs without a DVL."""

from __future__ import annotations

import csv
import json
import re

import numpy as np
import pytest

import nls
from models import euler
from models.geodesy import LocalPlane
from nls.missions.folder.poses import read_poses
from nls.missions.importing import Mapping, import_logs
from nls.stages import listened
from tests.nls.cli.shell import Shell, row, rows
from tests.nls.missions.folder.mission_files import folder, raw

pytestmark = pytest.mark.usefixtures("undrawn")
LOG = "t [s];depth [cm];note\n0;250;a\n1;260;b\n"
MAPPING = 'depth = { time_s = "t [s]", z_m = "depth [cm]" }\n'


def test_a_log_without_a_mapping_gives_a_draft(shell: Shell) -> None:
    shell.file(LOG, "log.csv")
    out, err = shell.both("import log.csv")
    assert '[depth]\ntime_s = "t [s]"\nz_m = "depth [cm]"\n# not used: \'note\'' in out
    assert err == "nls: this is a draft: save it as mapping.toml, correct it, and give it by --map\n"


def test_a_log_becomes_a_mission(shell: Shell) -> None:
    shell.file(LOG, "log.csv")
    shell.file(MAPPING, "mapping.toml")
    out = shell("import log.csv --map mapping.toml -o mission")
    assert rows(out, "written") == ["mission: depth 2"]
    assert "nls solve needs dvl.csv, ahrs.csv, noise.csv besides" in rows(out, "note")[-1]
    assert (shell / "mission" / "depth.csv").read_text() == "time_s,z_m\n0.0,2.5\n1.0,2.6\n"
    assert MAPPING in (shell / "mission" / "README.txt").read_text()


def test_a_flag_of_a_table_without_flags_selects_its_rows(shell: Shell) -> None:
    shell.file("t [s];depth [cm];ok\n0;250;True\n1;260;false\n", "log.csv")
    shell.file('[depth]\ntime_s = "t [s]"\nz_m = "depth [cm]"\nvalid = "ok"\n', "mapping.toml")
    refused = shell.refused("import log.csv --map mapping.toml -o mission")
    cure = re.search(r"select rows: (where = .* }); it has", refused)
    assert cure
    shell.file((shell / "mapping.toml").read_text().replace('valid = "ok"', cure[1]), "mapping.toml")
    assert rows(shell("import log.csv --map mapping.toml -o mission"), "written") == ["mission: depth 1"]


def test_flags_with_a_decimal_point_are_flags(shell: Shell) -> None:
    folder(shell / "m", raw(), dvl=re.sub(r",1$", ",1.0000", raw()["dvl"], flags=re.M))
    shell("solve m")


def test_new_never_overwrites(shell: Shell) -> None:
    (shell / "mission").mkdir()
    shell.file("mine", "mission/mapping.toml")
    out = shell("new mission")
    assert rows(out, "note") == ["kept as they are: mapping.toml"]
    assert (shell / "mission" / "mapping.toml").read_text() == "mine"
    assert (shell / "mission" / "templates" / "dvl.csv").read_text().count("# ") == 4
    before = shell.contents()
    assert rows(shell("new mission"), "written") == ["mission: 0 templates"]
    assert shell.contents() == before
    shell("new other --map")
    assert [path.name for path in (shell / "other").iterdir()] == ["mapping.toml"]


(x,) = nls.kinds("x")
ORIGIN = 54.0, 10.0
MAP = """\
time_s = "t"
[origin]
lat_deg = 54.0
lon_deg = 10.0
[path]
lat_deg = "lat"
lon_deg = "lon"
z_m = "depth"
yaw_rad = { column = "heading", unit = "deg" }
sigma_x_m = 0.05
sigma_y_m = 0.05
sigma_yaw_rad = 0.01
sigma_z_m = 0.05
"""


@pytest.mark.parametrize(
    ("heading", "begin"),
    [(90.0, (0.0, 0.0)), (30.0, (0.0, 0.0)), (30.0, (400.0, -300.0)), (215.0, (-80.0, 900.0))],
)
def test_every_chart_has_the_path_where_its_rows_are(shell: Shell, heading: float, begin: tuple[float, float]) -> None:
    yaw, plane = np.deg2rad(heading), LocalPlane(*ORIGIN)
    p = begin + np.arange(5.0)[:, None] * 30 * np.array([np.cos(yaw), np.sin(yaw)])
    earth = np.column_stack(plane.geodetic(p))
    rows = [f"{10 * k},{lat!r},{lon!r},5,{heading}" for k, (lat, lon) in enumerate(earth.tolist())]
    shell.file("\n".join(["t,lat,lon,depth,heading", *rows, ""]), "log.csv")
    shell.file(MAP, "map.toml")
    shell("import log.csv --map map.toml -o m")
    assert "fixed at the first row of path.csv" in shell("solve m -o s")
    shell("convert m m.csv")
    shell("convert m m.json")
    meter = pytest.approx(p, abs=1e-6)
    table, converted = (np.genfromtxt(name, delimiter=",", names=True) for name in ("s/trajectory.csv", "m.csv"))
    assert np.stack([table["lat_deg"], table["lon_deg"]], axis=1) == pytest.approx(earth, abs=2e-9)  # 0.2 mm
    assert np.stack([table["x_m"], table["y_m"]], axis=1) == meter
    assert np.cos(table["yaw_rad"] - yaw) == pytest.approx(1)
    assert np.loadtxt(shell / "s" / "trajectory.tum")[:, 1:3] == meter
    assert np.stack([converted["x"], converted["y"]], axis=1) == meter
    _, values, _ = nls.load(shell / "m.json")
    assert euler.from_se3(values[x])[:, 3:5] == meter


def test_an_anchor_moves_a_path_that_begins_elsewhere(shell: Shell) -> None:
    rows = [f"{k},{100 + k},50,0,0.1,0.1,0.01" for k in range(4)]
    names = "x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad"
    anchor = f"i,{names}\n2,7,8,1.5707963267948966,0.01,0.01,0.001\n"
    folder(shell / "m", {"path": "\n".join([f"time_s,{names}", *rows, ""]), "anchor": anchor})
    assert "fixed at" not in shell("solve m -o s")
    track = np.loadtxt(shell / "s" / "trajectory.tum")
    assert track[:, 1:3] == pytest.approx(np.array([[7, 6], [7, 7], [7, 8], [7, 9]]), abs=1e-6)


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
    shell.file("t,lat,lon,heading,depth\n" + "".join(ROWS), "log.csv")
    return shell


def imported(log: Shell, mapping: str, name: str = "m") -> str:
    log.file(mapping, "map.toml")
    return log(f"import log.csv --map map.toml -o {name}")


def _filled(shell: Shell, name: str) -> set[str]:
    """Columns with a number in every row; the others have none."""
    rows = list(csv.DictReader((shell / name).read_text().splitlines()))
    count = {column: sum(bool(row[column]) for row in rows) for column in rows[0]}
    assert set(count.values()) <= {0, len(rows)}
    return {column for column, filled in count.items() if filled}


PLACED = {"i", "time_s", "lat_deg", "lon_deg", "x_m", "y_m", "sigma_x_m", "sigma_y_m"}


def test_a_log_of_latitudes_alone_is_a_map_with_empty_cells(log: Shell) -> None:
    imported(log, PLACES)
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
    assert "nls solve needs" not in imported(log, PLACES + COMPASS)
    log("solve m -o s")
    assert _filled(log, "s/trajectory.csv") == PLACED | {"z_m", "yaw_rad", "sigma_z_m", "sigma_yaw_rad"}
    table = np.genfromtxt(log / "s" / "trajectory.csv", delimiter=",", names=True)
    assert np.degrees(table["yaw_rad"]) % 360 == pytest.approx(263 + np.arange(5), abs=0.01)
    assert table["sigma_yaw_rad"] == pytest.approx(0.035, rel=0.01)
    assert table["z_m"] == pytest.approx(10 + np.arange(5) / 10)
    (place, *_) = json.loads((log / "s" / "track.geojson").read_text())["features"][0]["geometry"]["coordinates"]
    assert place[2] == pytest.approx(-10)


def test_a_depth_of_0_in_the_mapping_is_measured(log: Shell) -> None:
    imported(log, PLACES + "z_m = 0\nsigma_z_m = 0.5\n")
    assert "nothing measures roll, pitch, yaw:" in log("solve m -o s")
    assert _filled(log, "s/trajectory.csv") == PLACED | {"z_m", "sigma_z_m"}


def test_a_mapping_without_a_dvl_is_told_of_the_walk_and_its_sigmas(log: Shell) -> None:
    out = imported(log, PLACES.replace(WALK, "") + COMPASS)
    assert "nls solve needs dvl.csv besides" in out
    cure = out.split("without a DVL write `")[1].split("` in [motion]")[0]
    assert "nls solve needs" not in imported(log, f"{PLACES.replace(WALK, '')}{COMPASS}[motion]\n{cure}\n")
    log("solve m -o s")
    assert "nls solve needs noise.csv besides" in imported(log, PLACES + COMPASS.split("[noise]")[0], "n")
    _, error = log.both("solve n", 2)
    assert "write noise.csv with one row of sigma_yaw_rad" in error


def test_each_of_several_dives_has_its_own_empty_cells(log: Shell) -> None:
    for name, mapping in (("a", PLACES), ("b", PLACES + COMPASS)):
        imported(log, mapping + "[origin]\nlat_deg = 48.0\nlon_deg = -123.0\n", name)
    out = log("solve a b -o s --covariance c.csv")
    assert "the place" in row(out, "unchecked")
    assert not {"world_z_z", "world_yaw_yaw"} & _filled(log, "c.csv")  # of none, as one dive has none
    assert _filled(log, "s/a/trajectory.csv") == PLACED
    assert _filled(log, "s/b/trajectory.csv") == PLACED | {"z_m", "yaw_rad", "sigma_z_m", "sigma_yaw_rad"}


def test_what_nothing_checks_is_in_the_table_the_report_and_the_page(log: Shell) -> None:
    imported(log, PLACES + COMPASS)
    out = log("solve m --json r.json --report page.html")
    words = "the depth of depth.csv; the heading of ahrs.csv; the place, the clock of fixes.csv"
    assert row(out, "unchecked") == f"{words}: no other measurement would show an error"
    assert words in (log / "page.html").read_text()
    unchecked = log.json()["mission"]["unchecked"]
    assert [entry["quantity"] for entry in unchecked] == ["depth", "heading", "place", "clock"]


def test_an_import_says_how_far_it_is(shell: Shell) -> None:
    shell.file(LOG, "log.csv")
    steps: list[str] = []
    with listened(steps.append):
        import_logs(["log.csv"], Mapping(MAPPING, "mapping.toml"))
    columns = [f"depth.csv, {name}: 2 rows" for name in ("time_s", "z_m")]
    assert steps == ["4 lines of log.csv", *columns, "depth.csv: 2 rows"]
