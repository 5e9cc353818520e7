"""The section on scan missions: the mission it shows is solved, and it names every file, column, key and output."""

from __future__ import annotations

import re
import tomllib
from dataclasses import asdict
from pathlib import Path

from nls.cli import main
from nls.missions.scans import Drift, Verdict
from nls.missions.scans.folder import COLUMNS, SECTIONS, read_settings
from nls.missions.scans.solution import CLOSURES, MAP, TRAJECTORY
from tests.nls.io.formats_page import columns_of, files_of, section, shown_tables
from tests.nls.missions.scans.room_files import room, write

TITLE = "Scan missions"


def test_every_file_and_column_is_defined_and_no_other() -> None:
    columns = columns_of(section(TITLE).split("`mission.toml` says")[0])
    assert columns == {name: list(names) for name, names in COLUMNS.items()}


def test_every_key_is_shown_with_its_default(tmp_path: Path) -> None:
    (text,) = re.findall(r"^```toml\n(.*?)^```$", section(TITLE), re.M | re.S)
    shown = tomllib.loads(text)
    assert {name: tuple(keys) for name, keys in shown.items()} == SECTIONS
    assert shown["drift"] == asdict(Drift())
    (tmp_path / "mission.toml").write_text(text)
    assert read_settings(tmp_path / "mission.toml").side == -1


def test_the_folder_it_shows_is_solved(tmp_path: Path) -> None:
    shown = shown_tables(section(TITLE))
    assert list(shown) == list(COLUMNS)
    write(tmp_path / "m", {name: text.encode() for name, text in shown.items()})
    assert main(["solve", str(tmp_path / "m"), "-o", str(tmp_path / "out")]) == 0
    write(tmp_path / "room", room())
    assert main(["solve", str(tmp_path / "room"), "-o", str(tmp_path / "map")]) == 0
    outputs = section(TITLE).split("it writes into")[1]
    files = files_of(outputs)
    assert {path.name for path in (tmp_path / "map").iterdir()} == files
    assert {path.name for path in (tmp_path / "out").iterdir()} == files - {"closures.csv"}
    for name in (*TRAJECTORY, *MAP, *CLOSURES):
        assert f"`{name}`" in outputs, name
    for verdict in set(Verdict) - {Verdict.ACCEPTED}:
        assert verdict.words in outputs
