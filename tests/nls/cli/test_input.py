"""The input of every command: a file that no output may spoil, or standard input."""

from __future__ import annotations

import gzip
import io
import os
import re
import sys

import pytest

import nls
from nls.io import load_stream
from tests.nls.cli.shell import RING, SPOILED, Shell, process
from tests.nls.io.g2o_files import PLANE
from tests.nls.io.io_files import BAL, PYFG, TORO_2
from tests.nls.missions.folder.mission_files import folder

FOREIGN = PLANE + "SONAR 0 1 3.4\n"


def test_measurements_are_not_deleted_without_a_word(shell: Shell) -> None:
    """By its own name, by a detour, by a symbolic and by a hard link; refused before anything is read."""
    for text in ("no graph", SPOILED):
        (shell / "hard.g2o").unlink(missing_ok=True)
        file = shell.file(text)
        os.link(shell / file, shell / "hard.g2o")
        (shell / "soft.g2o").unlink(missing_ok=True)
        (shell / "soft.g2o").symlink_to(shell / file)
        for output in (file, f"../{shell.folder.name}/{file}", "soft.g2o", "hard.g2o"):
            err = shell.refused(f"solve {file} -o {output} --quiet --robust gnc-tls")
            assert f"-o: {output!r} is not possible; expected another file than the input, or --over" in err
            assert "gnc-tls leaves out the measurements it rejects" in err
    assert "--overwrite" in shell.refused(f"solve {file} -o {file} --robust gnc-gm:0.999 --json -")
    shell(f"solve {file} -o out.g2o --quiet --robust gnc-tls")
    assert len(nls.load("out.g2o")[0]) < len(nls.load(file)[0])
    shell(f"solve {file} -o {file} --quiet --robust gnc-tls --overwrite")
    assert (shell / file).read_bytes() == (shell / "out.g2o").read_bytes()


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_where_nothing_is_lost_the_optimum_replaces_the_start(shell: Shell) -> None:
    """All measurements, lines without a meaning here, and what is held: with the optimum as values."""
    file = shell.file(FOREIGN + "FIX 0\n")
    graph, values, report = nls.load(file)
    shell(f"solve {file} -o {file} --robust cauchy:1")
    after, solved, again = nls.load(file)
    assert after.chi2(values) == graph.chi2(values) > after.chi2(solved)
    assert (again.tags, again.ignored) == (report.tags, report.ignored)
    assert len(after.fixed) == len(graph.fixed) == 1
    shell(f"convert {file} {file}")
    assert nls.load(file)[2].tags == report.tags


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_another_format_does_not_replace_the_input(shell: Shell) -> None:
    for text, name, form in (
        (FOREIGN, "a.g2o", "toro"),
        (PLANE, "a.g2o", "isam"),
        (PYFG, "a.pyfg", "kitti"),
    ):
        expected = nls.load(shell.file(text, name))[2].format
        why = f"--overwrite, which replaces the input: {form} files do not hold all that {expected} files do"
        assert why in shell.refused(f"convert {name} {name} --to {form}")
        if form != "isam":  # which holds no optimum
            assert why in shell.refused(f"solve {name} -o {name} --quiet --to {form}")
        shell(f"convert {name} {name} --to {form} --overwrite")
        assert (shell / name).read_text() != text


def test_a_new_table_in_the_folder_of_the_mission(shell: Shell) -> None:
    place = folder(shell.folder)
    before = shell.contents()
    assert shell(f"solve {place} --quiet --covariance {place}/sigmas.csv") == ""
    assert shell.contents().items() > before.items()


# ---- standard input


def piped(monkeypatch: pytest.MonkeyPatch, data: bytes) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))


@pytest.mark.parametrize(
    ("text", "packed"), [(PLANE, True), (TORO_2, False), (PYFG, True), (BAL, False)], ids=["g2o", "toro", "pyfg", "bal"]
)
def test_every_command_reads_standard_input(
    text: str, packed: bool, shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    shell.file(text, "a.txt")
    commands = ["info {}", f"convert {{}} out.any --to {'bal' if text == BAL else 'pyfg'}"]
    for command in [*commands, "plot {} out.svg"] if text == PLANE else commands:
        expected = shell(command.format("a.txt"))
        piped(monkeypatch, gzip.compress(text.encode()) if packed else text.encode())
        assert shell(command.format("-")) == expected.replace("a.txt", "<stdin>")


def test_the_optimum_and_the_report_of_standard_input(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = shell.report(f"solve {shell.file()} -o same.g2o")
    piped(monkeypatch, PLANE.encode())
    report = shell.report("solve - -o out.g2o")
    assert (report["input"], report["chi2_final"]) == ("<stdin>", expected["chi2_final"])
    assert (shell / "out.g2o").read_bytes() == (shell / "same.g2o").read_bytes()
    piped(monkeypatch, PLANE.encode())
    assert shell("explain -").startswith("<stdin>, at its optimum")


def test_mistakes_on_standard_input_have_their_line(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong, single = PLANE + "EDGE_SE2 0 1\n", PLANE.replace("\n", "\r") + "EDGE_SE2 0 1\r"
    line = "<stdin>:9: 2 numbers after the tag, expected 11"
    for words, data, message in (
        ("solve -", wrong.encode(), line),
        ("plot - a.png", single.encode(), line),
        ("solve -", b"", "<stdin>:1: is empty"),
        ("solve -", gzip.compress(PLANE.encode())[:-9], "<stdin>: is not a complete gzip file"),
        ("solve -", b"VERTEX_SE2 0 0 0 0\n", "<stdin>: has no measurement: nothing to optimize"),
        ("solve - --elevation prior", PLANE.encode(), "--elevation: 'prior' is not possible; expected None: <std"),
    ):
        piped(monkeypatch, data)
        assert shell.refused(words).startswith(f"nls: {message}")
    monkeypatch.setattr(sys, "stdin", None)
    assert "<stdin>: cannot be read: standard input is closed" in shell.refused("solve -")


def test_a_pipe_between_processes(shell: Shell) -> None:
    """What is free is explained by a command that can be typed; the file behind standard input is the input, too."""
    two = RING + "EDGE_SE2 20 21 1 0 0 9 0 0 9 0 9\n"
    done = process("-m", "nls", "solve", "-", "--gauge", "none", input=gzip.compress(two.encode()))
    assert done.returncode == 1
    assert re.search(rb"see: nls explain -( |$|\n)", done.stderr), done.stderr
    file = shell / shell.file(SPOILED)
    with file.open("rb") as stream:
        done = process("-m", "nls", "solve", "-", "--robust", "gnc-tls", "-o", str(file), stdin=stream)
    assert (done.returncode, b"--overwrite" in done.stderr) == (2, True)
    assert file.read_text() == SPOILED


def test_load_stream(shell: Shell) -> None:
    with pytest.warns(nls.GraphWarning, match="mine: lines with unknown tags were not used: SONAR"):
        graph, values, report = load_stream(io.BytesIO(FOREIGN.encode()), "mine", "log")
    with pytest.warns(nls.GraphWarning):
        same, start, other = nls.load(shell.file(FOREIGN), "log")
    assert (report.path, report.tags, report.ignored) == ("mine", other.tags, other.ignored)
    assert graph.chi2(values) == same.chi2(start)

    class Broken(io.RawIOBase):
        def read(self, size: int = -1) -> bytes:
            raise OSError(5, "Input/output error")

    with pytest.raises(nls.GraphFileError, match="mine: cannot be read: Input/output error"):
        load_stream(Broken(), "mine")  # type: ignore[arg-type]
