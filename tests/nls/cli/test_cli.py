"""The command line: exit codes, the report for programs, files written, processes, and Ctrl-C at every moment."""

from __future__ import annotations

import gzip
import importlib
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
from nls.optimizers import OPTIMIZERS
from tests.nls.cli.shell import SPOILED, Shell, process, row
from tests.nls.io.g2o_files import PLANE, SPACE


def test_the_table_of_solve(shell: Shell) -> None:
    out = shell(f"solve {shell.file()} --init file --verbose")
    for text in ("4 variables, 4 measurements, 2-D", "gauge: x0 fixed", "3 degrees of freedom"):
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
    assert all("sigmas" in step and step["lambda"] == 0.0 for step in history)
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
    assert (expected["method"], expected["gauge"]) == ("gauss-newton", "x0 fixed")
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
    screen = capsys.readouterr().out
    assert len(screen.splitlines()) <= 30
    assert ("nls solve survey.g2o" in screen, shell("--help")) == (True, screen)
    groups = re.findall(r"^(?!usage|exit|threads)\S.*:$", shell("solve --help"), re.MULTILINE)
    assert groups[1:] == [
        "options:",
        "how FILE is read:",
        "how it is solved:",
        "how the output is written:",
        "examples:",
    ]
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
    assert re.search(r"gauge +x0 fixed", out)
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


ROOT = Path(__file__).parents[3]
SIGNALLED = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background inherits none
class Ctrl:
    def find_spec(self, name, *_):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Ctrl())
from {place} import command
sys.argv = {argv!r}
sys.exit(command())
"""
PRINTED = """
import sys
from {place} import command
sys.argv = {argv!r}
if {unbuffered}:
    sys.stdout.reconfigure(write_through=True)
sys.exit(command())
"""
posix = pytest.mark.skipif(sys.platform == "win32", reason="other signals, files and errors there")


def run(program: str, stdout: int | None = subprocess.PIPE) -> tuple[int, str, str]:
    """Status, standard output and standard error of a process."""
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=buffered | {"PYTHONPATH": str(ROOT)},
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
    )
    return done.returncode, done.stdout, done.stderr


@posix
@pytest.mark.parametrize("module", ["numpy.linalg", "nls.cli.parser", "nls.graph"])
def test_ctrl_c_while_nls_is_imported(module: str, shell: Shell) -> None:
    argv = ["nls", "solve", shell.file(), "-o", "out.g2o"]
    status, out, err = run(SIGNALLED.format(module=module, place="nls.cli", argv=argv))
    assert (status, out) == (130, "")
    assert err.startswith("nls: interrupted ")
    assert err.endswith("; nothing was written\n")
    assert err.count("\n") == 1
    assert not (shell / "out.g2o").exists()


@posix
def test_ctrl_c_while_nls_sim_is_imported() -> None:
    program = SIGNALLED.format(module="sim.worlds.torus", place="sim.process", argv=["nls-sim", "ring"])
    assert run(program) == (130, "", "nls-sim: interrupted at its start; nothing was written\n")
    ignoring = program.replace("signal.default_int_handler", "signal.SIG_IGN")
    status, out, err = run(ignoring.replace("sim.worlds.torus", "numpy"))
    assert (status, out[:6], err) == (0, "world ", "")


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("function", "doing", "written"),
    [
        ("nls.load", "while reading graph.g2o", 0),
        ("nls.initialize", "while computing the initial guess of graph.g2o", 0),
        ("nls.FactorGraph.optimize", "while solving graph.g2o", 0),
        ("nls.cli.formats.rendered", "while writing o", 0),
        ("nls.io.table.write_covariances", "while writing o.csv: marginals", 1),
        ("nls.plot.picture.write_picture", "while writing o.png", 2),
        ("nls.certify", "while certifying the optimum", 3),
        ("nls.cli.solve_report._facts", "while writing o.html: outliers", 3),
        ("nls.cli.solve.write_json", "while writing the report", 4),
        ("nls.cli.solve.table", "while writing the report", 5),
    ],
)
def test_the_line_is_true_in_every_phase_of_solve(
    function: str, doing: str, written: int, shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files that the line names are there; nothing else is, no temporary file either."""
    monkeypatch.setattr(function, interrupted)
    names = ["o", "o.csv", "o.png", "o.html", "o.json"]
    options = "-o o --to g2o --covariance o.csv --plot o.png --report o.html --json o.json"
    said = f"written: {', '.join(names[:written])}" if written else "nothing was written"
    expected = ("", f"nls: interrupted {doing}; {said}\n")
    assert shell.both(f"solve {shell.file()} --certify {options}", 130) == expected
    assert shell.contents().keys() == {"graph.g2o", *names[:written]}


