"""``nls explain``: a report and status 0 whatever is found in a readable file."""

from __future__ import annotations

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
    out, report = shell.told(f"explain {shell.file(text)}")
    head, blank, first = out.splitlines()[:3]
    assert head.startswith("graph.g2o, at its optimum (gauss-newton, ")
    assert blank == ""
    assert first.startswith(f"{unknowns} unknowns, all determined. ")
    assert {"input", "init", "optimum", "summary", "rank", "findings", "parts", "worst", "weakest"} <= set(report)
    assert (report["rank"], report["nullity"], report["summary"]) == (unknowns, 0, first)
    graph, values, _ = nls.load("graph.g2o")
    assert report["chi2"] == pytest.approx(graph.optimize(nls.initialize(graph, values)[0]).chi2_final, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "where", "nullity", "first"),
    [
        (PLANE + MORE, "at its optimum (gauss-newton, ", 0, "wrong_closure"),
        (PLANE + PART, "at its optimum (gauss-newton, ", 0, "separate_parts"),
        (PLANE + RAY, "at its optimum (levenberg-marquardt, ", 1, "free"),
        (f"VERTEX_SE2 0 0 0 0\n{RAY}", "at the start", 1, "not_converged"),  # no method starts
    ],
)
def test_what_is_found_is_no_failure(text: str, where: str, nullity: int, first: str, shell: Shell) -> None:
    report = shell.report(f"explain {shell.file(text)}")
    assert report["optimum"].startswith(where)
    assert (report["nullity"], report["findings"][0]["kind"]) == (nullity, first)


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


def test_an_anchor_is_believed_in_one_line_and_none_where_no_file_has_it(shell: Shell) -> None:
    folder(shell / "m")
    out = shell("explain m")
    assert "RangeAzimuth" in out
    assert "gauge: fixed by the graph itself" in out
    line = "1. Position(x0), Heading(x0): believed as stated, no other measurement checks them [m/anchor.csv:2].\n\n"
    assert line in out
    assert out.count("anchor.csv:2") == 1
    assert "->" not in out
    (shell / "m" / "anchor.csv").unlink()
    folder(shell / "n", anchor=None)
    assert "no other measurement checks" not in shell("explain m --elevation free")
    assert "no other measurement checks" not in shell("explain m n")
