"""The page on formats: the mission it shows is read and solved, and it names every file and column there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from nls.cli import main
from nls.io.mission.columns import COLUMNS, POSE
from nls.io.mission.results import MAP, TRAJECTORY
from tests.nls.io.mission.mission_files import TINY, folder

PAGE = Path(__file__).parents[4] / "docs" / "formats.md"


def section() -> str:
    """The part of the page on mission folders."""
    if not PAGE.exists():
        pytest.skip("there is no docs/formats.md here (an installed copy has none)")
    return PAGE.read_text(encoding="utf-8").split("\n## Mission folders\n")[1].split("\n## ")[0]


def test_the_folder_it_shows_is_solved(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = dict(re.findall(r"^`(\w+)\.csv`\n\n```text\n(.*?)^```$", section(), re.M | re.S))
    assert shown == TINY
    assert main(["solve", str(folder(tmp_path / "m", shown)), "-o", str(tmp_path / "out")]) == 0
    outputs, more = section().split("it writes into")[1].split("Where the mission says more")
    assert {path.name for path in (tmp_path / "out").iterdir()} == files(outputs)
    assert "converged" in capsys.readouterr().out

    charted = folder(tmp_path / "charted", shown | {"origin": "lat_deg,lon_deg\n54.1,10.2\n"})
    assert main(["solve", str(charted), "-o", str(tmp_path / "chart")]) == 0
    added = {path.name for path in (tmp_path / "chart").iterdir()} - files(outputs)
    assert added == files(more) - {"beacons.csv", "calibration.csv"} == {"track.geojson", "track.kml"}


def files(text: str) -> set[str]:
    """The files in the first column of a table."""
    return set(re.findall(r"^\| `(\w+\.\w+)` \|", text, re.M))


def test_every_file_and_column_is_defined_and_no_other() -> None:
    found: dict[str, list[str]] = {}
    for row in re.findall(r"^\|([^|]*)\|([^|]*)\|.*\|$", section().split("A whole mission")[0], re.M):
        file = re.findall(r"`([\w-]+)\.csv`", row[0]) or [list(found)[-1] if found else ""]
        found.setdefault(file[0], []).extend(re.findall(r"`(\w+)`", row[1]))
    found.pop("")  # the heads of the tables
    assert found == {name: list(columns) for name, columns in COLUMNS.items()}


def test_the_columns_of_the_outputs() -> None:
    text = section().split("it writes into")[1]
    assert TRAJECTORY[0] == "i"
    assert TRAJECTORY[:7] == POSE
    assert (TRAJECTORY[7], TRAJECTORY[-1]) == ("sigma_roll_rad", "sigma_z_m")
    for name in (*TRAJECTORY[7::5], *MAP[:5], *MAP[9:]):
        assert f"`{name}`" in text, name
