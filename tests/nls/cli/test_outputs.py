"""What ``nls solve`` writes: refused before the work where that can be known, and no outcome is lost after it."""

from __future__ import annotations

import json
import os
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import nls
from models.advice import Advice
from nls.cli import main
from tests.nls.io.g2o_files import PLANE, write
from tests.nls.io.io_files import PYFG

Captured = pytest.CaptureFixture[str]
TURN = "VERTEX_SE3:QUAT {} 0 0 0 0 {} 0 {}\n"
PLACEHOLDER = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
VERTEX_SE2 2 2 0.5 0.2
VERTEX_XY 5 0 0
EDGE_SE2 0 1 1 0 0 100 0 0 100 0 100
EDGE_SE2 1 2 1 0.5 0.2 100 0 0 100 0 100
EDGE_BEARING_SE2_XY 0 5 0.78 400
EDGE_BEARING_SE2_XY 1 5 1.11 400
EDGE_BEARING_SE2_XY 2 5 1.37 400
"""


def refused(arguments: list[str], capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> str:
    """The one line of a command that stops before it optimizes."""

    def work(*_: object, **__: object) -> None:
        raise AssertionError("the work was done")

    with monkeypatch.context() as patched:
        patched.setattr(nls.FactorGraph, "optimize", work)
        assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "internal error" not in err
    return err


def test_values_without_chi2_are_started_elsewhere(tmp_path: Path, capsys: Captured) -> None:
    """A point that stands in the file where a pose is has no bearing; the library places it, the file has no chi2."""
    file, out, picture = write(tmp_path, PLACEHOLDER), tmp_path / "out.g2o", tmp_path / "out.png"
    assert main(["solve", str(file), "-o", str(out), "--plot", str(picture), "--json", str(tmp_path / "r.json")]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["chi2_file"] is None
    assert report["starts"].keys() == {"chordal"}
    assert report["written"] == [str(out), str(picture), str(tmp_path / "r.json")]
    graph, values, _ = nls.load(out)
    assert graph.chi2(values) == report["chi2_final"] < report["chi2_initial"]


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        (PYFG, "out.g2o", r"cannot be written to a g2o file; poses A are written as x, points L as l"),
        (PYFG, "out.bal", "Between(A0, A1) cannot be written to a bundle-adjustment file"),
        (PLANE + "FIX 1\n", "out.pyfg", "x1 is held fixed, which a PyFactorGraph file has no line for"),
        (PLANE, "out.isam", "expected a format that holds the optimum, such as g2o: isam files hold measurements only"),
        (PLANE, "out.graph", "or --to FORMAT; *.graph may be toro or graph"),
        (PLANE, "out.unknown", "expected a name ending in .g2o, .toro, .isam, .pyfg, .bal, .tum, .kitti, or --to FORM"),
        (PLANE, "-", "'-' is not possible; expected a file; only --json writes to standard output"),
        (PLANE, "", "'' is not possible; expected the name of a file"),
    ],
)
def test_an_output_without_a_line_is_refused_before_the_work(
    text: str, name: str, message: str, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = write(tmp_path, text, "in")
    if not name:
        assert message in refused(["convert", str(file), name], capsys, monkeypatch)
        return
    assert message in refused(["solve", str(file), "-o", name], capsys, monkeypatch)
    assert list(tmp_path.iterdir()) == [file]
    if "isam" not in name and "--to" in message:  # one rule for every writer
        assert message in refused(["convert", str(file), name], capsys, monkeypatch)


def test_the_format_may_be_named(tmp_path: Path) -> None:
    file, out = write(tmp_path, PLANE), tmp_path / "out.graph"
    for name, format in (("toro", "toro"), ("graph", "graph"), ("g2o", "g2o")):
        assert main(["solve", str(file), "-o", str(out), "--to", name, "--quiet"]) == 0
        assert nls.load(out, dialect=format)[1].stacks["x"].numbers.tolist() == [0, 1, 2, 3]


def test_standard_output_is_for_the_report_alone(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = str(write(tmp_path, PLANE))
    for option in ("--covariance", "--plot"):
        assert "only --json writes to standard output" in refused(["solve", file, option, "-"], capsys, monkeypatch)


def test_a_folder_nobody_may_look_into(tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sentence, no number of the operating system."""
    stat, closed, file = os.stat, str(tmp_path / "closed"), str(write(tmp_path, PLANE))

    def refusing(path: object, *_: object, **options: bool) -> os.stat_result:
        if str(path).startswith(f"{closed}{os.sep}"):
            raise PermissionError(13, "Permission denied", path)
        return stat(path, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "stat", refusing)
    for options in (["-o", f"{closed}/in/out.g2o"], ["--report", f"{closed}/in/p.html"], ["--json", f"{closed}/in/r"]):
        err = refused(["solve", file, *options], capsys, monkeypatch)
        assert "expected a file in a folder that exists, and that you may look into" in err
        assert "Errno" not in err
    assert main(["solve", f"{closed}/in.g2o"]) == 2
    assert "Errno" not in capsys.readouterr().err


