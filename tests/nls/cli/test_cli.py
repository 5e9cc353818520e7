"""The command line: exit codes, the report for programs, files written, processes."""

from __future__ import annotations

import gzip
import importlib
import math
import os
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import nls
from nls.cli import main
from nls.optimizers import OPTIMIZERS
from tests.nls.cli.shell import Shell, process, row
from tests.nls.io.g2o_files import PLANE, SPACE


def test_the_table_of_solve(shell: Shell) -> None:
    out = shell(f"solve {shell.file()} --init file --verbose")
    for text in ("4 variables, 4 measurements, 2-D", "gauge: x0 held", "convention g2o", "3 degrees of freedom"):
        assert text in out
    assert row(out, "result").startswith("converged: ")
    assert "iteration          chi2    max|dx|   seconds" in out
    assert re.search(r"^factorize +[0-9.]+ +[0-9.]+$", out, re.MULTILINE)
    assert "iteration  " not in shell("solve graph.g2o")
    assert shell("solve graph.g2o --quiet") == ""
    assert re.fullmatch(
        "nls: .*iteration limit.*\n", shell.refused("solve graph.g2o --quiet --init file --max-iterations 0", 1)
    )


@pytest.mark.parametrize(("text", "counts"), [(PLANE, ("2-D", 4, 4)), (SPACE, ("3-D", 3, 3))], ids=["plane", "space"])
def test_the_report_for_programs(text: str, counts: tuple[str, int, int], shell: Shell) -> None:
    report = shell.report(f"solve {shell.file(text)}")
    assert (report["input"], report["converged"], report["version"]) == ("graph.g2o", True, nls.__version__)
    assert (report["dimension"], report["variables"], report["factors"]) == counts
    assert report["reason"].startswith("converged: ")
    assert report["peak_rss_mb"] > 10
    first, history = report["history"][0], report["history"]
    assert [step["iteration"] for step in history] == list(range(report["iterations"] + 1))
    assert (first["update"], first["chi2"]) == (None, report["chi2_initial"])
    assert all("gradient" in step and step["lambda"] == 0.0 for step in history)
    graph, values, _ = nls.load("graph.g2o")
    start, name, tried = nls.initialize(graph, values)
    result = graph.optimize(start)
    assert report["chi2_file"] == graph.chi2(values) == tried["file"]
    assert (report["init"], report["chi2_initial"], report["dof"]) == (name, result.chi2_initial, result.dof)
    assert report["chi2_final"] == result.chi2_final <= report["chi2_initial"]
    assert report["linear_solver"] == result.linear_solver
    assert shell("solve graph.g2o --quiet --json r.json") == ""
    assert shell.json()["chi2_final"] == report["chi2_final"]


@pytest.mark.parametrize(("text", "convention"), [(PLANE, "gtsam"), (SPACE, "graphslam"), (SPACE, "log")])
@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_the_optimum_is_written_and_reads_back(text: str, convention: str, shell: Shell) -> None:
    file = shell.file(text + "FIX 1\nPARAMS_X 1 2\n")
    for out in ("out.g2o", "out.g2o.gz"):
        assert main(["solve", file, "-o", out, "--quiet", "--convention", convention]) == 0
    assert gzip.decompress((shell / "out.g2o.gz").read_bytes()) == (shell / "out.g2o").read_bytes()
    (graph, values, read), (before, _, _) = (nls.load(name, convention) for name in ("out.g2o", file))
    assert read.ignored == ["PARAMS_X 1 2"]
    assert [repr(keys) for keys in graph.fixed] == ["x1"]
    assert np.array_equal(graph.factors[0].noise.matrix, before.factors[0].noise.matrix)  # type: ignore[attr-defined]
    again = graph.optimize(values)
    assert again.converged
    assert again.chi2_final == pytest.approx(again.chi2_initial, rel=1e-5)


def test_a_file_without_vertices_has_no_chi2(shell: Shell) -> None:
    edges = shell.file("".join(line + "\n" for line in PLANE.splitlines() if line.startswith("EDGE")), "edges.g2o")
    report = shell.report(f"solve {edges}")
    assert report["chi2_file"] is None
    assert report["notes"] == ["no vertices in the file: 4 poses chained along the edges"]


