"""Columns of a log as columns of a mission: units, flags, empty cells, order; and what a refusal says to write."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from nls import GraphFileError
from tests.combinations import for_all
from tests.nls.missions.importing.logs import imported, table

SONAR = (
    "name = 1\nbeams = 9\nbins = 9\naperture_rad = 0.3\nrange_min_m = 1\nrange_max_m = 9\n"
    "position = [0, 0, 0]\nattitude = [0, 0, 0]\n"
)
DVL = '[dvl]\ntime_s = "t [s]"\nvx_m_s = {vx}\nvy_m_s = 0\nvz_m_s = 0\n'


@for_all(
    case=[
        ("v [mm/s]", '"v [mm/s]"', "1500", 1.5),
        ("v_cm_s", '"v_cm_s"', "150", 1.5),
        ("v (kn)", '"v (kn)"', "10", 10 * 1852 / 3600),
        ("speed", '{ column = "speed", unit = "km/h" }', "36", 10.0),
        ("speed", '{ column = "speed", unit = "ft/s", sign = -1, offset = 1 }', "10", -2.048),
        ("speed", '{ column = "speed", scale = 2, offset = 0.5 }', "10", 20.5),
    ]
)
def test_units_of_velocities(case: tuple[str, str, str, float], tmp_path: Path) -> None:
    head, cell, word, expected = case
    result = imported(tmp_path, DVL.format(vx=cell), log=f"t [s],{head}\n0,{word}\n1,{word}\n")
    assert table(result, "dvl")["vx_m_s"] == pytest.approx([expected, expected], rel=1e-15)
    assert not any("taken to be m/s" in note for note in result.notes)


def test_a_unit_nobody_names_is_noted(tmp_path: Path) -> None:
    result = imported(tmp_path, DVL.format(vx='"speed"'), log="t [s],speed\n0,1\n1,1\n")
    assert "log.csv: 'speed' names no unit; it is taken to be m/s" in result.notes


def test_angles_in_degrees_are_wrapped(tmp_path: Path) -> None:
    mapping = 'ahrs = { time_s = "t", attitude = ["r [deg]", "p [deg]", "y [deg]"] }'
    rows = table(imported(tmp_path, mapping, log="t,r [deg],p [deg],y [deg]\n0,3,358.5,270\n"), "ahrs")
    assert [rows[n][0] for n in ("roll_rad", "pitch_rad", "yaw_rad")] == pytest.approx(np.radians([3, -1.5, -90]))


def test_an_awkward_file(tmp_path: Path) -> None:
    """Gzip, byte-order mark, comments, semicolons, decimal commas, Windows lines, a last separator, Latin-1."""
    text = "# made by a logger\r\n%zeit;tiefe [cm];Temp °C;\r\n0,5;250,5;4,1;\r\n\r\n# pause\r\n1,5;260;4,2;\r\n"
    log = gzip.compress(b"\xef\xbb\xbf" + text.encode("latin-1"))
    rows = table(imported(tmp_path, 'depth = { time_s = "zeit", z_m = "tiefe [cm]" }', log=log), "depth")
    assert (rows["time_s"].tolist(), rows["z_m"].tolist()) == ([0.5, 1.5], [2.505, 2.6])


@for_all(sign=["\t", "  ", " , "])
def test_separators(sign: str, tmp_path: Path) -> None:
    log = sign.join(("time_s", "depth_m")) + "\n" + sign.join(("0", "2")) + "\n" + sign.join(("1", "3")) + "\n"
    rows = table(imported(tmp_path, 'depth = { time_s = "time_s", z_m = "depth_m" }', log=log), "depth")
    assert rows["z_m"].tolist() == [2, 3]


def test_empty_cells_and_nan(tmp_path: Path) -> None:
    """Rows of depth without a number are left out; those of a DVL stay, without bottom lock."""
    mapping = DVL.format(vx='"v [m/s]"') + '[depth]\ntime_s = "t [s]"\nz_m = "z [m]"\n'
    result = imported(tmp_path, mapping, log="t [s],v [m/s],z [m]\n0,1,5\n1,NaN,6\n2,,\n,1,8\n4,1,9\n")
    dvl, depth = table(result, "dvl"), table(result, "depth")
    assert (dvl["time_s"].tolist(), dvl["valid"].tolist()) == ([0, 1, 2, 4], [1, 0, 0, 1])
    assert depth["time_s"].tolist() == [0, 1, 4]
    for note in (
        "dvl: 1 row of 5 without a time, log.csv:5 the first: left out",
        "dvl: 2 rows of 5 without a number, log.csv:3 the first: valid = 0",
        "depth: 1 row of 5 without a number, log.csv:4 the first: left out",
    ):
        assert note in result.notes


@for_all(
    case=[
        ('"ok"', ("1", "0.0", "true", "FALSE", ""), [1, 0, 1, 0, 0]),
        ('{ column = "ok", equals = "A" }', ("A", "V", "a", "", "B"), [1, 0, 1, 0, 0]),
        ('{ column = "ok", above = 2 }', ("3", "2", "4", "nan", "0"), [1, 0, 1, 0, 0]),
        ('{ column = "ok", equals = 2 }', ("2", "2.0", "4", "nan", "0"), [1, 1, 0, 0, 0]),
    ]
)
def test_flags(case: tuple[str, tuple[str, ...], list[int]], tmp_path: Path) -> None:
    cell, words, expected = case
    log = "t [s],ok\n" + "".join(f"{k},{word}\n" for k, word in enumerate(words))
    rows = table(imported(tmp_path, DVL.format(vx="1") + f"valid = {cell}\n", log=log), "dvl")
    assert rows["valid"].tolist() == expected


def test_order_of_time(tmp_path: Path) -> None:
    mapping, log = 'depth = {{ time_s = "t", z_m = "z", {} }}', "t,z\n0,1\n2,3\n1,2\n2,4\n"
    for options, problem in (
        ("file = 'log.csv'", r"log\.csv:4: the time falls .* sort = true in \[depth\]"),
        ("sort = true", r"log\.csv:5: the time is that of the row before; write duplicates = \"first\""),
    ):
        with pytest.raises(GraphFileError, match=problem):
            imported(tmp_path, mapping.format(options), log=log)
    result = imported(tmp_path, mapping.format('sort = true, duplicates = "first"'), log=log)
    assert table(result, "depth")["z_m"].tolist() == [1, 2, 3]
    assert "depth: sorted by time; 1 row came before the one above" in result.notes
    assert "depth: 1 row with the time of the one before, log.csv:5 the first: left out" in result.notes


def test_a_constant_in_degrees_is_refused_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(
        GraphFileError, match=r"mapping\.toml:2: fan_rad is 120; .* in degrees\? write fan_rad = 2\.094"
    ):
        imported(tmp_path, "[sonar]\nfan_rad = 120\n" + SONAR)
    assert table(imported(tmp_path, "[sonar]\nfan_rad = 2.1\n" + SONAR), "sonar")["fan_rad"].tolist() == [2.1]


def test_sigmas_of_a_log(tmp_path: Path) -> None:
    """One that cannot be has its line, unless it stands for none; a DVL without bottom lock may say anything."""
    fixes, log = "fixes = {{ time_s = 't', x_m = 0, y_m = 0, sigma_x_m = {}, sigma_y_m = 1 }}", "t,acc [m]\n0,2\n1,-1\n"
    with pytest.raises(GraphFileError, match=r"log\.csv:3: 'acc \[m\]' makes sigma_x_m -1.0; expected .* above 0"):
        imported(tmp_path, fixes.format("'acc [m]'"), log=log)
    result = imported(tmp_path, fixes.format("{ column = 'acc [m]', missing = -1 }"), log=log)
    assert table(result, "fixes")["sigma_x_m"].tolist() == [2]
    dvl = "dvl = { time_s = 't', velocity = [1, 0, 0], sigma_v_m_s = 's', valid = 'lock' }"
    result = imported(tmp_path, dvl, log="t,s,lock\n0,1,1\n1,-1,0\n")
    assert table(result, "dvl")["valid"].tolist() == [1, 0]


def test_dates(tmp_path: Path) -> None:
    """A date and a time in two columns, no zone; a date that is none has its line."""
    mapping = 'depth = { time_s = { column = ["date", "time"] }, z_m = "z_m" }'
    log = "date,time,z_m\n2024-02-29,10:00:00,1\n2024-02-29,10:00:01.5,2\n"
    result = imported(tmp_path, mapping, log=log)
    assert table(result, "depth")["time_s"].tolist() == [0, 1.5]
    assert "log.csv: 'time' names no zone; its times are taken to be UTC" in result.notes
    for wrong in ("2023-02-29", "29.02.2024"):
        with pytest.raises(GraphFileError, match=r"log\.csv:3: "):
            imported(tmp_path, mapping, log="date,time,z_m\n2024-02-28,10:00:00,1\n" + f"{wrong},10:00:00,1\n")


def test_a_dvl_without_lock_may_have_empty_cells_everywhere(tmp_path: Path) -> None:
    mapping = 'dvl = { time_s = "t", velocity = ["v", 0, 0], beams = "b", altitude_m = "h", sigma_v_m_s = "s" }'
    rows = table(imported(tmp_path, mapping, log="t,v,b,h,s\n0,1,4,9,0.1\n1,,,,\n2,1,,,0.1\n"), "dvl")
    assert (rows["valid"].tolist(), rows["altitude_m"].tolist()) == ([1, 0, 0], [9, 0, 0])


def test_fixes_without_a_depth_stay_where_no_depth_is_mapped(tmp_path: Path) -> None:
    mapping = 'fixes = {{ time_s = "t", x_m = 0, y_m = 0, sigma_x_m = 1, sigma_y_m = 1{} }}'
    result = imported(tmp_path, mapping.format(', z_m = "z", sigma_z_m = 1'), log="t,z\n0,\n1,5\n")
    note = "fixes: 1 row of 2 without a number, log.csv:2 the first: left out; their places stay where z_m is in "
    assert any(line.startswith(note) for line in result.notes)
    assert len(table(imported(tmp_path, mapping.format(""), log="t,z\n0,\n1,5\n"), "fixes")["time_s"]) == 2


def test_a_quaternion_of_zeros_is_cured_by_the_line_that_is_printed(tmp_path: Path) -> None:
    mapping, log = '[ahrs]\ntime_s = "t"\nquaternion = ["a", "b", "c", "d"]\n', "t,a,b,c,d\n0,0,0,0,0\n1,0,0,0,1\n"
    with pytest.raises(GraphFileError, match=r"write `missing_together = .* in \[ahrs\] of the mapping") as error:
        imported(tmp_path, mapping, log=log)
    line = str(error.value).split("`")[1]
    assert table(imported(tmp_path, mapping + line, log=log), "ahrs")["time_s"].tolist() == [1]


def test_columns_of_one_name_are_numbered(tmp_path: Path) -> None:
    mapping = 'depth = { time_s = "1", z_m = "3", header = false, skip = 1 }'
    assert table(imported(tmp_path, mapping, log="t,z,z\n0,1,2\n"), "depth")["z_m"].tolist() == [2]
