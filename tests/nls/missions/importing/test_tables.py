"""Columns of a log as columns of a mission: units, flags, order, cells for none; what a refusal says to write."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import pytest

from tests.combinations import for_all
from tests.nls.io.g2o_files import cases
from tests.nls.missions.importing.logs import column, imported, refused, table

SONAR = (
    "name = 1\nbeams = 9\nbins = 9\naperture_rad = 0.3\nrange_min_m = 1\nrange_max_m = 9\n"
    "position = [0, 0, 0]\nattitude = [0, 0, 0]\n"
)

# a column, the rest of its section, the log, the numbers of the column
COLUMNS = cases(r"""
dvl.vx_m_s | velocity = ["v [mm/s]", 0, 0] | t,v [mm/s]\n0,1500 | 1.5
dvl.vx_m_s | velocity = ["v_cm_s", 0, 0] | t,v_cm_s\n0,150 | 1.5
dvl.vx_m_s | velocity = ["v (kn)", 0, 0] | t,v (kn)\n0,10 | 5.144444444444445
dvl.vx_m_s | velocity = [{ column = "v", unit = "km/h" }, 0, 0] | t,v\n0,36 | 10
dvl.vx_m_s | velocity = [{ column = "v", unit = "ft/s", sign = -1, offset = 1 }, 0, 0] | t,v\n0,10 | -2.048
dvl.vx_m_s | velocity = [{ column = "v", scale = 2, offset = 0.5 }, 0, 0] | t,v\n0,10 | 20.5
ahrs.pitch_rad | attitude = [0, "p [deg]", 0] | t,p [deg]\n0,358.5 | -0.02617993877991494
ahrs.yaw_rad | attitude = [0, 0, "y [deg]"] | t,y [deg]\n0,270 | -1.5707963267948966
depth.z_m | z_m = "z_m" | t	z_m\n0	2\n1	3 | 2 3
depth.z_m | z_m = "z_m" | t  z_m\n0  2\n1  3 | 2 3
depth.z_m | z_m = "z_m" | t , z_m\n0 , 2\n1 , 3 | 2 3
depth.z_m | z_m = "3"\nheader = false\nskip = 1\ntime_s = "1" | t,z,z\n0,1,2 | 2
depth.z_m | z_m = { column = "height [cm] (filtered)", up = true } | t,height [cm] (filtered)\n0,100\n1,200 | -1 -2
ranges.range_m | beacon = 1\nrange_m = "range_1"\nsigma_range_m = 1 | t,range_1\n0,5\n1,6 | 5 6
dvl.valid | velocity = [1, 0, 0]\nvalid = "ok" | t,ok\n0,1\n1,0.0\n2,true\n3,FALSE\n4, | 1 0 1 0 0
dvl.valid | velocity = [1, 0, 0]\nvalid = { column = "ok", equals = "A" } | t,ok\n0,A\n1,V\n2,a\n3,\n4,B | 1 0 1 0 0
dvl.valid | velocity = [1, 0, 0]\nvalid = { column = "ok", above = 2 } | t,ok\n0,3\n1,2\n2,4\n3,nan\n4,0 | 1 0 1 0 0
dvl.valid | velocity = [1, 0, 0]\nvalid = { column = "ok", equals = 2 } | t,ok\n0,2\n1,2.0\n2,4\n3,nan\n4,0 | 1 1 0 0 0
dvl.valid | velocity = [1, 0, 0]\nsigma_v_m_s = "s"\nvalid = "lock" | t,s,lock\n0,1,1\n1,-1,0 | 1 0
dvl.altitude_m | velocity = ["v", 0, 0]\nbeams = "b"\naltitude_m = "h" | t,v,b,h\n0,1,4,9\n1,,,\n2,1,, | 9 0 0
fixes.time_s | x_m = 0\ny_m = 0\nsigma_x_m = 1\nsigma_y_m = 1 | t,z\n0,\n1,5 | 0 1
""")


@for_all(case=COLUMNS)
def test_columns_of_a_log_as_those_of_a_mission(case: list[str], tmp_path: Path) -> None:
    """Units by name, header or mapping; angles are wrapped; flags; a DVL without lock may have empty cells anywhere."""
    name, section, log, numbers = case
    time = "" if "time_s" in section else 'time_s = "t"\n'
    made = column(tmp_path, name, f"[{name.split('.')[0]}]\n{time}{section}\n", log=log + "\n")
    assert made == pytest.approx([float(number) for number in numbers.split()], rel=1e-15)


def test_a_unit_nobody_names_is_noted(tmp_path: Path) -> None:
    mapping = '[dvl]\ntime_s = "t"\nvelocity = ["speed", { column = "other", unit = "kn" }, "named [m/s]"]\n'
    notes = imported(tmp_path, mapping, log="t,speed,other,named [m/s]\n0,1,1,1\n").notes
    assert [note for note in notes if "taken to be m/s" in note] == [
        "log.csv: 'speed' names no unit; it is taken to be m/s"
    ]


def test_an_awkward_file(tmp_path: Path) -> None:
    """Gzip, byte-order mark, comments, semicolons, decimal commas, Windows lines, a last separator, Latin-1."""
    text = "# made by a logger\r\n%zeit;tiefe [cm];Temp °C;\r\n0,5;250,5;4,1;\r\n\r\n# pause\r\n1,5;260;4,2;\r\n"
    log = gzip.compress(b"\xef\xbb\xbf" + text.encode("latin-1"))
    rows = table(imported(tmp_path, 'depth = { time_s = "zeit", z_m = "tiefe [cm]" }', log=log), "depth")
    assert (rows["time_s"].tolist(), rows["z_m"].tolist()) == ([0.5, 1.5], [2.505, 2.6])


def test_empty_cells_and_nan(tmp_path: Path) -> None:
    """Rows of depth without a number are left out; those of a DVL stay, without bottom lock."""
    mapping = '[dvl]\ntime_s = "t"\nvelocity = ["v [m/s]", 0, 0]\n[depth]\ntime_s = "t"\nz_m = "z [m]"\n'
    result = imported(tmp_path, mapping, log="t,v [m/s],z [m]\n0,1,5\n1,NaN,6\n2,,\n,1,8\n4,1,9\n")
    dvl, depth = table(result, "dvl"), table(result, "depth")
    assert (dvl["time_s"].tolist(), dvl["valid"].tolist()) == ([0, 1, 2, 4], [1, 0, 0, 1])
    assert depth["time_s"].tolist() == [0, 1, 4]
    assert {
        "dvl: 1 row of 5 without a time, log.csv:5 the first: left out",
        "dvl: 2 rows of 5 without a number, log.csv:3 the first: valid = 0",
        "depth: 1 row of 5 without a number, log.csv:4 the first: left out",
    } <= {*result.notes}


def test_order_of_time(tmp_path: Path) -> None:
    mapping, log = '[depth]\ntime_s = "t"\nz_m = "z"\n', "t,z\n0,1\n2,3\n1,2\n2,4\n"
    assert re.search(r"log\.csv:4: the time falls .* sort = true in \[depth\]", refused(tmp_path, mapping, log=log))
    mapping += "sort = true\n"
    cure = 'log.csv:5: the time is that of the row before; write duplicates = "first"'
    assert cure in refused(tmp_path, mapping, log=log)
    result = imported(tmp_path, mapping + 'duplicates = "first"', log=log)
    assert table(result, "depth")["z_m"].tolist() == [1, 2, 3]
    assert "depth: sorted by time; 1 row came before the one above" in result.notes
    assert "depth: 1 row with the time of the one before, log.csv:5 the first: left out" in result.notes


def test_a_constant_in_degrees_is_refused_with_its_line(tmp_path: Path) -> None:
    said = refused(tmp_path, "[sonar]\nfan_rad = 120\n" + SONAR)
    assert re.search(r"mapping\.toml:2: fan_rad is 120; .* in degrees\? write fan_rad = 2\.094", said)
    assert column(tmp_path, "sonar.fan_rad", "[sonar]\nfan_rad = 2.1\n" + SONAR) == [2.1]


def test_a_sigma_that_cannot_be_has_its_line_unless_it_stands_for_none(tmp_path: Path) -> None:
    fixes, log = "fixes = {{ time_s = 't', x_m = 0, y_m = 0, sigma_x_m = {}, sigma_y_m = 1 }}", "t,acc [m]\n0,2\n1,-1\n"
    said = refused(tmp_path, fixes.format("'acc [m]'"), log=log)
    assert re.search(r"log\.csv:3: 'acc \[m\]' makes sigma_x_m -1.0; expected .* above 0", said)
    mapping = fixes.format("{ column = 'acc [m]', missing = -1 }")
    assert column(tmp_path, "fixes.sigma_x_m", mapping, log=log) == [2]


def test_dates(tmp_path: Path) -> None:
    """A date and a time in two columns, no zone; a date that is none has its line."""
    mapping, log = (
        'depth = { time_s = { column = ["date", "time"] }, z_m = "z_m" }',
        "date,time,z_m\n2024-02-28,23:59:59,1\n",
    )
    result = imported(tmp_path, mapping, log=log + "2024-02-29,00:00:00.5,2\n")
    assert table(result, "depth")["time_s"].tolist() == [0, 1.5]
    assert "log.csv: 'time' names no zone; its times are taken to be UTC" in result.notes
    for wrong in ("2023-02-29", "29.02.2024"):
        assert "log.csv:3: " in refused(tmp_path, mapping, log=f"{log}{wrong},10:00:00,1\n")


def test_fixes_without_a_depth_stay_where_no_depth_is_mapped(tmp_path: Path) -> None:
    mapping = 'fixes = { time_s = "t", x_m = 0, y_m = 0, sigma_x_m = 1, sigma_y_m = 1, z_m = "z", sigma_z_m = 1 }'
    note = "fixes: 1 row of 2 without a number, log.csv:2 the first: left out; their places stay where z_m is in "
    assert any(said.startswith(note) for said in imported(tmp_path, mapping, log="t,z\n0,\n1,5\n").notes)


def test_a_quaternion_of_zeros_is_cured_by_the_line_that_is_printed(tmp_path: Path) -> None:
    mapping, log = '[ahrs]\ntime_s = "t"\nquaternion = ["a", "b", "c", "d"]\n', "t,a,b,c,d\n0,0,0,0,0\n1,0,0,0,1\n"
    cure = re.search(r"write `(missing_together = .*)` in \[ahrs\] of the mapping", refused(tmp_path, mapping, log=log))
    assert cure is not None
    assert column(tmp_path, "ahrs.time_s", mapping + cure[1], log=log) == [1]


LOG = "t,v [mm/s],z [cm]\n0,1500,--.--\n1,-32768,20\n2,NA!,-9999.0\n3,1400,30\n4,1300,40\n"
DVL = '[dvl]\ntime_s = "t"\nvelocity = [{v}, 0, 0]\n'
DEPTH = '[depth]\ntime_s = "t"\nz_m = "z"\n'


@for_all(
    case=[
        (DVL.format(v='{ column = "v [mm/s]", missing = [-32768, "NA!"] }'), [1, 0, 0, 1, 1]),
        (DVL.format(v='"v [mm/s]"') + 'missing = ["na!", -32768.0]\n', [1, 0, 0, 1, 1]),
        (DVL.format(v='"v [mm/s]"') + 'missing = { velocity = ["NA!", -32768] }\n', [1, 0, 0, 1, 1]),
        (DVL.format(v='"v [mm/s]"') + 'missing = { vx_m_s = ["NA!", 1500], time_s = 4 }\n', [0, 1, 0, 1]),
        ('missing = ["NA!", -32768]\n' + DVL.format(v='{ column = "v [mm/s]", missing = "NA!" }'), [1, 1, 0, 1, 1]),
    ]
)
def test_numbers_and_words_that_stand_for_none(case: tuple[str, list[int]], tmp_path: Path) -> None:
    """Compared as the log has them, before units; the narrower place wins."""
    assert column(tmp_path, "dvl.valid", case[0], log=LOG) == case[1]


def test_missing_words_of_flags_and_times(tmp_path: Path) -> None:
    mapping = DVL.format(v=1) + 'valid = { column = "ok", missing = 255 }\nmissing = { time_s = "?" }'
    rows = table(imported(tmp_path, mapping, log="t,ok\n0,1\n?,1\n2,255.0\n3,0\n4,1\n"), "dvl")
    assert (rows["time_s"].tolist(), rows["valid"].tolist()) == ([0, 2, 3, 4], [1, 0, 0, 1])


def test_the_refusal_of_a_word_is_cured_by_its_own_line(tmp_path: Path) -> None:
    mapping = DEPTH.replace('"z"', '"z [cm]"')
    said = refused(tmp_path, mapping, log=LOG)
    assert "log.csv:2: z [cm]: '--.--' is not a number" in said
    cured = mapping + said.split("in the mapping write ")[1].split(" where")[0] + "\n"
    assert column(tmp_path, "depth.z_m", cured, log=LOG) == pytest.approx([0.2, -99.99, 0.3, 0.4])


def test_rows_are_taken_before_their_numbers_are_read(tmp_path: Path) -> None:
    """Words of a test before and after the dive do not matter, and lines are those of the file."""
    log = "t,z\nstart,x\n0,1\n1,\n2,3\nend,y\n"
    result = imported(tmp_path, DEPTH + "rows = [1, -1]\n", log=log)
    assert table(result, "depth")["time_s"].tolist() == [0, 2]
    assert "depth: 1 row of 3 without a number, log.csv:4 the first: left out" in result.notes
    assert "log.csv:6: t: 'end' is not a number" in refused(tmp_path, DEPTH + "rows = [1]\n", log=log)


@for_all(units=["s,cm,degrees_north", "[s],(cm),deg", ",cm,"])
def test_a_row_of_units_is_read(units: str, tmp_path: Path) -> None:
    result = imported(tmp_path, DEPTH, log=f"t,z,lat\n{units}\n0,250,47\n1,260,47\n")
    assert table(result, "depth")["z_m"].tolist() == pytest.approx([2.5, 2.6])
    assert "log.csv:2 is taken for a row of units" in result.notes


def test_a_row_of_other_words_is_left_out_by_the_line_that_the_refusal_says(tmp_path: Path) -> None:
    log = "t,z\nclock,furlong\n0,1\n1,2\n"
    said = refused(tmp_path, DEPTH, log=log)
    assert "log.csv:2: " in said
    assert said.split("; ")[-1].startswith(
        "in the mapping write missing = 'clock' where it stands for none, or rows = [1]"
    )
    assert column(tmp_path, "depth.z_m", DEPTH + "rows = [1]\n", log=log) == [1, 2]


@for_all(
    case=[
        ("missing_together = { attitude = 0 }", [1, 2, 4]),
        ("missing_together = { roll_rad = 0, yaw_rad = [0, 90] }", [1, 2]),
        ("missing_together = { yaw_rad = 0 }", [1, 4]),
        ('missing_together = { attitude = 0, time_s = "0" }', [1, 2, 3, 4]),
        ('missing_together = { yaw_rad = "n/o", roll_rad = 0 }', [0, 1, 2, 3, 4]),
    ],
    columns=['attitude = ["r [deg]", 0, "y [deg]"]', 'roll_rad = "r [deg]"\npitch_rad = 0\nyaw_rad = "y [deg]"'],
)
def test_zeros_that_stand_for_none_together(case: tuple[str, list[int]], columns: str, tmp_path: Path) -> None:
    """A zero beside other numbers stays one, and a constant counts as such."""
    log = "t,r [deg],y [deg]\n0,0,0\n1,0.1,90\n2,0.1,0\n3,-0.0,0.00\n4,0,90\n"
    result = imported(tmp_path, f'[ahrs]\ntime_s = "t"\n{columns}\n{case[0]}\n', log=log)
    assert table(result, "ahrs")["time_s"].tolist() == case[1]
    assert any("ahrs: " in note and "left out" in note for note in result.notes) == (len(case[1]) < 5)


@for_all(
    case=[
        ("fixes.time_s", 'lat_deg = "a"\nlon_deg = "b"\nsigma_x_m = 1\nsigma_y_m = 1', "lat_deg = 0, lon_deg = 0", [2]),
        ("dvl.valid", 'velocity = ["a", "b", "d"]', "velocity = 0", [0, 1, 1]),
        ("ahrs.time_s", 'quaternion = ["a", "b", "c", "d"]\nrows = [0, 2]', "quaternion = 0", [1]),
    ]
)
def test_a_place_a_velocity_and_a_quaternion_of_zeros(case: tuple[str, str, str, list[int]], tmp_path: Path) -> None:
    """A DVL keeps its row; numbers of a quaternion may be 0 each."""
    name, columns, zeros, expected = case
    mapping = f'[{name.split(".")[0]}]\ntime_s = "t"\n{columns}\nmissing_together = {{ {zeros} }}\n'
    log = "t,a,b,c,d\n0,0,0,0,0\n1,0,0,0,1\n2,54.1,10.2,0,0\n"
    assert column(tmp_path, name, mapping, log=log) == expected
