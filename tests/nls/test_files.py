"""Files are written whole or not at all: what was there before survives a disk that is full."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import pytest

from models.errors import GraphFileError
from nls.cli import main
from nls.io.files import read_bytes, write_bytes, write_folder
from tests.nls.disk import small_disk
from tests.nls.g2o_files import PLANE, write
from tests.nls.mission_files import TINY, folder

Captured = pytest.CaptureFixture[str]


def test_a_folder_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    new, old = tmp_path / "a" / "b", tmp_path / "old"
    old.mkdir()
    (old / "1").write_bytes(b"older")
    for place in (new, old):
        with small_disk(100), pytest.raises(GraphFileError, match=r"/2: cannot be written: \w+"):
            write_folder(place, {"1": b"x", "2": b"x" * 101, "3": b"x"})
    assert not (tmp_path / "a").exists()
    assert [(file.name, file.read_bytes()) for file in old.iterdir()] == [("1", b"older")]
    with pytest.raises(GraphFileError, match=r"/none/2: cannot be written: No such file or directory"):
        write_folder(old, {"1": b"x", "none/2": b"x"})
    assert [(file.name, file.read_bytes()) for file in old.iterdir()] == [("1", b"older")]
    for place in (new, old):
        assert write_folder(place, {"1": b"x", "2.gz": b"y"}) == [str(place / "1"), str(place / "2.gz")]
        assert sorted(os.listdir(place)) == ["1", "2.gz"]
        assert ((place / "1").read_bytes(), read_bytes(place / "2.gz")) == (b"x", b"y")


def test_links_and_permissions_stay(tmp_path: Path) -> None:
    file, link = tmp_path / "file", tmp_path / "link.gz"
    file.write_bytes(b"older")
    file.chmod(0o640)
    link.symlink_to(file)
    write_bytes(link, b"newer")
    assert link.is_symlink()
    assert gzip.decompress(file.read_bytes()) == b"newer"
    assert file.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("older", [True, False])
def test_no_output_of_solve_is_half_written(older: bool, tmp_path: Path, capsys: Captured) -> None:
    """All of them are more than 100 bytes; each has an error of its own that names it."""
    file = write(tmp_path, PLANE)
    names = {
        option: tmp_path / f"out{option}.{suffix}"
        for option, suffix in {
            "-o": "g2o.gz",
            "--covariance": "csv",
            "--plot": "png",
            "--report": "html",
            "--json": "json",
        }.items()
    }
    if older:
        for name in names.values():
            name.write_bytes(b"older")
    with small_disk(100):
        assert main(["solve", str(file), *(str(word) for item in names.items() for word in item)]) == 2
    out, err = capsys.readouterr()
    assert "converged" in out
    assert "written" not in out
    lines = err.splitlines()
    assert len(lines) == len(names)
    for name in names.values():
        assert sum(line.startswith(f"nls: {name}: cannot be written: ") for line in lines) == 1
    expected = {file.name: PLANE.encode(), **({name.name: b"older" for name in names.values()} if older else {})}
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == expected


@pytest.mark.parametrize("command", [["convert", "out.tum"], ["plot", "out.png"], ["info", "--json", "out.json"]])
def test_no_output_of_other_commands_is_half_written(command: list[str], tmp_path: Path, capsys: Captured) -> None:
    file, name = write(tmp_path, PLANE), tmp_path / command[-1]
    name.write_bytes(b"older")
    with small_disk(100):
        assert main([command[0], str(file), *command[1:-1], str(name)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"nls: {name}: cannot be written: ")
    assert err.count("\n") == 1
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        file.name: PLANE.encode(),
        name.name: b"older",
    }


def test_the_solution_of_a_mission_has_no_half_file(tmp_path: Path, capsys: Captured) -> None:
    mission, out = folder(tmp_path / "mission", TINY), tmp_path / "solved"
    with small_disk(100):
        assert main(["solve", str(mission), "-o", str(out)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith(f"nls: {out}{os.sep}") and ": cannot be written: " in line for line in lines)
    assert len(lines) >= 3
    assert not out.exists()
