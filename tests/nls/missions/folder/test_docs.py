"""The page on formats: the mission it shows is read and solved, and it names every file and column there is."""

from __future__ import annotations

from pathlib import Path

import pytest

from nls.cli import main
from nls.missions.files import MAP, TRAJECTORY
from nls.missions.folder.columns import COLUMNS, POSE
from tests.nls.io.formats_page import columns_of, files_of, section, shown_tables
from tests.nls.missions.folder.mission_files import TINY, folder

TITLE = "Mission folders"


@pytest.mark.usefixtures("undrawn")
def test_the_folder_it_shows_is_solved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = shown_tables(section(TITLE))
    assert shown == TINY
    assert main(["solve", str(folder(tmp_path / "m", shown)), "-o", str(tmp_path / "out")]) == 0
    outputs, more = section(TITLE).split("it writes into")[1].split("Where the mission says more")
    assert {path.name for path in (tmp_path / "out").iterdir()} == files_of(outputs)
    assert "converged" in capsys.readouterr().out

    charted = folder(tmp_path / "charted", shown | {"origin": "lat_deg,lon_deg\n54.1,10.2\n"})
    assert main(["solve", str(charted), "-o", str(tmp_path / "chart")]) == 0
    added = {path.name for path in (tmp_path / "chart").iterdir()} - files_of(outputs)
    assert added == files_of(more) - {"beacons.csv", "calibration.csv"} == {"track.geojson", "track.kml"}


def test_every_file_and_column_is_defined_and_no_other() -> None:
    columns = columns_of(section(TITLE).split("A whole mission")[0])
    assert columns == {name: list(names) for name, names in COLUMNS.items()}


def test_the_columns_of_the_outputs() -> None:
    text = section(TITLE).split("it writes into")[1]
    assert TRAJECTORY[0] == "i"
    assert TRAJECTORY[:7] == POSE
    assert (TRAJECTORY[7], TRAJECTORY[-1]) == ("sigma_roll_rad", "sigma_z_m")
    for name in (*TRAJECTORY[7::5], *MAP[:5], *MAP[9:]):
        assert f"`{name}`" in text, name
