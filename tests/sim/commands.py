"""The command line as tests call it: tables, folders that are made again, one line for a mistake, help."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from sim.cli import main

__all__ = ["help_text", "made_again", "refused", "rows", "table"]


def rows(out: str) -> list[tuple[str, str]]:
    return [(line[:14].strip(), line[16:]) for line in out.splitlines()]


def table(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """What a call without a mistake prints."""
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return dict(rows(out))


def made_again(folder: Path, names: list[str], again: Path) -> str:
    """The README of a folder; its command makes the same files."""
    readme = (folder / "README.txt").read_text(encoding="utf-8")
    assert names == [] or sorted(p.name for p in folder.iterdir()) == ["README.txt", *names]
    call = re.search(r"^Made by: nls-sim (.*)$", readme, re.MULTILINE)
    assert call is not None
    assert main([*call[1].split(), "--out", str(again)]) == 0
    for file in (path for path in folder.rglob("*") if path.is_file()):
        assert file.read_bytes() == (again / file.relative_to(folder)).read_bytes()
    return readme.replace("\n", " ")


def refused(arguments: list[str], named: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Status 2 and one line on stderr that holds some words."""
    try:
        code = main(arguments)
    except SystemExit as leave:
        code = int(str(leave.code))
    out, err = capsys.readouterr()
    assert (code, out) == (2, ""), arguments
    assert named in err, arguments
    assert re.fullmatch(r"nls-sim: .*\n", err), arguments


def help_text(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as leave:
        main([*arguments, "--help"])
    assert leave.value.code == 0
    return " ".join(capsys.readouterr().out.split())
