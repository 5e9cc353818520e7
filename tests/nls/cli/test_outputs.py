"""What ``nls solve`` writes, where the time went, and the input of every command, which no output may spoil."""

from __future__ import annotations

import gzip
import io
import json
import os
import re
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import nls
from models.advice import Advice
from nls.cli import main
from nls.cli.run import Clock
from nls.io import load_stream
from tests.nls.cli.shell import RING, SPOILED, Shell, process, rows
from tests.nls.io.g2o_files import PLANE
from tests.nls.io.io_files import BAL, PYFG, TORO_2
from tests.nls.io.test_bal import GOOD
from tests.nls.missions.folder.mission_files import folder
from tests.nls.plot.html_page import Page

TURN = "VERTEX_SE3:QUAT {} 0 0 0 0 {} 0 {}\n"
PLACEHOLDER = f"""{PLANE}VERTEX_XY 5 0 0
EDGE_BEARING_SE2_XY 0 5 0.785 400
EDGE_BEARING_SE2_XY 1 5 0.891 400
EDGE_BEARING_SE2_XY 2 5 -0.536 400
"""


def test_values_without_chi2_are_started_elsewhere(shell: Shell) -> None:
    """A point that stands in the file where a pose is has no bearing; the library places it, the file has no chi2."""
    report = shell.report(f"solve {shell.file(PLACEHOLDER)} -o out.g2o --plot out.png")
    assert report["chi2_file"] is None
    assert report["starts"].keys() == {"chordal"}
    assert report["written"] == ["out.g2o", "out.png"]
    picture = (shell / "out.png").read_bytes()
    assert (picture[:4], len(picture) > 10_000) == (b"\x89PNG", True)
    graph, values, _ = nls.load("out.g2o")
    assert graph.chi2(values) == report["chi2_final"] < report["chi2_initial"]


def test_the_format_may_be_named(shell: Shell) -> None:
    shell.file()
    for name in ("toro", "graph", "g2o"):
        shell(f"solve graph.g2o -o out.graph --to {name} --quiet")
        assert nls.load("out.graph", dialect=name)[1].stacks["x"].numbers.tolist() == [0, 1, 2, 3]


