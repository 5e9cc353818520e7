"""``nls explain``: a report and status 0 whatever is found in a readable file."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

import nls
from nls.cli import main
from tests.nls.cli.shell import PART, RAY, Shell
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, SPACE
from tests.nls.missions.folder.mission_files import folder

MORE = f"EDGE_SE2 0 2 2 1 1.55 {INFORMATION_2}\nEDGE_SE2 1 3 4 -3 1 {INFORMATION_2}\n"


@pytest.mark.parametrize(("text", "unknowns"), [(PLANE, 9), (SPACE, 12)], ids=["plane", "space"])
def test_the_words_and_the_numbers(text: str, unknowns: int, shell: Shell) -> None:
    head, blank, first = shell(f"explain {shell.file(text)} --json e.json").splitlines()[:3]
    assert head.startswith("graph.g2o, at its optimum (gauss-newton, ")
    assert blank == ""
    assert first.startswith(f"{unknowns} unknowns, all determined. ")
    report = json.loads((shell / "e.json").read_text())
    assert {"input", "init", "optimum", "summary", "rank", "findings", "parts", "worst", "weakest"} <= set(report)
    assert (report["rank"], report["nullity"], report["summary"]) == (unknowns, 0, first)
    graph, values, _ = nls.load("graph.g2o")
    assert report["chi2"] == pytest.approx(graph.optimize(nls.initialize(graph, values)[0]).chi2_final, rel=1e-6)


def test_what_is_found_is_no_failure(shell: Shell) -> None:
    """A wrong closure; a part of its own; a point on a ray; and a graph where no method starts, all of it free."""
    out = shell(f"explain {shell.file(PLANE + MORE)}")
    assert "1. Between(x1, x3), a loop closure, is probably wrong: " in out
    assert "   -> look at it\n   -> remove it\n   -> use a robust kernel: --robust cauchy:1\n" in out
    out = shell(f"explain {shell.file(PLANE + PART)}")
    assert "the graph has 2 parts that no measurement joins (4 with x0, 2 with x10)" in out
    out = shell(f"explain {shell.file(PLANE + RAY)}")
    assert "Of 11 unknowns 1 direction is free." in out
    assert "range of l20 (from x0), as seen by the sensor: this point is seen once" in out
    out = shell(f"explain {shell.file('VERTEX_SE2 0 0 0 0' + chr(10) + RAY)}")
    assert ", at the start\n" in out
    assert "1. no optimum was found (something is free)" in out
    assert "range of l20 (from x0)" in out


def test_kernels_and_kinds_that_are_held_as_in_solve(shell: Shell) -> None:
    shell.file(PLANE + MORE)
    options = ("", "--robust Between=tukey:3", "--hold x")
    plain, robust, held = (shell.report(f"explain graph.g2o {option}") for option in options)
    assert (plain["robust"], robust["robust"]) == (False, True)
    chi2 = {kind["name"]: kind["chi2"] for kind in robust["parts"]}
    assert chi2["Between, closures"] > 2 * plain["parts"][1]["chi2"]  # it is let go
    assert (plain["unknowns"], held["unknowns"]) == (9, 0)


def test_a_line_moves_on_a_terminal(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    shell(f"explain {shell.file()}")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    _, err = shell.both("explain graph.g2o")
    for text in ("\rsolve: ", "\rexplain: ", "chi2 "):
        assert text in err


@pytest.mark.parametrize("landmarks", [False, True], ids=["poses", "landmarks"])
def test_only_what_works_is_offered(landmarks: bool, shell: Shell) -> None:
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
    out = shell(f"explain {shell.file(chr(10).join(lines))} --init file")
    assert "most measurements are off alike" in out or "do not fit the others" in out
    offered = main(["solve", "graph.g2o", "--robust", "gnc-tls", "--quiet"]) != 2
    assert ("nls solve --robust gnc-tls" in out) == offered == (not landmarks)
    assert landmarks <= ("--certify" not in out)


def test_a_mission(shell: Shell) -> None:
    folder(shell / "m")
    out = shell("explain m")
    assert "RangeAzimuth" in out
    assert "gauge: fixed by the graph itself" in out
    assert shell("explain m --elevation free")


def test_an_anchor_is_believed_in_one_line_and_none_where_no_file_has_it(shell: Shell) -> None:
    folder(shell / "m")
    out = shell("explain m")
    line = "1. Position(x0), Heading(x0): believed as stated, no other measurement checks them [m/anchor.csv:2].\n\n"
    assert line in out
    assert out.count("anchor.csv:2") == 1
    assert "->" not in out
    (shell / "m" / "anchor.csv").unlink()
    assert "no other measurement checks" not in shell("explain m")
    folder(shell / "n")
    (shell / "n" / "anchor.csv").unlink()
    assert "no other measurement checks" not in shell("explain m n")
