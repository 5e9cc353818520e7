"""A path of another program, from its log to a chart: it stays where its own rows say."""

from __future__ import annotations

import csv
import json
import re

import numpy as np
import pytest

import nls
from models import euler
from models.geodesy import LocalPlane
from tests.nls.cli.shell import Shell

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