def test_every_choice_by_name(shell: Shell) -> None:
    expected = shell.report(f"solve {shell.file()}")
    assert (expected["method"], expected["gauge"]) == ("gauss-newton", "x0 held")
    names = {
        "init": ("file", "odometry", "spanning-tree", "chordal"),
        "gauge": ("prior", "free"),
        "linear-solver": ("lu", "dense-cholesky", "dense-qr", "pinv"),
        "method": OPTIMIZERS,
    }
    for option, choices in names.items():
        for name in choices:
            report = shell.report(f"solve graph.g2o --{option} {name}")
            said = report[option.replace("-", "_")]
            assert said.startswith(f"a {name}" if name == "prior" else name)
            assert report["chi2_final"] == pytest.approx(expected["chi2_final"], rel=1e-5)


def test_a_run_leaves_the_warnings_and_the_environment_alone(shell: Shell) -> None:
    before, environment = warnings.showwarning, dict(os.environ)
    shell(f"solve {shell.file()} --quiet")
    assert warnings.showwarning is before
    assert dict(os.environ) == environment


def test_a_folder_without_permission(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    shell.file()
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != shell.folder)
    for option in ("-o", "--json", "--plot"):
        assert "a file in a folder you may write to" in shell.refused(f"solve graph.g2o {option} out.png")
    assert shell(f"solve graph.g2o -o {os.devnull} --to g2o --quiet") == ""


def test_a_missing_solver(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.import_module("nls.linear.cholesky"), "cholmod", lambda: None)
    assert "apt-get install" in shell.refused(f"solve {shell.file()} --linear-solver cholesky")
    assert shell("solve graph.g2o --quiet") == ""


def test_faults_of_ours_are_one_line_and_debug_shows_the_traceback(
    shell: Shell, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(nls.GraphFileError):
        main(["solve", "none.g2o", "--debug"])

    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("oops")

    monkeypatch.setattr(nls, "load", broken)
    assert main(["solve", shell.file()]) == 2
    assert re.fullmatch("nls: internal error, please report it .*oops.*\n", capsys.readouterr().err)
    with pytest.raises(ZeroDivisionError):
        main(["solve", "graph.g2o", "--debug"])


def test_help_and_version(shell: Shell, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "  0    solve: converged; all other commands: done" in capsys.readouterr().out
    assert "nls solve survey.g2o" in shell("--help")
    out = shell("explain --help")
    assert "  2    bad input or usage" in out
    assert ("nls explain survey.g2o" in out, "nls convert survey" in out) == (True, False)
    out = shell("--version")
    assert out.startswith(f"leadline {nls.__version__}\n")
    assert re.search(r"lu +available", out)


@pytest.mark.filterwarnings("ignore::nls.GraphWarning")
def test_info(shell: Shell) -> None:
    out, report = shell(f"info {shell.file()}"), shell.report("info graph.g2o")
    assert re.search(r"EDGE_SE2 +4", out)
    assert re.search(r"gauge +x0 held", out)
    assert re.search(r"variables of each part +4\n.*smallest sigma, m or rad +\d", out, re.DOTALL)
    assert report["tags"] == {"VERTEX_SE2": 4, "EDGE_SE2": 4}
    assert (report["rows_of_A"], report["columns_of_A"], report["components"]) == (12, 9, 1)
    assert math.isclose(report["chi2"], nls.load("graph.g2o")[0].chi2(nls.load("graph.g2o")[1]))
    assert shell.report(f"info {shell.file('VERTEX_SE2 0 0 0 0', 'one.g2o')}")["isolated_variables"] == 1


def test_warnings_and_names_of_a_process(shell: Shell) -> None:
    """A compressed file of a name that the terminal cannot show, with tags that are unknown and an isolated pose."""
    name = shell.file(gzip.compress((PLANE + "UNKNOWN 1 2\nUNKNOWN 3\nVERTEX_SE2 77 1 2 3\n").encode()), "ünï.g2o.gz")
    done = process("-m", "nls", "solve", name, env={"PYTHONIOENCODING": "ascii"}, text=True)
    assert done.returncode == 0
    tags, isolated = done.stderr.splitlines()
    assert re.match(r"nls: warning: .*UNKNOWN \(2, first on line 9\)", tags)
    assert isolated.startswith("nls: warning: x77: ")
    assert r"\xfcn\xef.g2o.gz: 5 variables" in done.stdout
    assert "result      converged" in done.stdout
    assert "UNKNOWN" not in done.stdout  # said once
