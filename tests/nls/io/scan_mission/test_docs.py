"""The section on scan missions: the mission it shows is solved, and it names every file, column, key and output."""

from __future__ import annotations

import re
import tomllib
from dataclasses import asdict
from pathlib import Path

import pytest

from nls.cli import main
from nls.io.scan_mission import COLUMNS
from nls.io.scan_mission.results import CLOSURES, MAP, TRAJECTORY, WORDS
from nls.io.scan_mission.settings import KEYS, read_settings
from nls.sonar.scans import Drift
from tests.nls.io.scan_mission.rooms import room, write

PAGE = Path(__file__).parents[4] / "docs" / "formats.md"


def section() -> str:
    """The part of the page on scan missions."""
    if not PAGE.exists():
        pytest.skip("there is no docs/formats.md here (an installed copy has none)")
    return PAGE.read_text(encoding="utf-8").split("\n## Scan missions\n")[1].split("\n## ")[0]


def test_every_file_and_column_is_defined_and_no_other() -> None:
    columns: dict[str, list[str]] = {}
    for row in re.findall(r"^\|([^|]*)\|([^|]*)\|.*\|$", section().split("`mission.toml` says")[0], re.M):
        file = re.findall(r"`([\w-]+)\.csv`", row[0]) or [list(columns)[-1] if columns else ""]
        columns.setdefault(file[0], []).extend(re.findall(r"`(\w+)`", row[1]))
    columns.pop("")  # the head of the table
    assert columns == {name: list(names) for name, names in COLUMNS.items()}


def test_every_key_is_shown_with_its_default(tmp_path: Path) -> None:
    (text,) = re.findall(r"^```toml\n(.*?)^```$", section(), re.M | re.S)
    shown = tomllib.loads(text)
    assert {name: tuple(keys) for name, keys in shown.items()} == KEYS
    assert shown["drift"] == asdict(Drift())
    (tmp_path / "mission.toml").write_text(text)
    assert read_settings(tmp_path / "mission.toml").side == -1


def test_the_folder_it_shows_is_solved(tmp_path: Path) -> None:
    shown = dict(re.findall(r"^`(\w+)\.csv`\n\n```text\n(.*?)^```$", section(), re.M | re.S))
    assert list(shown) == list(COLUMNS)
    write(tmp_path / "m", {name: text.encode() for name, text in shown.items()})
    assert main(["solve", str(tmp_path / "m"), "-o", str(tmp_path / "out")]) == 0
    write(tmp_path / "room", room())
    assert main(["solve", str(tmp_path / "room"), "-o", str(tmp_path / "map")]) == 0
    outputs = section().split("it writes into")[1]
    files = set(re.findall(r"^\| `(\w+\.\w+)` \|", outputs, re.M))
    assert {path.name for path in (tmp_path / "map").iterdir()} == files
    assert {path.name for path in (tmp_path / "out").iterdir()} == files - {"closures.csv"}
    for name in (*TRAJECTORY, *MAP, *CLOSURES):
        assert f"`{name}`" in outputs, name
    for words in WORDS.values():
        assert words in outputs
