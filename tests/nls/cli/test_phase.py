"""Ctrl-C at every moment of a command, and standard output that takes nothing: one line that is true, and a status."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.nls.cli.shell import Shell
from tests.nls.io.g2o_files import PLANE

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
        ("nls.initialize", "while searching for a start for graph.g2o", 0),
        ("nls.FactorGraph.optimize", "while solving graph.g2o", 0),
        ("nls.cli.formats.rendered", "while writing o", 0),
        ("nls.io.table.write_covariances", "while writing o.csv", 1),
        ("nls.plot.picture.write_picture", "while writing o.png", 2),
        ("nls.certify", "while certifying the optimum", 3),
        ("nls.cli.solve_report._facts", "while writing o.html", 3),
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
        ("explain graph.g2o", "nls.explain", "while explaining graph.g2o"),
        ("convert graph.g2o a.tum", "nls.io.files.write_bytes", "while writing a.tum"),
        ("plot graph.g2o a.png", "nls.plot.trajectory", "while writing a.png"),
    ],
)
def test_the_line_of_other_commands(
    words: str, function: str, doing: str, shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    shell.file()
    monkeypatch.setattr(function, interrupted)
    assert shell.both(words, 130) == ("", f"nls: interrupted {doing}; nothing was written\n")


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