def test_the_outcome_survives_an_output_that_fails(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk is full for one file; the others, the table and the report are there, and the status says it."""
    replace, broken = os.replace, ""

    def full(source: str, target: str) -> None:
        if str(target).endswith(broken):
            raise OSError("disk full")
        replace(source, target)

    monkeypatch.setattr("os.replace", full)
    shell.file()
    names = ["o.g2o", "c.csv", "r.json"]
    words = "solve graph.g2o -o o.g2o --covariance c.csv --json r.json"
    for broken in names:
        for name in names:
            (shell / name).unlink(missing_ok=True)
        out, err = shell.both(words, 2)
        assert err == f"nls: {broken}: cannot be written: disk full\n"
        others = [name for name in names if name != broken]
        assert rows(out, "written") == others
        assert rows(out, "result")[0].startswith("converged")
        assert shell.contents().keys() == {"graph.g2o", *others}
    broken = "c.csv"
    report = shell.report("solve graph.g2o -o o.g2o --covariance c.csv", 2)
    assert (report["converged"], report["written"]) == (True, ["o.g2o"])
    assert report["unwritten"] == ["c.csv: cannot be written: disk full"]
    with pytest.raises(nls.GraphFileError, match="disk full"):
        main([*words.split(), "--debug"])
    broken = "o.g2o"
    shell.both(f"{words} --init file --max-iterations 0", 1)


def test_covariances_at_an_optimum_only(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    words = f"solve {shell.file()} --covariance c.csv"
    assert shell.report(words)["written"] == ["c.csv"]
    head, held, first, *_ = (line.split(",") for line in (shell / "c.csv").read_text().splitlines())
    assert head[:4] == ["kind", "number", "status", "world_x_x"]
    assert (held[:3], first[:3]) == (["x", "0", "gauge"], ["x", "1", "estimated"])
    (shell / "c.csv").unlink()
    report = shell.report(f"{words} --init file --max-iterations 1", status=1)
    assert report["notes"] == ["no covariances were written to c.csv: this is no optimum"]
    assert report["written"] == []
    assert not (shell / "c.csv").exists()

    def none(*_: object, **__: object) -> None:
        raise nls.UnderconstrainedError("scale is free", advice=[Advice("gauge")])

    monkeypatch.setattr(nls, "Marginals", none)
    out, err = shell.both(f"{words} -o o.g2o", 2)
    assert err.splitlines() == [
        "nls: c.csv was not written: scale is free",
        "  -> fix one pose of every part: --gauge first",
    ]
    assert rows(out, "written") == ["o.g2o"]
    assert shell.contents().keys() == {"graph.g2o", "o.g2o"}


def test_an_optimum_that_has_no_line_where_the_start_had_one(shell: Shell) -> None:
    """The optimum is at gimbal lock, which TORO's angles cannot say; the start was not."""
    s, c = float(np.sin(np.pi / 8)), float(np.cos(np.pi / 8))  # 45 degrees, twice
    identity = " ".join("1" if k in (0, 6, 11, 15, 18, 20) else "0" for k in range(21))
    text = TURN.format(0, 0, 1) + TURN.format(1, s, c) + TURN.format(2, 0.6, 0.8)
    text += "".join(f"EDGE_SE3:QUAT {k} {k + 1} 0 0 0 0 {s} 0 {c} {identity}\n" for k in range(2))
    out, err = shell.both(f"solve {shell.file(text)} -o out.toro --init file", 2)
    assert rows(out, "result")[0].startswith("converged")
    assert err.startswith("nls: out.toro was not written: out.toro: variables x: ")
    assert "gimbal lock" in err
    assert err.count("\n") == 1
    assert not (shell / "out.toro").exists()


@pytest.mark.parametrize("words", ["plot graph.g2o a.png", "solve graph.g2o --quiet --plot a.png"])
def test_a_picture_that_cannot_be_drawn_leaves_the_old_one(
    words: str, shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half(self: Figure, file: BytesIO, **_: object) -> None:
        file.write(b"half a picture")
        raise OSError("no space left on device")

    shell.file()
    shell.file("the old one", "a.png")
    monkeypatch.setattr(Figure, "savefig", half)
    assert "no space left on device" in shell.refused(words)


def test_the_page(shell: Shell, undrawn: None) -> None:
    file = shell.file(name="<b>$a$.g2o")
    printed, record = shell.told(f"solve '{file}' --certify --report out.html --verbose")
    assert re.search(r"^report +[0-9.]+ +[0-9.]+ +explanation, covariances and pictures", printed, re.MULTILINE)
    assert "out.html" in record["written"]
    seconds = record["timings"]
    parts = ("solved", "check", "write", "certify", "report")
    assert seconds["total"] == pytest.approx(sum(seconds[part] for part in parts))
    page = Page((shell / "out.html").read_text())
    assert {"certificate", "provenance", "time"} <= page.ids
    for said in ("<b>$a$.g2o", "4 VERTEX_SE2, 4 EDGE_SE2", "g2o, 2-D", "--certify --report", record["reason"][11:]):
        assert said in page.text


def test_the_page_of_a_mission(shell: Shell, undrawn: None) -> None:
    folder(shell / "m", anchor=None)  # the anchor is assumed, and not a measurement that nothing checks
    assert shell("solve m --report out.html --quiet") == ""
    page = Page((shell / "out.html").read_text())
    assert [image["alt"] for image in page.images[:2]] == ["The track", "The landmarks"]
    assert {"RangeAzimuth", "XYH", "ZPR", "Nothing suspicious."} <= set(page.texts)


def test_the_page_of_a_bundle(shell: Shell, undrawn: None) -> None:
    shell.both(f"solve {shell.file(chr(10).join(GOOD), 'b.txt')} --report out.html --quiet", 1)
    page = Page((shell / "out.html").read_text())
    assert "Not solved" in page.text  # two cameras, three points: much is free
    assert "2 c, 2 k, 3 l" in page.text


def test_the_page_of_a_large_graph_stays_below_3_mb(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.html"
    assert main(["solve", str(data / "pose-graphs-3d/sphere2500.g2o.gz"), "--report", str(out), "--quiet"]) == 0
    assert 5e4 < out.stat().st_size < 3e6
    assert len(Page(out.read_text()).images) == 5


PARTS = ("linearize", "assemble", "factorize", "solve", "retract")
STAGES = ("startup", "imports", "read", "init", "check", "build", "analyze", *PARTS, "other", "write")


def test_the_table_adds_up(shell: Shell) -> None:
    out = shell(f"solve {shell.file()} --verbose --init file")
    rows = re.findall(r"^([a-z]+) +([0-9.]+) +([0-9.]+)(?: .*)?$", out, re.MULTILINE)
    milliseconds = {name: float(ms) for name, ms, _ in rows}
    whole = milliseconds.pop("process")
    assert tuple(milliseconds) == STAGES
    assert sum(milliseconds.values()) == pytest.approx(whole, abs=0.05 * len(rows) + 0.01)
    assert sum(float(share) for *_, share in rows) == pytest.approx(200, abs=0.05 * len(rows) + 0.01)
    parts = re.search(r"^iteration +linearize.*\n((?: +\d+(?: +[0-9.]+){6}\n)+)", out, re.MULTILINE)
    assert parts is not None
    spent = np.array([line.split() for line in parts[1].splitlines()], dtype=float)
    assert spent[:, 1:6].sum(axis=1) == pytest.approx(spent[:, 6], abs=0.03)
    assert spent[:, 3].sum() == pytest.approx(milliseconds["factorize"], abs=0.1)


def test_parts_of_a_stage_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a solution that --improve left, and the one it ended at."""
    now = iter([1.0, 3.0, 4.0, 9.0])
    monkeypatch.setattr("nls.cli.run.perf_counter", lambda: next(now))
    clock = Clock(0.0, 0.0)
    for name in ("optimize", "certify", "optimize", "certify"):
        clock.lap(name)
    assert clock.seconds == {"startup": 0.0, "optimize": 2.0, "certify": 7.0}


def test_the_report_of_a_process(shell: Shell) -> None:
    """Timings add up, and count the start; the peak of memory is not that of the process that began this one."""
    code = "import subprocess, sys; big = bytearray(b'1') * 400_000_000; subprocess.run(sys.argv[1:], check=True)"
    command = [sys.executable, "-m", "nls", "solve", shell.file(), "--json", "-", "-o", "out.g2o"]
    done = process("-c", code, *command, check=True)
    report = json.loads(done.stdout)
    seconds = report["timings"]
    solved = sum(seconds[part] for part in ("read", "init", "build", "analyze", *PARTS, "other"))
    assert seconds["solved"] == pytest.approx(solved)
    assert seconds["total"] == pytest.approx(solved + seconds["check"] + seconds["write"])
    assert seconds["process"] == pytest.approx(seconds["total"] + seconds["startup"] + seconds["imports"])
    assert all(value >= 0 for value in seconds.values())
    assert seconds["imports"] > seconds["check"] > 0
    assert 0 < seconds["startup"] < 5
    assert 0 < seconds["read file"] < seconds["read"]
    if Path("/proc/self/status").exists():  # elsewhere the peak of the parent is handed down
        assert 10 < report["peak_rss_mb"] < 350


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
