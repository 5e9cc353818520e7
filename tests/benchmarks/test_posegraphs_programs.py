"""C++ contenders of the pose-graph benchmark: compiled where they can be, and named where they cannot."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"
ECHO = """
#include "driver.h"

int main(int, char** argv) {
  const Arguments arguments(argv);
  if (arguments.has("LM")) return failed("no such method");
  Record record(arguments.stem);
  for (const char* stage : {"load", "start", "optimize"})
    record.timed(stage, [] { for (volatile int k = 0; k < 100000; k = k + 1) {} });
  record.optimized();
  record.pose(3, {0.1 + 0.2, -1e-17, arguments.tolerance});
  record.pose(12, {1.0 / 3, arguments.space ? 1.0 : 0.0, static_cast<double>(arguments.max_iterations)});
  record.write(7, 0.1, "Echo 1.0");
}
"""


def source(folder: Path, text: str) -> Path:
    if shutil.which("g++") is None:
        pytest.skip("there is no g++ here")
    shutil.copy(FOLDER / "peers" / "driver.h", folder)
    path = folder / "echo.cpp"
    path.write_text(text)
    return path


def test_a_program_leaves_its_clocks_and_poses_to_the_last_digit(part: Callable[[str], Any], tmp_path: Path) -> None:
    program = part("peers.programs").compiled(source(tmp_path, ECHO), (), tmp_path)
    peers = part("peers")
    files = peers.Files(tmp_path / "a.g2o", tmp_path / "b.g2o", True)
    out = tmp_path / "g2o_cpp-file, GN.npz"
    record = part("posegraphs").launch(str(program), "g2o_cpp", "file, GN", files, out, False)
    assert (record["iterations"], record["cost"]) == (7, 0.1)
    assert list(record["said"]) == ["version"]
    assert record["said"]["version"].startswith("Echo 1.0, g++ ")
    assert 0.5 < record["peak"] < 100
    for clock in ("cpu", "wall"):
        assert list(record[clock]) == ["load", "start", "optimize"]
        assert all(milliseconds > 0 for milliseconds in record[clock].values())
    with np.load(out) as poses:
        assert poses["ids"].tolist() == [3, 12]
        assert poses["X"].tolist() == [[0.1 + 0.2, -1e-17, peers.TOLERANCE], [1 / 3, 1.0, files.most]]
    failed = part("posegraphs").launch(str(program), "g2o_cpp", "file, LM", files, out, False)
    assert failed == {"failed": "Error: no such method"}


def test_a_program_that_cannot_be_made_says_why(part: Callable[[str], Any], tmp_path: Path) -> None:
    programs = part("peers.programs")
    for text, libraries, why in (
        ("#include <no/such/header.h>\n", (), "no/such/header.h: No such file"),
        ("int main() {}\n", ("no_such_library",), "-lno_such_library"),
    ):
        with pytest.raises(programs.NotCompiledError, match=r"echo\.cpp does not compile: .*" + why):
            programs.compiled(source(tmp_path, text), libraries, tmp_path)
