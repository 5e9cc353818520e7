"""The command line: exit codes, one line per mistake, the report for programs, files written."""

from __future__ import annotations

import gzip
import json
import math
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import nls
from nls.cli import main
from tests.nls.io.g2o_files import INFORMATION_2, PLANE, SPACE, write

ROOT = Path(__file__).parents[3]
FIELDS = {
    *("input", "dimension", "variables", "factors", "convention", "init", "method", "linear_solver", "chi2_file"),
    *("chi2_initial", "chi2_final", "gauge", "dof", "iterations", "converged", "reason", "history", "timings"),
    *("peak_rss_mb", "version"),
}
TIMINGS = {"read", "build", "init", "analyze", "linearize", "factorize", "solve", "retract", "total"}
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def file(tmp_path: Path) -> str:
    return str(write(tmp_path, PLANE))


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    """Standard error is exactly one line of ours, and what helps below it; standard output is empty."""
    out, err = capsys.readouterr()
    assert out == ""
    _, *advice = err.splitlines()
    assert all(line.startswith("  -> ") for line in advice), err
    assert err.startswith("nls: ")
    assert "Traceback" not in err
    assert "internal error" not in err
    return err


def module(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """``python -m nls`` in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "nls", *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        timeout=60,
    )


def test_solve_prints_a_table(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", file]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "4 variables, 4 measurements, 2-D" in out
    assert "gauge: x0 held" in out
    assert "convention g2o" in out
    assert re.search(r"result +converged: ", out)
    assert re.search(r"3 degrees of freedom", out)


@pytest.mark.parametrize(("text", "dimension"), [(PLANE, "2-D"), (SPACE, "3-D")])
def test_the_report_for_programs(text: str, dimension: str, tmp_path: Path) -> None:
    file, where = write(tmp_path, text), tmp_path / "report.json"
    assert main(["solve", str(file), "--json", str(where), "--quiet"]) == 0
    report = json.loads(where.read_text())
    assert set(report) >= FIELDS
    assert set(report["timings"]) >= TIMINGS
    assert report["input"] == str(file)
    assert report["dimension"] == dimension
    assert report["variables"], report["factors"] == (4, 4) if dimension == "2-D" else (3, 3)
    assert report["converged"] is True
    assert report["reason"].startswith("converged: ")
    assert report["version"] == nls.__version__
    assert report["peak_rss_mb"] > 10
    assert [step["iteration"] for step in report["history"]] == list(range(report["iterations"] + 1))
    assert report["history"][0]["update"] is None
    assert all({"gradient", "lambda"} <= set(step) for step in report["history"])
    assert {step["lambda"] for step in report["history"]} == {0.0}
    assert report["history"][0]["chi2"] == report["chi2_initial"]
    graph, values, _ = nls.load(file)
    start, name, tried = nls.initialize(graph, values)
    result = graph.optimize(start)
    assert report["chi2_file"] == graph.chi2(values) == tried["file"]
    assert report["init"] == name
    assert report["chi2_initial"] == result.chi2_initial
    assert report["chi2_final"] == result.chi2_final <= report["chi2_initial"]
    assert report["dof"] == result.dof
    assert report["linear_solver"] == result.linear_solver


def test_the_report_on_standard_output_is_alone(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", file, "--json", "-"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert json.loads(out)["converged"] is True
    assert main(["info", file, "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["variables"] == 4


def test_quiet_is_silent_but_for_what_went_wrong(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert (main(["solve", file, "--quiet"]), *capsys.readouterr()) == (0, "", "")
    assert main(["solve", file, "--quiet", "--init", "file", "--max-iterations", "0"]) == 1
    assert re.fullmatch(r"nls: the iteration limit was reached .*\n", "".join(capsys.readouterr()))


def test_verbose_shows_iterations_and_timings(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", file, "--verbose", "--init", "file"]) == 0
    out = capsys.readouterr().out
    assert "iteration          chi2    max|dx|   seconds" in out
    assert re.search(r"^factorize +[0-9.]+ +[0-9.]+$", out, re.MULTILINE)


@pytest.mark.parametrize("text", [PLANE, SPACE], ids=["plane", "space"])
@pytest.mark.parametrize("convention", ["g2o", "log", "graphslam", "gtsam"])
def test_the_optimum_is_written_and_reads_back(text: str, convention: str, tmp_path: Path) -> None:
    file, out = write(tmp_path, text + "FIX 1\nPARAMS_X 1 2\n"), tmp_path / "out.g2o"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", nls.GraphWarning)
        assert main(["solve", str(file), "-o", str(out), "--quiet", "--convention", convention]) == 0
        graph, values, read = nls.load(out, convention)
        before, _, _ = nls.load(file, convention)
    assert read.ignored == ["PARAMS_X 1 2"]
    assert [repr(keys) for keys in graph.fixed] == ["x1"]
    assert np.array_equal(graph.factors[0].noise.matrix, before.factors[0].noise.matrix)  # type: ignore[attr-defined]
    again = graph.optimize(values)
    assert again.converged
    assert again.chi2_final == pytest.approx(again.chi2_initial, rel=1e-5)


def test_a_compressed_optimum(file: str, tmp_path: Path) -> None:
    for name in ("out.g2o", "out.g2o.gz"):
        assert main(["solve", file, "-o", str(tmp_path / name), "--quiet"]) == 0
    assert gzip.decompress((tmp_path / "out.g2o.gz").read_bytes()) == (tmp_path / "out.g2o").read_bytes()


def test_a_start_of_infinite_chi2_is_null(
    file: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    graph, values, _ = nls.load(file)
    monkeypatch.setattr(nls, "initialize", lambda *_: (values, "file", {"file": graph.chi2(values), "worse": math.inf}))
    assert main(["solve", file, "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["starts"]["worse"] is None


def test_warnings_are_shown_as_before_after_a_run(file: str) -> None:
    before = warnings.showwarning
    assert main(["solve", file, "--quiet"]) == 0
    assert warnings.showwarning is before


def test_a_folder_without_permission(
    file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != tmp_path)
    for option in ("-o", "--json", "--plot"):
        assert main(["solve", file, option, str(tmp_path / "out.png")]) == 2
        assert "expected a file in a folder you may write to" in one_line(capsys)
    assert main(["solve", file, "-o", os.devnull, "--to", "g2o", "--quiet"]) == 0


def test_the_plot_is_a_picture(file: str, tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    assert main(["solve", file, "--plot", str(out), "--quiet"]) == 0
    assert out.read_bytes().startswith(PNG)
    assert out.stat().st_size > 10_000


@pytest.mark.parametrize("init", ["auto", "file", "odometry", "spanning-tree", "chordal"])
@pytest.mark.parametrize("gauge", ["first", "prior", "free"])
def test_every_start_and_gauge(init: str, gauge: str, file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", file, "--init", init, "--gauge", gauge, "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["init"] == init or init == "auto"
    assert report["chi2_final"] == pytest.approx(nls.load(file)[0].optimize(nls.load(file)[1]).chi2_final, rel=1e-5)


@pytest.mark.parametrize("name", ["lu", "dense-cholesky", "dense-qr", "pinv"])
def test_every_solver_by_name(name: str, file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", file, "--linear-solver", name, "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["linear_solver"] == name


def test_a_file_without_vertices_has_no_chi2_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edges = "\n".join(line for line in PLANE.splitlines() if line.startswith("EDGE"))
    assert main(["solve", str(write(tmp_path, edges)), "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["chi2_file"] is None
    assert report["notes"] == ["no vertices in the file: 4 poses chained along the edges"]


# ---- exit status 1: not converged, under-constrained


def test_an_iteration_limit(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    limit = ["solve", file, "--init", "file", "--max-iterations", "1"]
    assert main(limit) == 1
    out, err = capsys.readouterr()
    assert "the iteration limit was reached" in out
    assert err.count("\n") == 1
    assert "allow more with --max-iterations, or take the estimate with --allow-unconverged" in err
    assert main([*limit, "--allow-unconverged"]) == 0


def test_what_is_written_without_convergence_is_the_best_so_far(file: str, tmp_path: Path) -> None:
    out = tmp_path / "out.g2o"
    assert main(["solve", file, "--init", "file", "--max-iterations", "1", "-o", str(out), "--quiet"]) == 1
    (graph, start, _), (_, found, _) = nls.load(file), nls.load(out)
    assert graph.chi2(found) < graph.chi2(start)


@pytest.mark.filterwarnings("default::models.errors.GraphWarning")
def test_an_underconstrained_graph(file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", file, "--gauge", "none"]) == 1
    assert "leave 3 directions free" in one_line(capsys)
    heading_free = PLANE.replace(INFORMATION_2, "500 1 0 400 0 0")
    assert main(["solve", str(write(tmp_path, heading_free, "free.g2o"))]) == 1
    warned, error, *_ = capsys.readouterr().err.splitlines()
    assert warned.startswith("nls: warning: start 'chordal' was left out: chordal relaxation: ")
    assert error.startswith("nls: ")
    assert "yaw" in error


# ---- exit status 2: bad input or usage


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["solve"], "the following arguments are required: FILE"),
        (["frobnicate"], "invalid choice: 'frobnicate'"),
        (["solve", "FILE", "--frobnicate"], "unrecognized arguments: --frobnicate"),
        (["solve", "FILE", "--init", "magic"], "invalid choice: 'magic'"),
        (["solve", "FILE", "--linear-solver", "abacus"], "invalid choice: 'abacus'"),
        (["solve", "FILE", "--convention", "g3o"], "invalid choice: 'g3o'"),
        (["solve", "FILE", "--gauge", "middle"], "invalid choice: 'middle'"),
        (["solve", "FILE", "--max-iterations", "many"], "invalid int value: 'many'"),
        (["solve", "FILE", "--max-iterations", "-1"], "--max-iterations: -1 is not possible"),
        (["solve", "FILE", "--update-tol", "nan"], "--update-tol: nan is not possible"),
        (["solve", "FILE", "--update-tol", "-1"], "--update-tol: -1.0 is not possible"),
        (["solve", "FILE", "--quiet", "--verbose"], "not allowed with argument"),
        (["solve", "none.g2o"], "none.g2o: cannot be read: No such file"),
        (["info", "none.g2o"], "none.g2o: cannot be read: No such file"),
        (["solve", "."], "is a folder, but no mission: a mission is odometry.csv and zpr.csv, or"),
        (["solve", "FILE", "-o", "nowhere/out.g2o"], "nowhere/out.g2o"),
        (["solve", "FILE", "--plot", "nowhere/out.png"], "nowhere/out.png"),
        (["solve", "FILE", "--json", "nowhere/out.json"], "nowhere/out.json"),
        (["info", "FILE", "--json", "nowhere/out.json"], "nowhere/out.json"),
        (["solve", "FILE", "-o", "FOLDER"], "FOLDER"),
        (["solve", "FILE", "--json", "FOLDER"], "FOLDER"),
        (["solve", "FILE", "--plot", "FOLDER"], "FOLDER"),
        (["solve", "FILE", "--plot", "out.xyz"], "xyz"),
    ],
)
def test_usage(
    arguments: list[str],
    message: str,
    file: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "folder"
    folder.mkdir()
    named = {"FILE": file, "FOLDER": str(folder)}
    assert main([named.get(word, word) for word in arguments]) == 2
    assert named.get(message, message) in one_line(capsys)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["folder", "graph.g2o"]


def test_a_wrong_file_has_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("solve", "info"):
        assert main([command, str(write(tmp_path, PLANE + "EDGE_SE2 0 1 1\n"))]) == 2
        assert re.match(r"nls: .*graph\.g2o:9: 3 numbers after the tag, expected 11", one_line(capsys))


def test_nothing_to_solve(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", str(write(tmp_path, "VERTEX_SE2 0 0 0 0\n"))]) == 2
    assert "graph.g2o: has no measurement: nothing to optimize; add edges" in one_line(capsys)


def test_a_missing_solver(file: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    import importlib

    monkeypatch.setattr(importlib.import_module("nls.linear.cholesky"), "cholmod", lambda: None)
    assert main(["solve", file, "--linear-solver", "cholesky"]) == 2
    assert "apt-get install" in one_line(capsys)
    assert main(["solve", file, "--quiet"]) == 0


def test_debug_shows_the_traceback(tmp_path: Path) -> None:
    with pytest.raises(nls.GraphFileError):
        main(["solve", str(tmp_path / "none.g2o"), "--debug"])


def test_a_fault_of_ours_is_one_line_too(
    file: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("oops")

    monkeypatch.setattr(nls, "load", broken)
    assert main(["solve", file]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "internal error, please report it" in err
    assert "oops" in err


def test_no_command_shows_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "exit status of solve: 0 converged; 1 not converged" in capsys.readouterr().out
    assert main(["--help"]) == 0
    assert "nls solve survey.g2o" in capsys.readouterr().out
    assert main(["--version"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"leadline {nls.__version__}\n")
    assert re.search(r"lu +available", out)


# ---- info


def test_info(file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = tmp_path / "info.json"
    assert main(["info", file, "--json", str(where)]) == 0
    out = capsys.readouterr().out
    assert re.search(r"EDGE_SE2 +4", out)
    assert re.search(r"gauge +x0 held", out)
    report = json.loads(where.read_text())
    assert report["tags"] == {"VERTEX_SE2": 4, "EDGE_SE2": 4}
    assert (report["rows_of_A"], report["columns_of_A"], report["components"]) == (12, 9, 1)
    assert math.isclose(report["chi2"], nls.load(file)[0].chi2(nls.load(file)[1]))


def test_info_of_vertices_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", nls.GraphWarning)
        assert main(["info", str(write(tmp_path, "VERTEX_SE2 0 0 0 0\n"))]) == 0
    assert re.search(r"isolated variables +1", capsys.readouterr().out)


# ---- a process of its own


def test_as_a_module_with_gzip_and_a_warning(tmp_path: Path) -> None:
    data = gzip.compress((PLANE + "UNKNOWN 1 2\nUNKNOWN 3\n").encode())
    done = module("solve", str(write(tmp_path, data, "graph.g2o.gz")))
    assert done.returncode == 0
    lines = done.stderr.splitlines()
    assert len(lines) == 1
    assert re.match(r"nls: warning: .*UNKNOWN \(2, first on line 9\)", lines[0])
    assert "result      converged" in done.stdout
    assert "UNKNOWN" not in done.stdout  # said once


def test_as_a_module_with_a_mistake() -> None:
    done = module("solve", "none.g2o")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "nls: none.g2o: cannot be read: No such file or directory\n"


def test_isolated_poses_are_a_warning_of_one_line(tmp_path: Path) -> None:
    done = module("solve", str(write(tmp_path, PLANE + "VERTEX_SE2 77 1 2 3\n")))
    assert done.returncode == 0
    assert re.fullmatch(r"nls: warning: x77: no measurement touches .*\n", done.stderr)


def test_names_the_terminal_cannot_show(tmp_path: Path) -> None:
    done = module("solve", str(write(tmp_path, PLANE, "ünï.g2o")), PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, "")
    assert r"\xfcn\xef.g2o: 4 variables" in done.stdout


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of the parent is handed down elsewhere")
def test_peak_memory_is_not_that_of_the_parent(file: str) -> None:
    code = "import subprocess, sys; big = bytearray(b'1') * 1_000_000_000; subprocess.run(sys.argv[1:], check=True)"
    command = [sys.executable, "-c", code, sys.executable, "-m", "nls", "solve", file, "--json", "-"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=True)
    assert json.loads(done.stdout)["peak_rss_mb"] < 900
