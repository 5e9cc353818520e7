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
from tests.nls.cli.shell import Shell, row, rows
from tests.nls.missions.folder.mission_files import raw

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


def test_refusals(shell: Shell) -> None:
    shell.file(LOG, "log.csv")
    shell.file(MAPPING, "mapping.toml")
    shell.file("[depth\n", "damaged.toml")
    assert "-o is missing; expected a folder for the mission: -o mission" in shell.refused(
        "import log.csv --map mapping.toml"
    )
    assert "--map is missing beside -o; a draft of a mapping: nls import LOG > mapping.toml" in shell.refused(
        "import log.csv -o mission"
    )
    assert "nothing.csv: cannot be read" in shell.refused("import nothing.csv --map mapping.toml -o mission")
    assert "nothing.toml: cannot be read" in shell.refused("import log.csv --map nothing.toml -o mission")
    assert "damaged.toml:1: is no TOML" in shell.refused("import log.csv --map damaged.toml -o mission")
    assert "cannot be read" in shell.refused("import nothing.csv")
    (shell / "folder").mkdir()
    assert "is a folder" in shell.refused("import folder")


def test_tables_that_are_no_mission_point_to_the_import(shell: Shell) -> None:
    for text in (LOG, LOG.replace(";", ","), LOG.replace(";", "\t"), "0 1 2 3.5\n1 2 3 4.5\n"):
        shell.file(text, "log.csv")
        error = shell.refused("solve log.csv")
        assert "nls import log.csv prints a mapping" in error
        assert "nls new FOLDER" in error
    (shell / "mission").mkdir()
    shell.file(LOG, "mission/log.csv")
    assert "nls import mission/log.csv prints a mapping" in shell.refused("solve mission")


def test_a_column_that_no_table_has_points_to_the_mapping(shell: Shell) -> None:
    (shell / "m").mkdir()
    for name, text in {**raw(), "dvl": "time_s,vel_x_m_s,vy_m_s,vz_m_s,valid\n0,1,1,1,1.0\n"}.items():
        shell.file(text, f"m/{name}.csv")
    error = shell.refused("solve m")
    assert "unknown column 'vel_x_m_s'; expected time_s" in error
    assert "; did you mean 'vx_m_s'?" in error
    assert '[dvl] vx_m_s = "vel_x_m_s"' in error


def test_flags_with_a_decimal_point_are_flags(shell: Shell) -> None:
    (shell / "m").mkdir()
    for name, text in raw().items():
        shell.file(re.sub(r",1$", ",1.0000", text, flags=re.M) if name == "dvl" else text, f"m/{name}.csv")
    shell("solve m")
    shell.file(raw()["dvl"].replace(",1\n", ",yes\n", 1), "m/dvl.csv")
    assert "valid is 'yes'; expected 0 or 1" in shell.refused("solve m")


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
    (shell / "log.csv").write_text("\n".join(["t,lat,lon,depth,heading", *rows, ""]))
    (shell / "map.toml").write_text(MAP)
    shell("import log.csv --map map.toml -o m")
    assert "held at the first row of path.csv" in shell("solve m -o s")
    shell("convert m m.csv")
    shell("convert m m.json")

    table = list(csv.DictReader((shell / "s" / "trajectory.csv").read_text().splitlines()))
    of_csv = np.array([[float(row[name]) for name in ("lat_deg", "lon_deg", "x_m", "y_m", "yaw_rad")] for row in table])
    track = json.loads((shell / "s" / "track.geojson").read_text())["features"][0]["geometry"]["coordinates"]
    kml = re.search(r"<LineString>.*?<coordinates>(.*?)</coordinates>", (shell / "s" / "track.kml").read_text(), re.S)
    assert kml is not None
    of_kml = np.array([place.split(",") for place in kml[1].split()], dtype=float)
    degree = pytest.approx(earth, abs=2e-9)  # 0.2 mm
    assert of_csv[:, :2] == degree
    assert np.array(track)[:, 1::-1] == degree
    assert of_kml[:, 1::-1] == degree
    meter = pytest.approx(p, abs=1e-6)
    assert of_csv[:, 2:4] == meter
    assert np.cos(of_csv[:, 4] - yaw) == pytest.approx(1)
    assert np.loadtxt(shell / "s" / "trajectory.tum")[:, 1:3] == meter
    converted = list(csv.DictReader((shell / "m.csv").read_text().splitlines()))
    assert np.array([[float(row["x"]), float(row["y"])] for row in converted]) == meter
    _, values, _ = nls.load(shell / "m.json")
    assert euler.from_se3(values[x])[:, 3:5] == meter


def test_an_anchor_moves_a_path_that_begins_elsewhere(shell: Shell) -> None:
    (shell / "m").mkdir()
    rows = [f"{k},{100 + k},50,0,0.1,0.1,0.01" for k in range(4)]
    names = "time_s,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad"
    (shell / "m" / "path.csv").write_text("\n".join([names, *rows, ""]))
    anchor = "i,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad\n2,7,8,1.5707963267948966,0.01,0.01,0.001\n"
    (shell / "m" / "anchor.csv").write_text(anchor)
    assert "held at" not in shell("solve m -o s")
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
