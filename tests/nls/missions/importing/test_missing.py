"""Cells that stand for none, rows of units, and rows that are not read."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.combinations import for_all
from tests.nls.missions.importing.logs import column, imported, refused, table

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