def test_two_outputs_of_one_name(tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    file = str(write(tmp_path, PLANE))
    (tmp_path / "link.csv").symlink_to(tmp_path / "out.g2o")
    for options in (
        ["-o", "out.g2o", "--json", "out.g2o"],
        ["-o", "out.g2o", "--covariance", "./link.csv"],
        ["--plot", "a.png", "--json", "../" + tmp_path.name + "/a.png"],
    ):
        monkeypatch.chdir(tmp_path)
        assert "another output has this one" in refused(["solve", file, *options], capsys, monkeypatch)
    assert main(["solve", file, "--quiet", "--covariance", "/dev/null", "--json", "/dev/null"]) == 0


def test_the_outcome_survives_an_output_that_fails(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full for one file; the others, the table and the report are there, and the status says it."""
    file, out, table, where = write(tmp_path, PLANE), tmp_path / "o.g2o", tmp_path / "c.csv", tmp_path / "r.json"
    replace, broken = os.replace, ""

    def full(source: str, target: str) -> None:
        if str(target).endswith(broken):
            raise OSError("disk full")
        replace(source, target)

    monkeypatch.setattr("os.replace", full)
    arguments = ["solve", str(file), "-o", str(out), "--covariance", str(table), "--json", str(where)]
    for failing in (out, table, where):
        broken = failing.name
        for path in (out, table, where):
            path.unlink(missing_ok=True)
        assert main(arguments) == 2
        captured = capsys.readouterr()
        assert captured.err == f"nls: {failing}: cannot be written: disk full\n"
        assert "result      converged" in captured.out
        others = [path for path in (out, table, where) if path != failing]
        assert all(path.exists() for path in others)
        assert [f"written     {path}" for path in others] == [
            line for line in captured.out.splitlines() if line.startswith("written")
        ]
        if failing != where:
            report = json.loads(where.read_text())
            assert report["converged"]
            assert report["written"] == [str(path) for path in others]
            assert report["unwritten"] == [f"{failing}: cannot be written: disk full"]
    broken = "o.g2o"
    with pytest.raises(nls.GraphFileError, match="disk full"):
        main([*arguments, "--debug"])
    assert main([*arguments, "--init", "file", "--max-iterations", "0"]) == 1


def test_covariances_that_are_refused(tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object, **__: object) -> None:
        raise nls.UnderconstrainedError("scale is free", advice=[Advice("gauge")])

    monkeypatch.setattr(nls, "Marginals", none)
    out, table = tmp_path / "o.g2o", tmp_path / "c.csv"
    assert main(["solve", str(write(tmp_path, PLANE)), "-o", str(out), "--covariance", str(table)]) == 2
    captured = capsys.readouterr()
    assert (
        captured.err
        == f"nls: {table} was not written: scale is free\n  -> hold one pose of every part: --gauge first\n"
    )
    assert "result      converged" in captured.out
    assert out.exists()
    assert not table.exists()


def test_an_optimum_that_has_no_line_where_the_start_had_one(tmp_path: Path, capsys: Captured) -> None:
    """The optimum is at gimbal lock, which TORO's angles cannot say; the start was not."""
    s, c = float(np.sin(np.pi / 8)), float(np.cos(np.pi / 8))  # 45 degrees, twice
    identity = " ".join("1" if k in (0, 6, 11, 15, 18, 20) else "0" for k in range(21))
    text = TURN.format(0, 0, 1) + TURN.format(1, s, c) + TURN.format(2, 0.6, 0.8)
    text += "".join(f"EDGE_SE3:QUAT {k} {k + 1} 0 0 0 0 {s} 0 {c} {identity}\n" for k in range(2))
    out = tmp_path / "out.toro"
    assert main(["solve", str(write(tmp_path, text)), "-o", str(out), "--init", "file"]) == 2
    captured = capsys.readouterr()
    assert "result      converged" in captured.out
    assert captured.err.startswith(f"nls: {out} was not written: {out}: variables x: ")
    assert "gimbal lock" in captured.err
    assert captured.err.count("\n") == 1
    assert not out.exists()


def test_repair_is_refused_where_there_is_no_information(tmp_path: Path, capsys: Captured) -> None:
    for text, name in ((PYFG, "a.pyfg"), ("0 1 2 3 0 0 0 1\n", "a.tum")):
        assert main(["info", str(write(tmp_path, text, name)), "--repair-information"]) == 2
        err = capsys.readouterr().err
        assert f"--repair-information: True is not possible; expected False: {tmp_path / name} is in the format" in err


@pytest.mark.parametrize("command", [["plot"], ["solve", "--quiet", "--plot"]], ids=lambda c: c[0])
def test_a_picture_that_cannot_be_drawn_leaves_the_old_one(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half(self: Figure, file: BytesIO, **_: object) -> None:
        file.write(b"half a picture")
        raise OSError("no space left on device")

    file, picture = write(tmp_path, PLANE), tmp_path / "picture.png"
    picture.write_bytes(b"the old one")
    monkeypatch.setattr(Figure, "savefig", half)
    arguments = [*command[:1], str(file), *command[1:], str(picture)]
    assert main(arguments) == 2
    assert picture.read_bytes() == b"the old one"
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([file.name, picture.name])
