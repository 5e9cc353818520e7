"""The input of every command: a file that no output may spoil, or standard input."""

from __future__ import annotations

import gzip
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import nls
from nls.cli import main
from nls.io import load_stream
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, write
from tests.nls.io.io_files import BAL, ISAM_APART_2, PYFG, TORO_2
from tests.nls.io.mission.mission_files import folder

Captured = pytest.CaptureFixture[str]
RING = "".join(f"EDGE_SE2 {k} {(k + 1) % 8} 1 0 0.7853981633974483 {INFORMATION_2}\n" for k in range(8))
CHORDS = "".join(f"EDGE_SE2 {k} {(k + 2) % 8} 1.7071 0.7071 1.5708 {INFORMATION_2}\n" for k in range(6))
SPOILED = RING + CHORDS + f"EDGE_SE2 1 5 9 9 0.3 {INFORMATION_2}\n"
FOREIGN = PLANE + "EDGE_SONAR 0 1 3.4\n"


def refused(arguments: list[str], capsys: Captured) -> str:
    """A refusal: one line, and what helps below it."""
    capsys.readouterr()
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert (out, [line for line in err.splitlines()[1:] if not line.startswith("  -> ")]) == ("", []), err
    return err


def piped(monkeypatch: pytest.MonkeyPatch, data: bytes) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))


# ---- the input is not spoiled


def other_names(tmp_path: Path, file: Path) -> list[str]:
    """The file itself, by a detour, by a symbolic and by a hard link."""
    (tmp_path / "soft.g2o").symlink_to(file)
    os.link(file, tmp_path / "hard.g2o")
    detour = tmp_path / ".." / tmp_path.name / file.name
    return [str(file), str(detour), str(tmp_path / "soft.g2o"), str(tmp_path / "hard.g2o")]


def test_measurements_are_not_deleted_without_a_word(tmp_path: Path, capsys: Captured) -> None:
    file = write(tmp_path, SPOILED)
    for output in other_names(tmp_path, file):
        for options in (["--robust", "gnc-tls"], ["--robust", "gnc-gm:0.999", "--json", "-"]):
            err = refused(["solve", str(file), "-o", output, "--quiet", *options], capsys)
            assert (
                f"output file: {output!r} is not possible; expected another file than the input, or --overwrite" in err
            )
            assert f"{options[1]} leaves out the measurements it rejects" in err
    assert file.read_text() == SPOILED
    assert main(["solve", str(file), "-o", str(tmp_path / "out.g2o"), "--quiet", "--robust", "gnc-tls"]) == 0
    left = nls.load(tmp_path / "out.g2o")[0]
    assert len(left) < len(nls.load(file)[0])
    assert main(["solve", str(file), "-o", str(file), "--quiet", "--robust", "gnc-tls", "--overwrite"]) == 0
    assert file.read_bytes() == (tmp_path / "out.g2o").read_bytes()


def test_it_is_refused_before_anything_is_read(tmp_path: Path, capsys: Captured) -> None:
    file = str(write(tmp_path, "no graph"))
    assert "--overwrite" in refused(["solve", file, "-o", file, "--robust", "gnc-tls"], capsys)


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_where_nothing_is_lost_the_optimum_replaces_the_start(tmp_path: Path, capsys: Captured) -> None:
    """All measurements, lines without a meaning here, and what is held: with the optimum as values."""
    file = write(tmp_path, FOREIGN + "FIX 0\n")
    graph, values, report = nls.load(file)
    assert main(["solve", str(file), "-o", str(file), "--robust", "cauchy:1"]) == 0
    after, solved, again = nls.load(file)
    assert after.chi2(values) == graph.chi2(values) > after.chi2(solved)
    assert (again.tags, again.ignored) == (report.tags, report.ignored)
    assert len(after.fixed) == len(graph.fixed) == 1
    assert main(["convert", str(file), str(file)]) == 0
    assert nls.load(file)[2].tags == report.tags


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
@pytest.mark.parametrize(
    ("text", "name", "form"),
    [
        (FOREIGN, "a.g2o", "toro"),
        (PLANE, "a.g2o", "tum"),
        (PLANE, "a.g2o", "isam"),
        (TORO_2, "a.toro", "g2o"),
        (PYFG, "a.pyfg", "kitti"),
        (ISAM_APART_2, "a.isam", "g2o"),
    ],
)
def test_another_format_does_not_replace_the_input(
    text: str, name: str, form: str, tmp_path: Path, capsys: Captured
) -> None:
    file = write(tmp_path, text, name)
    expected = nls.load(file)[2].format
    for command in (["convert", str(file), str(file)], ["solve", str(file), "-o", str(file), "--quiet"]):
        if command[0] == "solve" and form == "isam":
            continue  # refused, as it holds no optimum
        err = refused([*command, "--to", form], capsys)
        assert f"--overwrite, which replaces the input: {form} files do not hold all that {expected} files do" in err
        assert file.read_text() == text
    assert main(["convert", str(file), str(file), "--to", form, "--overwrite"]) == 0
    assert file.read_text() != text


def test_no_other_output_replaces_what_is_read(tmp_path: Path, capsys: Captured) -> None:
    file = write(tmp_path, PLANE)
    os.link(file, tmp_path / "hard.png")
    (tmp_path / "soft.png").symlink_to(file)
    for name in ("hard.png", "soft.png"):
        for arguments in (
            ["plot", str(file), str(tmp_path / name)],
            ["solve", str(file), "--plot", str(tmp_path / name)],
        ):
            assert "another name: this is the input" in refused(arguments, capsys)
    for option in ("--json", "--covariance"):
        assert "another name: this is the input" in refused(
            ["solve", str(file), option, str(tmp_path / "hard.png")], capsys
        )
    assert file.read_text() == PLANE


