"""``nls explain``: a report and status 0 whatever is found in a readable file; one line and status 2 for the others."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import nls
from nls.cli import main
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, SPACE, write
from tests.nls.io.mission.mission_files import folder

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
    assert "   -> look at it\n   -> remove it\n   -> use a robust kernel: --robust cauchy:1\n" in out


def test_what_is_free_is_a_finding(tmp_path: Path, capsys: Captured) -> None:
    """A second part without edges between, and a bearing that leaves its point on a ray."""
    more = "VERTEX_SE2 10 5 5 0\nVERTEX_SE2 11 6 5 0\n" + f"EDGE_SE2 10 11 1 0 0 {INFORMATION_2}\n"
    out = explain(write(tmp_path, PLANE + more), capsys)
    assert "the graph has 2 parts that no measurement joins (4 with x0, 2 with x10)" in out
    ray = "VERTEX_XY 20 3 3\nEDGE_BEARING_SE2_XY 0 20 0.785 100\n"
    out = explain(write(tmp_path, PLANE + ray), capsys)
    assert "Of 11 unknowns 1 direction is free." in out
    assert "range of l20 (from x0), as seen by the sensor: this point is seen once" in out


def test_no_optimum_is_a_finding(tmp_path: Path, capsys: Captured) -> None:
    """More free directions than measurements: no method starts."""
    text = "VERTEX_SE2 0 0 0 0\nVERTEX_XY 1 3 3\nEDGE_BEARING_SE2_XY 0 1 0.785 100\n"
    out = explain(write(tmp_path, text), capsys)
    assert ", at the start\n" in out
    assert "1. no optimum was found (something is free)" in out
    assert "range of l1 (from x0)" in out


def test_kernels_and_kinds_that_are_held_as_in_solve(tmp_path: Path, capsys: Captured) -> None:
    more = f"EDGE_SE2 0 2 2 1 1.55 {INFORMATION_2}\nEDGE_SE2 1 3 4 -3 1 {INFORMATION_2}\n"
    path = write(tmp_path, PLANE + more)
    plain, robust, held = (
        json.loads(explain(path, capsys, "--json", "-", *options))
        for options in ([], ["--robust", "Between=tukey:3"], ["--hold", "x"])
    )
    assert (plain["robust"], robust["robust"]) == (False, True)
    chi2 = {kind["name"]: kind["chi2"] for kind in robust["parts"]}
    assert chi2["Between, closures"] > 2 * plain["parts"][1]["chi2"]  # it is let go
    assert (plain["unknowns"], held["unknowns"]) == (9, 0)
    for options, said in (
        (["--robust", "gnc-tls"], "expected a kernel, such as cauchy:1; nls solve has gnc-tls"),
        (["--hold", "q"], "expected one of the kinds x"),
        (["--robust", "dcs"], "'dcs' is not possible"),
    ):
        assert main(["explain", str(path), *options]) == 2
        assert said in capsys.readouterr().err


def test_a_line_moves_on_a_terminal(tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    path = str(write(tmp_path, PLANE))
    assert main(["explain", path]) == 0
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert main(["explain", path]) == 0
    err = capsys.readouterr().err
    assert "\rsolve: " in err
    assert "\rexplain: " in err
    assert "chi2 " in err


def test_the_help_is_about_this_command(capsys: Captured) -> None:
    assert main(["explain", "--help"]) == 0
    out = capsys.readouterr().out
    assert "Say in plain words what is free, what does not fit, and what helps." in out
    assert "of explain and all others: 0 done, whatever was found; of all: 2 bad input" in out
    assert "  nls explain survey.g2o  " in out
    assert "nls convert survey" not in out


@pytest.mark.parametrize("landmarks", [False, True], ids=["poses", "landmarks"])
def test_only_what_works_is_offered(landmarks: bool, tmp_path: Path, capsys: Captured) -> None:
    """Graduation wants loop closures and odometry, a certificate poses alone; else `nls solve` refuses."""
    rng = np.random.default_rng(0)
    lines = [f"VERTEX_SE2 {k} {k % 6} {k // 6} 0" for k in range(36)]
    lines += [f"EDGE_SE2 {k} {k + 1} {-5 if k % 6 == 5 else 1} {int(k % 6 == 5)} 0 {INFORMATION_2}" for k in range(35)]
    if landmarks:
        lines += [f"VERTEX_XY {100 + k} {k} 7" for k in range(4)]
        pairs = [(k, 100 + j, (j - k % 6, 7 - k // 6)) for k in range(36) for j in range(4)]
        tag, entries = "EDGE_SE2_XY", "500 0 500"
    else:
        pairs = [(k, k + 12, (0, 2)) for k in range(24)] * 3
        tag, entries = "EDGE_SE2", f"0 {INFORMATION_2}"
    for n, (i, j, (x, y)) in enumerate(pairs):
        dx, dy = (x, y) + 0.03 * rng.normal(size=2) if n % 3 else 5 * rng.normal(size=2)
        lines.append(f"{tag} {i} {j} {dx} {dy} {entries}")
    path = write(tmp_path, "\n".join(lines) + "\n")
    out = explain(path, capsys, "--init", "file")
    assert "most measurements are off alike" in out or "do not fit the others" in out
    assert ("nls solve --robust gnc-tls" in out) == (not landmarks)
    offered = main(["solve", str(path), "--robust", "gnc-tls", "--quiet"]) != 2
    assert offered == (not landmarks)
    assert landmarks <= ("--certify" not in out)


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
    path = write(tmp_path, "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n", "t.tum")
    assert main(["explain", str(path)]) == 2
    assert capsys.readouterr().err.startswith(f"nls: {path}: has no measurement: nothing to optimize; add edges")
