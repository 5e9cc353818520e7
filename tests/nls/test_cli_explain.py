"""``nls explain``: a report and status 0 whatever is found in a readable file; one line and status 2 for the others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import nls
from nls.cli import main
from tests.nls.g2o_files import INFORMATION_2, PLANE, SPACE, write
from tests.nls.mission_files import folder

Captured = pytest.CaptureFixture[str]


def explain(path: Path, capsys: Captured, *options: str) -> str:
    """What is printed on standard output; nothing else is, and the status is 0."""
    assert main(["explain", str(path), *options]) == 0
    out, err = capsys.readouterr()
    assert "Traceback" not in err
    assert "internal error" not in err
    return out


@pytest.mark.parametrize(("text", "unknowns"), [(PLANE, 9), (SPACE, 12)], ids=["plane", "space"])
def test_the_words_and_the_numbers(text: str, unknowns: int, tmp_path: Path, capsys: Captured) -> None:
    path = write(tmp_path, text)
    out = explain(path, capsys, "--json", str(tmp_path / "e.json"))
    head, blank, first = out.splitlines()[:3]
    assert head.startswith(f"{path}, at its optimum (gauss-newton, ")
    assert blank == ""
    assert first.startswith(f"{unknowns} unknowns, all determined. ")
    report = json.loads((tmp_path / "e.json").read_text())
    assert {"input", "init", "optimum", "summary", "rank", "findings", "parts", "worst", "weakest"} <= set(report)
    assert (report["rank"], report["nullity"], report["summary"]) == (unknowns, 0, first)
    graph, values, _ = nls.load(path)
    assert report["chi2"] == pytest.approx(graph.optimize(nls.initialize(graph, values)[0]).chi2_final, rel=1e-6)
    alone = explain(path, capsys, "--json", "-")
    assert json.loads(alone)["chi2"] == report["chi2"]


def test_a_wrong_closure_in_a_file(tmp_path: Path, capsys: Captured) -> None:
    more = f"EDGE_SE2 0 2 2 1 1.55 {INFORMATION_2}\nEDGE_SE2 1 3 4 -3 1 {INFORMATION_2}\n"
    out = explain(write(tmp_path, PLANE + more), capsys)
    assert "1. Between(x1, x3), a loop closure, is probably wrong: " in out
    assert "-> look at it; remove it, or give it a kernel" in out


def test_what_is_free_is_a_finding(tmp_path: Path, capsys: Captured) -> None:
    """A second part without edges between, and a bearing that leaves its point on a ray."""
    more = "VERTEX_SE2 10 5 5 0\nVERTEX_SE2 11 6 5 0\n" + f"EDGE_SE2 10 11 1 0 0 {INFORMATION_2}\n"
    out = explain(write(tmp_path, PLANE + more), capsys)
    assert "the graph falls into 2 parts that no measurement joins (4 with x0, 2 with x10)" in out
    ray = "VERTEX_XY 20 3 3\nEDGE_BEARING_SE2_XY 0 20 0.785 100\n"
    out = explain(write(tmp_path, PLANE + ray), capsys)
    assert "Of 11 unknowns 1 direction is free." in out
    assert "range of l20 (from x0), as seen by the sensor: this point is seen once" in out


def test_no_optimum_is_a_finding(tmp_path: Path, capsys: Captured) -> None:
    """More free directions than measurements: no method starts."""
    text = "VERTEX_SE2 0 0 0 0\nVERTEX_XY 1 3 3\nEDGE_BEARING_SE2_XY 0 1 0.785 100\n"
    out = explain(write(tmp_path, text), capsys)
    assert ", at the start\n" in out
    assert "1. no optimum was found (something is free, see below)" in out
    assert "range of l1 (from x0)" in out


def test_a_mission(tmp_path: Path, capsys: Captured) -> None:
    out = explain(folder(tmp_path / "m"), capsys)
    assert "RangeAzimuth" in out
    assert "gauge: fixed by the graph itself" in out
    assert explain(folder(tmp_path / "n"), capsys, "--elevation", "free")


@pytest.mark.parametrize(
    "arguments", [["no.g2o"], ["bad.g2o"], ["good.g2o", "--init", "nothing"], ["good.g2o", "--json", "a/b"]]
)
def test_bad_input_is_one_line(
    arguments: list[str], tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path, PLANE, "good.g2o")
    write(tmp_path, PLANE.replace("EDGE_SE2 1 2 1.01", "EDGE_SE2 1 2 nan"), "bad.g2o")
    assert main(["explain", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("nls: ")


def test_a_trajectory_has_no_measurements(tmp_path: Path, capsys: Captured) -> None:
    assert main(["explain", str(write(tmp_path, "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n", "t.tum"))]) == 2
    assert capsys.readouterr().err.startswith("nls: ")
