"""Files are written whole or not at all: what was there before survives a disk that is full."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import pytest

from models.errors import GraphFileError
from nls.cli import main
from nls.io.files import read_bytes, read_text, write_bytes, write_folder
from tests.combinations import for_all
from tests.nls.io.disk import small_disk
from tests.nls.io.g2o_files import PLANE, write

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


def test_content_is_on_the_disk_before_it_replaces_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[object] = []
    monkeypatch.setattr(os, "fsync", lambda number: done.append(os.fstat(number).st_size))
    replace = os.replace
    monkeypatch.setattr(os, "replace", lambda old, new: (done.append(Path(new).name), replace(old, new)))
    for size in (3, 7):
        write_bytes(tmp_path / "state", b"x" * size)
    assert done == [3, "state", 7, "state"]


def test_links_and_permissions_stay(tmp_path: Path) -> None:
    file, link = tmp_path / "file", tmp_path / "link.gz"
    file.write_bytes(b"older")
    file.chmod(0o640)
    link.symlink_to(file)
    write_bytes(link, b"newer")
    assert link.is_symlink()
    assert gzip.decompress(file.read_bytes()) == b"newer"
    assert file.stat().st_mode & 0o777 == 0o640
    hard = tmp_path / "hard"
    os.link(file, hard)
    write_bytes(hard, b"newest")
    assert (hard.read_bytes(), gzip.decompress(file.read_bytes())) == (b"newest", b"newer")
    before, target, to_nothing = os.umask(0o027), tmp_path / "target", tmp_path / "to nothing"
    to_nothing.symlink_to(target)
    try:
        write_bytes(to_nothing, b"new")
    finally:
        os.umask(before)
    assert to_nothing.is_symlink()
    assert (target.read_bytes(), target.stat().st_mode & 0o777) == (b"new", 0o640)


@pytest.mark.skipif(not os.path.exists("/dev/fd"), reason="open files have no names here")
def test_an_open_file_is_written_to_where_it_stands(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """As the shell does with a command among others whose output goes to one file: nothing is replaced."""
    log, link = tmp_path / "log", tmp_path / "link"
    log.write_bytes(b"header\n")
    with open(log, "ab") as file:
        names = [f"/dev/fd/{file.fileno()}", f"/proc/self/fd/{file.fileno()}", str(link)]
        link.symlink_to(names[0])
        for name in names:
            write_bytes(name, b"line\n")
        file.write(b"footer\n")
    assert log.read_bytes() == b"header\n" + 3 * b"line\n" + b"footer\n"
    graph = write(tmp_path, PLANE)
    print("before")
    assert main(["convert", str(graph), "/dev/stdout", "--to", "isam"]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert lines[0] == "before"
    assert lines[1].startswith("EDGE2 0 1 ")
    with open(graph, "rb") as file:
        assert main(["convert", str(graph), f"/dev/fd/{file.fileno()}", "--to", "isam"]) == 2
    assert capfd.readouterr().err.endswith("is not possible; expected a number that is open for writing\n")


def test_a_write_protected_file_stays(tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the folder may be written to: as in a shell."""
    file, out, access = write(tmp_path, PLANE), tmp_path / "out.g2o", os.access
    out.write_bytes(b"older")
    out.chmod(0o444)
    monkeypatch.setattr(os, "access", lambda path, mode: str(path) != str(out) and access(path, mode))  # of root, too
    for options in ([], ["--overwrite"]):
        assert main(["solve", str(file), "-o", str(out), *options]) == 2
        err = capsys.readouterr().err
        assert f"{str(out)!r} is not possible; expected a file that is not write-protected; --overwrite does not" in err
    with pytest.raises(
        GraphFileError, match=r"out\.g2o: cannot be written: it is write-protected; allow it with chmod"
    ):
        write_folder(tmp_path, {"other": b"x", "out.g2o": b"newer"})
    assert sorted(os.listdir(tmp_path)) == sorted([file.name, out.name])
    assert out.read_bytes() == b"older"


@for_all(name=["new.g2o/", "new.g2o/."])
def test_the_name_of_a_folder_is_no_file(name: str, tmp_path: Path, capsys: Captured) -> None:
    file, out = write(tmp_path, PLANE), f"{tmp_path}/{name}"
    assert main(["solve", str(file), "-o", out]) == 2
    assert f"{out!r} is not possible; expected a file, and this names a folder" in capsys.readouterr().err
    with pytest.raises(GraphFileError, match="cannot be written: its name is that of a folder"):
        write_bytes(out, b"x")
    assert os.listdir(tmp_path) == [file.name]


@for_all(name=["a.gz", "A.GZ"])
def test_compressed_by_suffix(name: str, tmp_path: Path) -> None:
    write_bytes(tmp_path / name, b"new")
    data = (tmp_path / name).read_bytes()
    assert (data[4:8], gzip.decompress(data)) == (bytes(4), b"new")  # no time: equal content, equal bytes


def test_a_pipe_and_a_device_are_written_to(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_bytes(pipe, b"new")
    assert (os.read(reader, 9), pipe.is_fifo()) == (b"new", True)
    os.close(reader)
    write_bytes(os.devnull, b"new")
    assert Path(os.devnull).is_char_device()


def test_what_cannot_be_written_names_the_file_given(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for name, reason in (("none/out", "No such file"), ("", "Is a directory"), ("loop", "Too many levels")):
        with pytest.raises(GraphFileError) as caught:
            write_bytes(tmp_path / name, b"new")
        assert str(caught.value).startswith(f"{tmp_path / name}: cannot be written: {reason}")
        assert "\n" not in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["loop"]


def test_a_text_is_utf_8(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_bytes(gzip.compress("\ufeffSchären\r\n".encode()))
    assert read_text(file) == "Schären\r\n"
    file.write_bytes("Schären\n".encode("latin-1"))
    with pytest.raises(GraphFileError, match=r"a\.csv: is no text in UTF-8: .*; save it as UTF-8"):
        read_text(file)
    with pytest.raises(GraphFileError, match=r"b\.csv: cannot be read"):
        read_text(tmp_path / "b.csv")