@pytest.mark.parametrize(
    ("words", "function", "doing"),
    [
        ("info graph.g2o", "nls.analysis.inspection.inspect", "while inspecting graph.g2o"),
        ("explain graph.g2o", "nls.explain", "while explaining graph.g2o: iteration 2, chi2 0.195465"),
        ("convert graph.g2o a.tum", "nls.io.files.write_bytes", "while writing a.tum"),
        ("plot graph.g2o a.png", "nls.plot.trajectory", "while writing a.png"),
    ],
)
def test_the_line_of_other_commands(
    words: str, function: str, doing: str, shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    shell.file()
    monkeypatch.setattr(function, interrupted)
    written = "no findings yet; nls solve -o OUT" if "explain" in words else "nothing was written"
    out, err = shell.both(words, 130)
    assert (out, err.startswith(f"nls: interrupted {doing}; {written}")) == ("", True)


def test_an_interrupted_explanation_says_what_is_known(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = shell(f"explain {shell.file(SPOILED)}").splitlines()
    monkeypatch.setattr("nls.explanation.explanation.unverified_groups", interrupted)  # the last of the search
    out, err = shell.both("explain graph.g2o", 130)
    assert (err, "1. interrupted: the search for outliers and their causes has not ended" in out) == ("", True)
    outlier = next(line for line in whole if "a loop closure, is probably wrong" in line)
    assert {outlier.replace("1. ", "2. "), *whole[whole.index("rank        21 of 21 unknowns") :]} <= {
        *out.splitlines()
    }


@posix
def test_ctrl_c_between_the_phases() -> None:
    """Outside of what `main` looks after, such as a second one while the line is printed."""
    late = "import os, signal, sys\nimport nls.cli\nfrom nls.cli.phase import Phase\n"
    late += "def main(phase, **_):\n    phase.now('while writing a.png')\n    os.kill(os.getpid(), signal.SIGINT)\n"
    late += "signal.signal(signal.SIGINT, signal.default_int_handler)\nnls.cli.main = main\nsys.exit(nls.cli.command())"
    assert run(late) == (130, "", "nls: interrupted while writing a.png; nothing was written\n")


def interrupted(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
@pytest.mark.parametrize(
    ("place", "argv", "unbuffered"),
    [
        ("nls.cli", ["nls", "info", "graph.g2o"], True),
        ("nls.cli", ["nls", "--version"], False),
        ("sim.process", ["nls-sim", "ring"], True),
    ],
)
def test_standard_output_that_is_full(place: str, argv: list[str], unbuffered: bool, shell: Shell) -> None:
    shell.file()
    full = os.open("/dev/full", os.O_WRONLY)
    try:
        status, _, err = run(PRINTED.format(place=place, argv=argv, unbuffered=unbuffered), full)
    finally:
        os.close(full)
    assert (status, err) == (2, f"{argv[0]}: standard output cannot be written: No space left on device\n")


@posix
@pytest.mark.parametrize("unbuffered", [False, True])
def test_standard_output_that_nobody_reads(unbuffered: bool, shell: Shell) -> None:
    """As before ``| head -1``: no word, no other status, and files are written."""
    argv = ["nls", "solve", shell.file(), "--json", "-", "-o", "out.g2o"]
    read, pipe = os.pipe()
    os.close(read)
    try:
        status, _, err = run(PRINTED.format(place="nls.cli", argv=argv, unbuffered=unbuffered), pipe)
    finally:
        os.close(pipe)
    assert (status, err) == (0, "")
    assert (shell / "out.g2o").exists()


@posix
def test_standard_output_that_is_closed(shell: Shell) -> None:
    program = "import os, sys\nos.close(1)\nos.execv(sys.executable, [sys.executable, '-m', 'nls', 'info', {!r}])"
    assert run(program.format(shell.file()))[::2] == (0, "")


@posix
@pytest.mark.parametrize("closed", [(2,), (0, 1, 2)])
def test_standard_error_that_is_closed(closed: tuple[int, ...], shell: Shell) -> None:
    """Results are as they were, what is said there is said nowhere, and no file gets the number of standard error."""
    good, unknown = shell.file(), shell.file(PLANE + "OTHER 1\n", "other.g2o")
    program = "import os, sys\nfor k in {}: os.close(k)\nos.execv(sys.executable, [sys.executable, '-m', {!r}, *{!r}])"
    for module, words, status in (
        ("nls", ["solve", good, "-o", "out.g2o", "--json", "r.json"], 0),
        ("nls", ["solve", unknown, "-o", "other.toro"], 0),
        ("nls", ["solve", "lost.g2o"], 2),
        ("nls", ["stream", good], 0),
        ("sim", ["ring", "--laps", "1", "--per-lap", "4"], 0),
    ):
        done, out, err = run(program.format(closed, module, words))
        assert (done, err) == (status, ""), words
        assert "nls" not in out.replace("nls-sim ring", ""), words
    text = (shell / "out.g2o").read_text()
    assert "VERTEX_SE2" in text
    assert "nls" not in text
