"""Ctrl-C at every moment of a command, and standard output that takes nothing: one line that is true, and a status."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from nls.cli import main
from tests.nls.io.g2o_files import PLANE, write

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


def run(program: str, stdout: int | None = subprocess.PIPE) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
    )


@pytest.mark.skipif(sys.platform == "win32", reason="os.kill sends no Ctrl-C there")
@pytest.mark.parametrize("module", ["numpy", "numpy.linalg", "argparse", "scipy.sparse", "nls.cli.parser", "nls.graph"])
def test_ctrl_c_while_nls_is_imported(module: str, tmp_path: Path) -> None:
    out = tmp_path / "out.g2o"
    argv = ["nls", "solve", str(write(tmp_path, PLANE)), "-o", str(out)]
    done = run(SIGNALLED.format(module=module, place="nls.cli", argv=argv))
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr.startswith("nls: interrupted ")
    assert done.stderr.endswith("; nothing was written\n")
    assert done.stderr.count("\n") == 1
    assert not out.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="os.kill sends no Ctrl-C there")
@pytest.mark.parametrize("module", ["numpy", "scipy.spatial", "sim.cli", "sim.worlds.torus"])
def test_ctrl_c_while_nls_sim_is_imported(module: str) -> None:
    done = run(SIGNALLED.format(module=module, place="sim.process", argv=["nls-sim", "ring"]))
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "nls-sim: interrupted at its start; nothing was written\n"


@pytest.mark.skipif(sys.platform == "win32", reason="os.kill sends no Ctrl-C there")
def test_a_job_that_ignores_ctrl_c_goes_on() -> None:
    program = SIGNALLED.format(module="numpy", place="sim.process", argv=["nls-sim", "ring"])
    done = run(program.replace("signal.default_int_handler", "signal.SIG_IGN"))
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("world ")


@pytest.mark.parametrize(
    ("function", "doing", "written"),
    [
        ("nls.load", "while reading {file}", []),
        ("nls.initialize", "while searching for a start for {file}", []),
        ("nls.FactorGraph.optimize", "while solving {file}", []),
        ("nls.cli.formats.rendered", "while writing {out}", []),
        ("nls.io.covariance_csv.write_covariances", "while writing {out}.csv", [""]),
        ("nls.plot.picture.write_picture", "while writing {out}.png", ["", ".csv"]),
        ("nls.certify", "while certifying the optimum", ["", ".csv", ".png"]),
        ("nls.cli.report._facts", "while writing {out}.html", ["", ".csv", ".png"]),
        ("nls.cli.solve.write_json", "while writing the report", ["", ".csv", ".png", ".html"]),
        ("nls.cli.solve_report.table", "while writing the report", ["", ".csv", ".png", ".html", ".json"]),
    ],
)
def test_the_line_is_true_in_every_phase_of_solve(
    function: str,
    doing: str,
    written: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What it says was written is there; nothing else is, no temporary file either."""
    file, out = write(tmp_path, PLANE), tmp_path / "out.g2o"
    monkeypatch.setattr(function, interrupted)
    options = ["--covariance", f"{out}.csv", "--plot", f"{out}.png", "--report", f"{out}.html", "--json", f"{out}.json"]
    assert main(["solve", str(file), "-o", str(out), "--certify", *options]) == 130
    said = f"written: {', '.join(f'{out}{suffix}' for suffix in written)}" if written else "nothing was written"
    assert capsys.readouterr() == ("", f"nls: interrupted {doing.format(file=file, out=out)}; {said}\n")
    there = {path.name for path in tmp_path.iterdir()} - {file.name}
    assert there == {f"out.g2o{suffix}" for suffix in written}


@pytest.mark.parametrize(
    ("command", "function", "doing"),
    [
        ("info", "nls.analysis.inspection.inspect", "while inspecting {file}"),
        ("explain", "nls.explain", "while explaining {file}"),
        ("convert", "nls.io.files.write_bytes", "while writing {file}.tum"),
        ("plot", "nls.plot.trajectory", "while writing {file}.png"),
    ],
)
def test_the_line_of_other_commands(
    command: str,
    function: str,
    doing: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    file = write(tmp_path, PLANE)
    monkeypatch.setattr(function, interrupted)
    output = {"convert": [f"{file}.tum"], "plot": [f"{file}.png"]}.get(command, [])
    assert main([command, str(file), *output]) == 130
    assert capsys.readouterr() == ("", f"nls: interrupted {doing.format(file=file)}; nothing was written\n")


@pytest.mark.skipif(sys.platform == "win32", reason="os.kill sends no Ctrl-C there")
def test_ctrl_c_between_the_phases() -> None:
    """Outside of what `main` looks after, such as a second one while the line is printed."""
    late = "import os, signal, sys\nimport nls.cli\nfrom nls.cli.phase import Phase\n"
    late += "def main(phase, **_):\n    phase.now('while writing a.png')\n    os.kill(os.getpid(), signal.SIGINT)\n"
    late += "signal.signal(signal.SIGINT, signal.default_int_handler)\nnls.cli.main = main\nsys.exit(nls.cli.command())"
    done = run(late)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "nls: interrupted while writing a.png; nothing was written\n"


def interrupted(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
@pytest.mark.parametrize("unbuffered", [False, True])
@pytest.mark.parametrize(
    ("place", "argv"),
    [("nls.cli", ["nls", "info", "{file}"]), ("nls.cli", ["nls", "--version"]), ("sim.process", ["nls-sim", "ring"])],
)
def test_standard_output_that_is_full(place: str, argv: list[str], unbuffered: bool, tmp_path: Path) -> None:
    argv = [word.format(file=write(tmp_path, PLANE)) for word in argv]
    program = f"import sys\nfrom {place} import command\nsys.argv = {argv!r}\n"
    program += "sys.stdout.reconfigure(write_through=True)\n" * unbuffered + "sys.exit(command())"
    full = os.open("/dev/full", os.O_WRONLY)
    try:
        done = run(program, full)
    finally:
        os.close(full)
    assert done.returncode == 2
    assert done.stderr == f"{argv[0]}: standard output cannot be written: No space left on device\n"


@pytest.mark.skipif(sys.platform == "win32", reason="other errors there")
@pytest.mark.parametrize("unbuffered", [False, True])
@pytest.mark.parametrize(
    ("place", "argv"),
    [("nls.cli", ["nls", "solve", "{file}", "--json", "-", "-o", "{file}.g2o"]), ("sim.process", ["nls-sim", "ring"])],
)
def test_standard_output_that_nobody_reads(place: str, argv: list[str], unbuffered: bool, tmp_path: Path) -> None:
    """As before ``| head -1``: no word, no other status, and files are written."""
    argv = [word.format(file=write(tmp_path, PLANE)) for word in argv]
    program = f"import sys\nfrom {place} import command\nsys.argv = {argv!r}\n"
    program += "sys.stdout.reconfigure(write_through=True)\n" * unbuffered + "sys.exit(command())"
    read, pipe = os.pipe()
    os.close(read)
    try:
        done = run(program, pipe)
    finally:
        os.close(pipe)
    assert (done.returncode, done.stderr) == (0, "")
    assert Path(argv[-1]).exists() == ("-o" in argv)


@pytest.mark.skipif(sys.platform == "win32", reason="other processes there")
def test_standard_output_that_is_closed(tmp_path: Path) -> None:
    file = write(tmp_path, PLANE)
    program = "import os, sys\nos.close(1)\nos.execv(sys.executable, [sys.executable, '-m', 'nls', 'info', {!r}])"
    done = run(program.format(str(file)))
    assert (done.returncode, done.stderr) == (0, "")
