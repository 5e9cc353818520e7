"""``nls solve MISSION -o FOLDER``: what is written is where the mission was, to a millimeter; beacons, too."""

from __future__ import annotations

import csv as csv_reader
import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

import nls
from models.algebra import Array
from models.geodesy import LocalPlane
from nls.missions.folder.table import Table
from tests.nls.cli.shell import Shell, row, rows
from tests.nls.missions.folder.mission_files import BEACONS, TINY, Positioned, csv, folder
from tests.nls.missions.folder.test_positions import HEARD, KNOWN, RANGE, SIGMA, T

x, l = nls.kinds("x", "l")
ORIGIN = "lat_deg,lon_deg\n{},{}\n"
pytestmark = pytest.mark.usefixtures("undrawn")
PLACES = [(54.1, 10.2), (-33.9, 151.2), (-17.0, 179.99999), (78.0, 350.5)]


def table(shell: Shell, name: str) -> dict[str, Array]:
    """A CSV file as pandas would see it: one call, empty cells are nan."""
    data = np.genfromtxt(shell / name, delimiter=",", names=True)
    return {column: np.atleast_1d(data[column]) for column in data.dtype.names}


def meters(plane: LocalPlane, coordinates: list[list[float]]) -> Array:
    """North, east and down of longitude, latitude and height."""
    lon, lat, height = np.array(coordinates).T
    return np.column_stack([plane.local(lat, lon), -height])


@pytest.mark.parametrize(("lat", "lon"), PLACES)
def test_there_and_back_is_a_millimeter(shell: Shell, lat: float, lon: float) -> None:
    """Poses anchored by their latitudes and longitudes come back in GeoJSON, KML and the tables."""
    plane, ne = LocalPlane(lat, lon), np.array([[0.0, 0], [400, 300], [900, -200], [1500, 700]])
    given = np.column_stack(plane.geodetic(ne))  # as a log has them
    places = plane.local(*given.T)
    steps = np.diff(places, axis=0)
    odometry = [f"{k},{k + 1},{a!r},{b!r},0,0.01,0.01,0.001" for k, (a, b) in enumerate(steps.tolist())]
    zpr = [f"{k},{5.0 + k},0,0,0.01,0.002,0.002" for k in range(4)]
    files = {
        name: "\n".join([TINY[name].splitlines()[0], *rows]) for name, rows in (("odometry", odometry), ("zpr", zpr))
    }
    folder(shell / "m", files, origin=ORIGIN.format(lat, lon), anchor=TINY["anchor"])
    out = shell("solve m -o out")
    assert "origin.csv" not in out
    features = json.loads((shell / "out/track.geojson").read_text())["features"]
    track = features[0]
    assert track["geometry"]["type"] == "LineString"
    back = meters(plane, track["geometry"]["coordinates"])
    expected = np.column_stack([places, 5.0 + np.arange(4)])
    assert np.abs(back - expected).max() < 1e-3
    longitudes = np.array(track["geometry"]["coordinates"])[:, 0]
    assert np.ptp(longitudes) < 1  # not around the Earth
    columns = table(shell, "out/trajectory.csv")
    assert np.abs(plane.local(columns["lat_deg"], columns["lon_deg"]) - places).max() < 1e-3
    tree = ET.parse(shell / "out/track.kml").getroot()
    line = next(e for e in tree.iter() if e.tag.endswith("LineString"))
    text = next(e.text for e in line if e.tag.endswith("coordinates")) or ""
    kml = meters(plane, [[float(c) for c in triple.split(",")] for triple in text.split()])
    assert np.abs(kml - expected).max() < 1e-3
    assert next(e.text for e in line if e.tag.endswith("altitudeMode")) == "absolute"


