"""Units, and what a refusal of one says to write: latitudes, headings, names with another unit; axes."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from models import SE3, euler
from models.algebra import Array
from nls import GraphFileError, OptionError
from nls.missions.folder.columns import ANGLES, PLACE
from nls.missions.importing.frames import angles_of, turn
from tests.combinations import for_all
from tests.nls.io.g2o_files import cases
from tests.nls.missions.importing.logs import column, drafted, imported, refused, table

FIXES = 'origin = {{ lat_deg = 47, lon_deg = -122 }}\n[fixes]\ntime_s = "t"\nlat_deg = {lat}\nlon_deg = {lon}\n'
SIGMAS = "sigma_x_m = 1\nsigma_y_m = 1\n"
PLACES = np.array([[47.61, -122.35], [47.6105, -122.3501]])


def places(folder: Path, lat: str, lon: str, log: str) -> np.ndarray:
    """Latitudes and longitudes (n, 2) of an import, degrees."""
    rows = table(imported(folder, FIXES.format(lat=lat, lon=lon) + SIGMAS, log=log), "fixes")
    return np.column_stack([rows["lat_deg"], rows["lon_deg"]])


@for_all(
    case=[
        ('{ column = "lat", unit = "degE7" }', '{ column = "lon", unit = "degE7" }', "t,lat,lon", "{a7},{b7}"),
        ('"lat_degE7"', '"lon [1e-7 deg]"', "t,lat_degE7,lon [1e-7 deg]", "{a7},{b7}"),
        ('{ column = "lat", unit = "ddmm" }', '{ column = "lon", unit = "ddmm" }', "t,lat,lon", "{am},-{bm}"),
        ('{ column = ["a [ddmm.mmmm]", "NS"] }', '{ column = ["b_ddmm", "EW"] }',
         "t,a [ddmm.mmmm],NS,b_ddmm,EW", "{am},N,{bm},w"),
        ('{ column = ["lat", "NS"] }', '{ column = ["lon", "EW"] }', "t,lat,lon,NS,EW", "{a},{c},North,West"),
        ('"lat"', '{ column = "lon", sign = -1 }', "t,lat,lon,NS,EW", "{a},{c},N,W"),
        ('"lat"', '"lon"', "t,lat,lon,NS,EW", "{a},-{c},N,W"),
        ('"lat"', '"lon"', "t,lat,lon\nUTC,degrees_north,degrees_east", "{a},-{c}"),
    ]
)  # fmt: skip
def test_latitudes_and_longitudes(case: tuple[str, str, str, str], tmp_path: Path) -> None:
    lat, lon, head, row = case
    log = head + "\n"
    for k, (a, b) in enumerate(PLACES.tolist()):
        minutes = {"am": f"47{(a - 47) * 60:07.4f}", "bm": f"122{(-b - 122) * 60:07.4f}"}
        log += f"{k}," + row.format(a=a, c=-b, a7=round(a * 1e7), b7=round(b * 1e7), **minutes) + "\n"
    assert places(tmp_path, lat, lon, log) == pytest.approx(PLACES, abs=1e-9)


@for_all(
    case=[  # the cell of the longitude, head, first rows; what the line that is written then makes
        ('"lon"', "lat,lon,EW", "47,122.35,W", -122.35),
        ('"lon"', "lat,lon", "47,12221.0", 122.35),
        ('"lon [deg]"', "lat,lon [deg]", "47,-12221.0", -122.35),
        ('"lon"', "lat,lon", "47,-1223500000", -122.35),
        ('{ column = ["lon", "EW"] }', "lat,lon,EW", "47,-122.35,W", -122.35),
        ('"lon_m"', "lat,lon_m", "47,-122.35", -122.35),
    ]
)
def test_a_refused_place_is_cured_by_the_line_that_is_printed(
    case: tuple[str, str, str, float], tmp_path: Path
) -> None:
    cell, head, row, expected = case
    log = f"t,{head}\n0,{row}\n1,{row}\n"
    line = refused(tmp_path, FIXES.format(lat='"lat"', lon=cell) + SIGMAS, log=log).split("write lon_deg = ")[1]
    cure = line[: line.index("}") + 1] if line.startswith("{") else line.split(",")[0]
    assert places(tmp_path, '"lat"', cure, log)[:, 1] == pytest.approx([expected, expected], abs=1e-9)


@for_all(
    case=[
        ('{ column = ["lat", "NS"] }', "4,X", "log.csv:2: NS: 'x' is no side; expected n, north, s, south"),
        ('{ column = "lat", unit = "ddmm" }', "4760.5,N", "log.csv:2: lat: 4760.5 has 60.5 minutes"),
        ('{ column = ["lat", "NS", "t"] }', "4,N", "several columns; only"),
    ]
)
def test_cells_that_are_no_place(case: tuple[str, str, str], tmp_path: Path) -> None:
    mapping = FIXES.format(lat=case[0], lon=-122) + SIGMAS
    assert case[2] in refused(tmp_path, mapping, log=f"t,lat,NS\n0,{case[1]}\n1,4,N\n")


@for_all(
    case=[
        ("yaw [cdeg]", '"yaw [cdeg]"', ("9000", "35900"), None, (90, -1)),
        ("yaw", '"yaw"', ("9000", "35900"), "cdeg", (90, -1)),
        ("yaw [deg]", '"yaw [deg]"', ("9000", "9100"), "cdeg", (90, 91)),
        ("yaw [deg]", '"yaw [deg]"', ("10", "35990"), "cdeg", (0.1, -0.1)),
        ("yaw", '"yaw"', ("90", "270"), "deg", (90, -90)),
        ("yaw [deg]", '"yaw [deg]"', ("350", "710"), None, (-10, -10)),
    ]
)
def test_headings_in_hundredths_of_a_degree(
    case: tuple[str, str, tuple[str, str], str | None, tuple[float, float]], tmp_path: Path
) -> None:
    head, cell, words, unit, expected = case
    mapping = 'ahrs = {{ time_s = "t", roll_rad = 0, pitch_rad = 0, yaw_rad = {} }}'
    log = f"t,{head}\n0,{words[0]}\n1,{words[1]}\n"
    if unit is not None:
        cell = f'{{ column = "{head}", unit = "{unit}" }}'
        assert f"write yaw_rad = {cell}" in refused(tmp_path, mapping.format(f'"{head}"'), log=log)
    assert np.degrees(column(tmp_path, "ahrs.yaw_rad", mapping.format(cell), log=log)) == pytest.approx(expected)


@for_all(special=["999", "-9999"], header=["Heading [deg]", "heading"])
def test_a_special_value_of_an_angle_is_no_unit(special: str, header: str, tmp_path: Path) -> None:
    log = f"time,{header}\n0,10\n1,350\n2,{special}\n3,{special}\n4,12\n"
    ahrs = '[ahrs]\ntime_s = "time"\nroll_rad = 0\npitch_rad = 0\nyaw_rad = '
    said = refused(tmp_path, f'{ahrs}"{header}"\n', log=log)
    assert re.search(rf"is {special} in 2 rows.*write `missing = {special}` in \[ahrs\]", said)
    cured = f'{ahrs}{{ column = "{header}", unit = "deg" }}\nmissing = {special}\n'
    assert column(tmp_path, "ahrs.time_s", cured, log=log) == [0, 1, 4]


UNITS = cases(r"""
t [s];z [furlong] | "t [s]" | "z [furlong]" | :3: 'z [furlong]' is in furlong, an unknown unit; z_m is a length, m
t [s];z [nautical miles] | "t [s]" | "z [nautical miles]" | is in nautical miles, an unknown unit
t;z\ns;furlong | "t" | "z" | :3: 'z' is in furlong, an unknown unit
t;z\n[s];[fm] | "t" | "z" | 'z' is in fm, an unknown unit
t [fortnight];z [m] | "t [fortnight]" | "z [m]" | :2: 't [fortnight]' is in fortnight, an unknown unit; time_s is a time
t;z\nfortnight;m | "t" | "z" | :2: 't' is in fortnight, an unknown unit
t;size_deg | "t" | "size_deg" | 'size_deg' is in deg, angle; z_m is a length, m; write z_m =
t;depth_m_s | "t" | "depth_m_s" | 'depth_m_s' is in m/s, velocity; z_m is a length
t;depth\ns;rad | "t" | "depth" | 'depth' is in rad, angle; z_m is a length
depth_mm;z | "depth_mm" | "z" | 'depth_mm' is in mm, length; time_s is a time, s; write time_s =
""")


@for_all(case=UNITS)
def test_another_or_unknown_unit_is_refused_and_not_taken_for_that_of_the_mission(
    case: list[str], tmp_path: Path
) -> None:
    """The line that is printed is the cure; a draft of an unknown unit is refused as well."""
    head, time, column, sentence = case
    mapping, log = f"[depth]\ntime_s = {time}\nz_m = {column}\n", head + "\n0;1\n1;2\n"
    said = refused(tmp_path, mapping, log=log)
    assert sentence in said
    key, written = said.split("; write ")[1].split(" if it is")[0].split(" = ", 1)
    cured = "".join(f"{key} = {written}\n" if line.startswith(key) else f"{line}\n" for line in mapping.splitlines())
    rows = table(imported(tmp_path, cured, log=log), "depth")
    assert (rows["time_s"].tolist(), rows["z_m"].tolist()) == ([0.0, 1.0], [1.0, 2.0])
    if "unknown" in sentence:
        draft = drafted(tmp_path, log=log).split("[noise]")[0]
        assert "an unknown unit" in refused(tmp_path, draft, log=log)


@for_all(head=["t (UTC)", "t [Unix time]", "time [GPS]", "t [s]"])
def test_the_clock_of_a_time_is_no_unit(head: str, tmp_path: Path) -> None:
    mapping = f'[depth]\ntime_s = "{head}"\nz_m = "z"\n'
    assert column(tmp_path, "depth.time_s", mapping, log=f"{head},z\n0,1\n1,2\n") == [0, 1]


def test_a_draft_takes_the_units_of_their_row(tmp_path: Path) -> None:
    log = "time,depth\ns,cm\n0,100\n1,200\n"
    assert column(tmp_path, "depth.z_m", drafted(tmp_path, log=log).split("[noise]")[0], log=log) == [1, 2]


EXTREMES = ("1e300", "-1e300", "inf", "nan", "9223372036854775808", "-9223372036854775809", "1" + 400 * "0", "1e-300")
NUMBERS = """\
time_zero = {}\\n[depth]\\ntime_s = "t [s]"\\nz_m = "z [m]"
[depth]\\ntime_s = {{ column = "date", offset = {} }}\\nz_m = "z [m]"
[depth]\\ntime_s = {{ column = "t [s]", offset = {} }}\\nz_m = {{ column = "z [m]", offset = {} }}
[depth]\\ntime_s = {{ column = "t [s]", scale = {} }}\\nz_m = {{ column = "z [m]", scale = {} }}
[depth]\\ntime_s = {{ row = {} }}\\nz_m = "z [m]"
[depth]\\nskip = {}\\ntime_s = "t [s]"\\nz_m = "z [m]"
[depth]\\nmissing = {}\\ntime_s = "t [s]"\\nz_m = {}
[ahrs]\\ntime_s = "t [s]"\\nroll_rad = {}\\npitch_rad = 0\\nyaw_rad = 0
[origin]\\nlat_deg = {}\\nlon_deg = {}
"""


@for_all(mapping=NUMBERS.splitlines(), number=EXTREMES)
def test_a_number_of_any_size_is_used_or_refused(mapping: str, number: str, tmp_path: Path) -> None:
    """Never another exception: dates and whole numbers overflow where other numbers do not."""
    text = mapping.replace("\\n", "\n").replace("{}", number).replace("{{", "{").replace("}}", "}") + "\n"
    log = "t [s],z [m],date\n1600000000,1,2022-08-15 09:59:38\n1600000001,2,2022-08-15 09:59:39\n"
    with suppress(GraphFileError):
        imported(tmp_path, text, log=log)


WORLD = {"NED": lambda v: v, "ENU": lambda v: v[[1, 0, 2]] * [1, 1, -1], "NWU": lambda v: v * [1, -1, -1]}
BODY = {"FRD": lambda v: v, "FLU": lambda v: v * [1, -1, -1]}


def pose(columns: dict[str, Array]) -> Array:
    return euler.to_se3([float(columns[name][0]) for name in (*ANGLES, *PLACE)])


@for_all(world=list(WORLD), body=list(BODY))
def test_a_point_on_the_body_is_where_it_was(world: str, body: str) -> None:
    """A point seen from the body lies at the same place of the world, whichever axes it is written in."""
    columns = dict(zip((*ANGLES, *PLACE), np.array([[0.3], [-0.4], [2.0], [5.0], [-7.0], [3.0]]), strict=True))
    turned = turn("truth", columns, f"{world}/{body}")
    point = np.array([1.0, 0.5, -0.2])
    before = SE3.act(pose(columns), point)
    after = SE3.act(pose(turned), BODY[body](point))
    assert after == pytest.approx(WORLD[world](before))


def test_a_mounting_turns_with_the_axes_of_the_body() -> None:
    mount = dict(zip((*ANGLES, *PLACE), np.array([[0.3], [-0.4], [2.0], [5.0], [-7.0], [3.0]]), strict=True))
    turned = turn("dvl_mount", mount, "FLU")
    v = np.array([1.0, 0.5, -0.2])
    assert SE3.act(pose(turned), BODY["FLU"](v)) == pytest.approx(BODY["FLU"](SE3.act(pose(mount), v)))


def test_sigmas_and_lone_angles() -> None:
    one = np.ones(1)
    fix = turn("fixes", {"x_m": one, "y_m": 2 * one, "sigma_x_m": 3 * one, "sigma_y_m": 4 * one}, "ENU")
    assert [float(fix[name][0]) for name in ("x_m", "y_m", "sigma_x_m", "sigma_y_m")] == [2, 1, 4, 3]
    place = {"x_m": one, "y_m": one, "yaw_rad": 0.2 * one}
    assert turn("anchor", place, "ENU")["yaw_rad"] == pytest.approx(np.pi / 2 - 0.2)
    assert turn("odometry", place, "ENU") == {"x_m": one, "y_m": -one, "yaw_rad": pytest.approx([-0.2])}
    with pytest.raises(OptionError, match="together"):
        turn("zpr", {"z_m": one, "pitch_rad": one}, "ENU/FRD")
    with pytest.raises(OptionError, match="a y_m beside x_m"):
        turn("fixes", {"x_m": one}, "ENU")


def test_rotations_of_both_kinds() -> None:
    rpy = np.array([[0.1, -0.2, 3.0]])
    q = euler.to_se3(np.column_stack([rpy, np.zeros((1, 3))]))[:, 3:]
    R = np.stack([SE3.act(np.r_[0, 0, 0, q[0]], axis) for axis in np.eye(3)], axis=1)
    assert angles_of("quaternion", q) == pytest.approx(rpy)
    assert angles_of("rotation", R.reshape(1, 9)) == pytest.approx(rpy)


def test_no_rotation_is_refused_with_its_line(tmp_path: Path) -> None:
    mapping = 'ahrs = { time_s = "t", quaternion = ["a", "b", "c", "d"] }'
    for numbers in ("0,0,0,2", "1e200,0,0,1", "0,-1e300,0,0"):
        said = refused(tmp_path, mapping, log=f"t,a,b,c,d\n0,0,0,0,1\n1,{numbers}\n")
        assert re.search(r"log\.csv:3: quaternion .* is no rotation; is the order", said)
    mapping = 'depth = { frame = "ENU", time_s = "t", z_m = { column = "a", up = true } }'
    assert "up and frame = 'ENU' both say" in refused(tmp_path, mapping, log="t,a\n0,0\n")
