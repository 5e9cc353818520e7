"""Cells that stand for none, rows of units, and rows that are not read."""

from __future__ import annotations

from pathlib import Path

import pytest

from nls import GraphFileError
from tests.combinations import for_all
from tests.nls.missions.importing.logs import imported, table

LOG = "t,v [mm/s],z [cm]\n0,1500,--.--\n1,-32768,20\n2,NA!,-9999.0\n3,1400,30\n4,1300,40\n"
DVL = '[dvl]\ntime_s = "t"\nvelocity = [{v}, 0, 0]\n'
DEPTH = '[depth]\ntime_s = "t"\nz_m = {z}\n'


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
    assert table(imported(tmp_path, case[0], log=LOG), "dvl")["valid"].tolist() == case[1]


def test_missing_words_of_flags_and_times(tmp_path: Path) -> None:
    mapping = DVL.format(v=1) + 'valid = { column = "ok", missing = 255 }\nmissing = { time_s = "?" }'
    rows = table(imported(tmp_path, mapping, log="t,ok\n0,1\n?,1\n2,255.0\n3,0\n4,1\n"), "dvl")
    assert (rows["time_s"].tolist(), rows["valid"].tolist()) == ([0, 2, 3, 4], [1, 0, 0, 1])


def test_the_refusal_of_a_word_is_cured_by_its_own_line(tmp_path: Path) -> None:
    with pytest.raises(GraphFileError, match=r"log\.csv:2: z \[cm\]: '--\.--' is not a number") as error:
        imported(tmp_path, DEPTH.format(z='"z [cm]"'), log=LOG)
    line = str(error.value).split("in the mapping write ")[1].split(" where")[0]
    rows = table(imported(tmp_path, DEPTH.format(z='"z [cm]"') + line + "\n", log=LOG), "depth")
    assert rows["z_m"].tolist() == pytest.approx([0.2, -99.99, 0.3, 0.4])


def test_rows_are_taken_before_their_numbers_are_read(tmp_path: Path) -> None:
    """Words of a test before and after the dive do not matter, and lines are those of the file."""
    log = "t,z\nstart,x\n0,1\n1,\n2,3\nend,y\n"
    result = imported(tmp_path, DEPTH.format(z='"z"') + "rows = [1, -1]\n", log=log)
    assert table(result, "depth")["time_s"].tolist() == [0, 2]
    assert "depth: 1 row of 3 without a number, log.csv:4 the first: left out" in result.notes
    with pytest.raises(GraphFileError, match=r"log\.csv:6: t: 'end' is not a number"):
        imported(tmp_path, DEPTH.format(z='"z"') + "rows = [1]\n", log=log)


@for_all(units=["s,cm,degrees_north", "[s],(cm),deg", ",cm,"])
def test_a_row_of_units_is_read(units: str, tmp_path: Path) -> None:
    result = imported(tmp_path, DEPTH.format(z='"z"'), log=f"t,z,lat\n{units}\n0,250,47\n1,260,47\n")
    assert table(result, "depth")["z_m"].tolist() == pytest.approx([2.5, 2.6])
    assert "log.csv:2 is taken for a row of units" in result.notes


def test_a_row_of_other_words_is_left_out_by_the_line_that_the_refusal_says(tmp_path: Path) -> None:
    log = "t,z\nclock,furlong\n0,1\n1,2\n"
    with pytest.raises(GraphFileError, match=r"log\.csv:2: .* or rows = \[1\] for a row of units"):
        imported(tmp_path, DEPTH.format(z='"z"'), log=log)
    assert table(imported(tmp_path, DEPTH.format(z='"z"') + "rows = [1]\n", log=log), "depth")["z_m"].tolist() == [1, 2]


@for_all(
    case=[
        ("missing_together = { attitude = 0 }", [1, 2, 4]),
        ("missing_together = { roll_rad = 0, yaw_rad = [0, 90] }", [1, 2]),
        ("missing_together = { yaw_rad = 0 }", [1, 4]),
        ('missing_together = { attitude = 0, time_s = "0" }', [1, 2, 3, 4]),
        ('missing_together = { yaw_rad = "n/o", roll_rad = 0 }', [0, 1, 2, 3, 4]),
    ]
)
def test_zeros_that_stand_for_none_together(case: tuple[str, list[int]], tmp_path: Path) -> None:
    """A zero beside other numbers stays one, and a constant counts as such."""
    log = "t,r [deg],y [deg]\n0,0,0\n1,0.1,90\n2,0.1,0\n3,-0.0,0.00\n4,0,90\n"
    for columns in ('attitude = ["r [deg]", 0, "y [deg]"]', 'roll_rad = "r [deg]"\npitch_rad = 0\nyaw_rad = "y [deg]"'):
        result = imported(tmp_path, f'[ahrs]\ntime_s = "t"\n{columns}\n{case[0]}\n', log=log)
        assert table(result, "ahrs")["time_s"].tolist() == case[1]
        assert any("ahrs: " in note and "left out" in note for note in result.notes) == (len(case[1]) < 5)


def test_a_place_a_velocity_and_a_quaternion_of_zeros(tmp_path: Path) -> None:
    """The first row with a place is the origin; a DVL keeps its row; numbers of a quaternion may be 0 each."""
    log = "t,a,b,c,d\n0,0,0,0,0\n1,0,0,0,1\n2,54.1,10.2,0,0\n"
    fixes = '[fixes]\ntime_s = "t"\nlat_deg = "a"\nlon_deg = "b"\nsigma_x_m = 1\nsigma_y_m = 1\n'
    result = imported(tmp_path, fixes + "missing_together = { lat_deg = 0, lon_deg = 0 }\n", log=log)
    assert table(result, "origin")["lat_deg"].tolist() == [54.1]
    dvl = '[dvl]\ntime_s = "t"\nvelocity = ["a", "b", "d"]\nmissing_together = { velocity = 0 }\n'
    assert table(imported(tmp_path, dvl, log=log), "dvl")["valid"].tolist() == [0, 1, 1]
    ahrs = '[ahrs]\ntime_s = "t"\nquaternion = ["a", "b", "c", "d"]\nmissing_together = { quaternion = 0 }\n'
    result = imported(tmp_path, ahrs + "rows = [0, 2]\n", log=log)
    assert table(result, "ahrs")["time_s"].tolist() == [1]