def test_what_the_chart_holds(shell: Shell) -> None:
    folder(shell / "m", origin=ORIGIN.format(54.1, 10.2), poses="i,time_s\n0,10\n1,10.5\n2,12\n3,12.25\n")
    shell("solve m -o out")
    plane = LocalPlane(54.1, 10.2)
    graph, values, _ = nls.load("m")
    values = graph.optimize(nls.initialize(graph, values)[0]).values
    features = json.loads((shell / "out/track.geojson").read_text())["features"]
    by = {kind: [f for f in features if f["properties"]["kind"] == kind] for kind in ("track", "landmark", "ellipse")}
    assert len(features) == sum(map(len, by.values())) == 1 + 3 + 4 + 3
    (track,) = by["track"]
    about, columns, points = track["properties"], table(shell, "out/trajectory.csv"), table(shell, "out/map.csv")
    assert (about["i"], about["time_s"]) == ([0, 1, 2, 3], [10.0, 10.5, 12.0, 12.25])
    assert about["sigma_north_m"] == pytest.approx(columns["sigma_x_m"], abs=1e-4)
    for feature, number, place, variance in zip(
        by["landmark"], points["landmark"], values[l], points["cov_z_z_m2"], strict=True
    ):
        assert feature["properties"]["number"] == number
        assert meters(plane, [feature["geometry"]["coordinates"]])[0] == pytest.approx(place, abs=1e-3)
        assert feature["properties"]["sigma_depth_m"] == pytest.approx(np.sqrt(variance), abs=1e-4)
    poses = [f for f in by["ellipse"] if f["properties"]["of"] == "pose"]
    for feature in poses:
        k = feature["properties"]["number"]
        (outline,) = feature["geometry"]["coordinates"]
        ring = meters(plane, [[*place, 0.0] for place in outline])
        assert np.array_equal(ring[0], ring[-1])
        north, east = ring[:, 0], ring[:, 1]
        assert np.sum(east[:-1] * np.diff(north) - north[:-1] * np.diff(east)) > 0  # counterclockwise
        assert np.ptp(north) / 2 == pytest.approx(np.sqrt(5.991) * columns["sigma_x_m"][k], rel=0.02)
        assert np.ptp(east) / 2 == pytest.approx(np.sqrt(5.991) * columns["sigma_y_m"][k], rel=0.02)


