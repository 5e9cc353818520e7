"""What ``nls solve`` writes: files in any format, covariances, the page, and where the time went."""

from __future__ import annotations

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
from tests.nls.cli.shell import Shell, process, rows
from tests.nls.io.g2o_files import PLANE
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
        "  -> hold one pose of every part: --gauge first",
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