def test_no_output_replaces_a_table_of_the_mission_that_is_read(tmp_path: Path, capsys: Captured) -> None:
    place = folder(tmp_path)
    before = {path.name: path.read_bytes() for path in place.iterdir()}
    for command, option in (("solve", "--covariance"), ("solve", "--json"), ("info", "--json"), ("explain", "--json")):
        assert "another name: this is the input" in refused(
            [command, str(place), option, str(place / "zpr.csv")], capsys
        )
    assert {path.name: path.read_bytes() for path in place.iterdir()} == before
    assert main(["solve", str(place), "--quiet", "--covariance", str(place / "sigmas.csv")]) == 0


# ---- standard input


@pytest.mark.parametrize("text", [PLANE, TORO_2, PYFG, BAL], ids=["g2o", "toro", "pyfg", "bal"])
@pytest.mark.parametrize("packed", [False, True])
def test_every_command_reads_standard_input(
    text: str, packed: bool, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, data = write(tmp_path, text, "a.txt"), gzip.compress(text.encode()) if packed else text.encode()
    monkeypatch.chdir(tmp_path)
    more = [["plot", "FILE", "out.png"]] if text != BAL else []
    for command in (["info", "FILE"], ["convert", "FILE", "out.any", "--to", "bal" if text == BAL else "pyfg"], *more):
        shown = []
        for name in (str(file), "-"):
            piped(monkeypatch, data)
            assert main([name if word == "FILE" else word for word in command]) == 0
            shown.append(capsys.readouterr().out.replace(str(file), "<stdin>"))
        assert shown[0] == shown[1]


def test_the_optimum_and_the_report_of_standard_input(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write(tmp_path, PLANE)
    reports = []
    for name in (str(file), "-"):
        piped(monkeypatch, PLANE.encode())
        page, out = tmp_path / "page.html", tmp_path / "out.g2o"
        assert main(["solve", name, "--json", "-", "-o", str(out), "--report", str(page)]) == 0
        reports.append(json.loads(capsys.readouterr().out))
        assert ("&lt;stdin&gt;" in page.read_text()) == (name == "-")
    assert [report["input"] for report in reports] == [str(file), "<stdin>"]
    assert reports[0]["chi2_final"] == reports[1]["chi2_final"]
    piped(monkeypatch, PLANE.encode())
    assert main(["explain", "-"]) == 0
    assert capsys.readouterr().out.startswith("<stdin>, at its optimum")


def test_mistakes_on_standard_input_have_their_line(capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    for data in (PLANE + "EDGE_SE2 0 1\n", PLANE.replace("\n", "\r") + "EDGE_SE2 0 1\r"):
        for command in (
            ["solve", "-"],
            ["info", "-"],
            ["explain", "-"],
            ["plot", "-", "a.png"],
            ["convert", "-", "a.toro"],
        ):
            piped(monkeypatch, data.encode())
            assert refused(command, capsys).startswith("nls: <stdin>:9: 2 numbers after the tag, expected 11")
    for content, message in (
        (b"", "<stdin>:1: is empty"),
        (gzip.compress(PLANE.encode())[:-9], "<stdin>: is not a complete gzip file"),
        (b"i,j,x_m\n0,1,2\n", "<stdin>:1: is no graph but a table, its numbers separated by commas"),
        (b"VERTEX_SE2 0 0 0 0\n", "<stdin>: has no measurement: nothing to optimize"),
    ):
        piped(monkeypatch, content)
        assert refused(["solve", "-"], capsys).startswith(f"nls: {message}")
    piped(monkeypatch, FOREIGN.encode())
    with pytest.warns(nls.GraphWarning, match="<stdin>: lines with unknown tags were not used: EDGE_SONAR"):
        load_stream(sys.stdin.buffer, "<stdin>")


def test_a_mission_is_no_stream(capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    piped(monkeypatch, PLANE.encode())
    message = "elevation: 'prior' is not possible; expected None: <stdin> is no folder of a mission"
    assert message in refused(["solve", "-", "--elevation", "prior"], capsys)
    monkeypatch.setattr(sys, "stdin", None)
    assert "<stdin>: cannot be read: standard input is closed" in refused(["solve", "-"], capsys)


def test_a_pipe_between_processes(tmp_path: Path) -> None:
    """What is free is explained by a command that can be typed; the file behind standard input is the input, too."""
    command = [sys.executable, "-m", "nls", "solve", "-"]
    two = RING + "EDGE_SE2 20 21 1 0 0 9 0 0 9 0 9\n"
    done = subprocess.run([*command, "--gauge", "none"], input=gzip.compress(two.encode()), capture_output=True)
    assert done.returncode == 1
    assert re.search(rb"see: nls explain -( |$|\n)", done.stderr), done.stderr
    file = write(tmp_path, SPOILED)
    with file.open("rb") as stream:
        done = subprocess.run([*command, "--robust", "gnc-tls", "-o", str(file)], stdin=stream, capture_output=True)
    assert (done.returncode, b"--overwrite" in done.stderr) == (2, True)
    assert file.read_text() == SPOILED


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_load_stream(tmp_path: Path) -> None:
    graph, values, report = load_stream(io.BytesIO(FOREIGN.encode()), "mine", "log")
    same, start, other = nls.load(write(tmp_path, FOREIGN), "log")
    assert (report.path, report.tags, report.ignored) == ("mine", other.tags, other.ignored)
    assert graph.chi2(values) == same.chi2(start)

    class Broken(io.RawIOBase):
        def read(self, size: int = -1) -> bytes:
            raise OSError(5, "Input/output error")

    with pytest.raises(nls.GraphFileError, match="mine: cannot be read: Input/output error"):
        load_stream(Broken(), "mine")  # type: ignore[arg-type]