def test_points_and_grid(shell: Shell) -> None:
    folder(shell / "m", origin=ORIGIN.format(54.1, 10.2))
    assert "origin.csv" not in shell("solve m -o out --quiet")
    points = table(shell, "out/map.csv")
    place = np.column_stack([points["x_m"], points["y_m"], points["z_m"]])
    assert np.array_equal(cloud(shell, "out/map.ply")[0], place)
    head, grid = ascii_grid(shell, "out/depth.asc")
    for north, east, depth in place:  # three landmarks in cells of their own
        row = len(grid) - 1 - int((north - head["yllcorner"]) // head["cellsize"])
        assert grid[row, int((east - head["xllcorner"]) // head["cellsize"])] == pytest.approx(depth, abs=1e-4)
    assert np.isfinite(grid).sum() == 3


def test_projected(shell: Shell) -> None:
    pyproj = pytest.importorskip("pyproj")
    folder(shell / "m", origin=ORIGIN.format(54.1, 10.2))
    columns = {}
    for name, code in (("utm", 32632), ("EPSG:25832", 25832)):
        shell(f"solve m -o out --crs {name} --quiet")
        columns = table(shell, "out/trajectory.csv")
        to = pyproj.Transformer.from_crs(4326, code, always_xy=True)
        expected = np.array(to.transform(columns["lon_deg"], columns["lat_deg"]))
        assert np.array([columns["easting_m"], columns["northing_m"]]) == pytest.approx(expected, abs=1e-3)
    points, (place, head) = table(shell, "out/map.csv"), cloud(shell, "out/map.ply")
    assert place == pytest.approx(
        np.column_stack([points["easting_m"], points["northing_m"], -points["z_m"]]), abs=1e-3
    )
    assert "EPSG:25832" in head
    corner = ascii_grid(shell, "out/depth.asc")[0]
    assert 0 <= points["easting_m"].min() - corner["xllcorner"] < corner["cellsize"]
    folder(shell / "south", origin=ORIGIN.format(-33.9, 151.2))
    shell("solve south -o out --crs utm --quiet")
    assert "EPSG:32756" in cloud(shell, "out/map.ply")[1]


def test_refusals_and_the_note(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyproj")
    folder(shell / "m")
    folder(shell / "n", origin=ORIGIN.format(54.1, 10.2))
    shell.file()
    (note,) = [text for text in rows(shell("solve m -o out"), "note") if "origin.csv" in text]
    assert note.startswith("no latitudes, no track.geojson and no track.kml: the mission has no origin.csv")
    for words, message in (
        ("m -o new --crs utm", "the mission has no origin.csv"),
        ("n -o new --crs gauss", "expected local, utm or EPSG:n"),
        ("n --crs utm", "it is for the folder that -o writes of a mission"),
        ("graph.g2o -o new.g2o --crs utm", "it is for the folder that -o writes of a mission"),
        ("n -o new --crs EPSG:4326", "a projected system in meters: EPSG:4326 is WGS 84"),
        ("n -o new --crs EPSG:2263", "a projected system in meters"),  # feet
        ("n -o new --crs EPSG:999999999", "a system that pyproj knows"),
    ):
        assert message in shell.refused(f"solve {words}")
    monkeypatch.setitem(sys.modules, "pyproj", None)
    assert 'pip install "leadline[geo]"' in shell.refused("solve n -o new --crs utm")


def test_tables_have_no_comments_and_empty_cells(shell: Shell) -> None:
    """A landmark seen once has no sigmas: its cells are empty, and one line reads the file."""
    folder(shell / "m", contacts=TINY["contacts"] + "0,20,4.0,0.0,0.01,0.004\n", origin=ORIGIN.format(54.1, 10.2))
    shell("solve m -o out")
    for name in ("trajectory.csv", "map.csv"):
        head, *body = csv_reader.reader((shell / "out" / name).read_text().splitlines())
        assert {len(row) for row in body} == {len(head)} == {len(set(head))}
        columns = table(shell, f"out/{name}")
        assert list(columns) == head
        for number, cells in enumerate(body):
            assert [cell == "" for cell in cells] == [bool(np.isnan(columns[column][number])) for column in head]
    assert np.isnan(columns["cov_x_x_m2"]).tolist() == [False, False, False, True]
    features = json.loads((shell / "out/track.geojson").read_text())["features"]
    (free,) = [f for f in features if f["properties"]["kind"] == "landmark" and f["properties"]["number"] == 20]
    assert free["properties"]["sigma_depth_m"] is None
    assert not [f for f in features if f["properties"].get("of") == "landmark" and f["properties"]["number"] == 20]


def cloud(shell: Shell, name: str) -> tuple[Array, str]:
    """Points and head of a PLY file."""
    head, data = (shell / name).read_bytes().split(b"end_header\n")
    dtype = [("p", "<f8", 3), ("kind", "u1"), ("number", "<i4")]
    return np.frombuffer(data, dtype=dtype)["p"], head.decode()


def ascii_grid(shell: Shell, name: str) -> tuple[dict[str, float], Array]:
    """Head and cells (rows, columns) of a grid, nan where there is none; north first."""
    lines = (shell / name).read_text().splitlines()
    head = {word: float(value) for word, value in (line.split() for line in lines[:6])}
    grid = np.array([line.split() for line in lines[6:]], dtype=float)
    assert grid.shape == (head["nrows"], head["ncols"])
    return head, np.where(grid == head["NODATA_value"], np.nan, grid)


def test_beacons_and_calibrations_are_written_with_their_sigmas(shell: Shell, tmp_path: Path) -> None:
    truth = Positioned(tmp_path / "truth", T)
    ranges = csv(RANGE, T, HEARD, 1.02 * truth.ranges(T, HEARD), SIGMA)
    fixes = csv("time_s,x_m,y_m,sigma_x_m,sigma_y_m", T[:9], truth.places(T[:9])[:, :2], np.full((9, 2), 0.3))
    calibration = "name,value,sigma\nsound_speed_scale,0.0,0.05\n"
    beacons = "\n".join(KNOWN.splitlines()[:3])
    m = folder(shell / "m", truth.files, ranges=ranges, fixes=fixes, beacons=beacons, calibration=calibration)
    out, report = shell.told("solve m -o out")
    assert row(out, "ATE").endswith("(no alignment: anchored by fixes.csv, beacons.csv)")
    assert report["mission"]["anchor"] == "fixes.csv, beacons.csv"
    columns = ("beacon", "x_m", "y_m", "z_m", "sigma_x_m", "sigma_y_m", "sigma_z_m")
    estimated = Table(shell / "out" / "beacons.csv", columns)
    assert estimated.integers("beacon").tolist() == list(BEACONS)
    p, sigmas = estimated.floats(*columns[1:4]), estimated.floats(*columns[4:])
    error = np.abs(p - list(BEACONS.values()))
    assert (error < 3 * sigmas).all()
    assert (sigmas[2] > 0.15).all()  # the one that was not known
    rows = list(csv_reader.DictReader((shell / "out" / "calibration.csv").read_text().splitlines()))
    assert [r["name"] for r in rows] == ["sound_speed_scale"]
    assert float(rows[0]["value"]) == pytest.approx(0.02, abs=3 * float(rows[0]["sigma"]))
    (m / "beacons.csv").write_bytes((shell / "out" / "beacons.csv").read_bytes())  # an estimate is a table
    assert nls.load(m)[1].stack("b").numbers.tolist() == list(BEACONS)
