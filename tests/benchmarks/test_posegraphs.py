"""The benchmark of pose graphs, as its users start it; its judgement, its gate, and its contenders in C++."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.benchmarks.conftest import FOLDER, run


def test_quick_on_simulated_worlds_and_a_peer_that_fails(tmp_path: Path) -> None:
    """An interpreter that has no such package: it has no ratio, the run goes on, its last words are in the table."""
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho 'no such library here' >&2\nexit 3\n")
    broken.chmod(0o755)
    done = run("posegraphs.py", "--rounds", 1, "--out", tmp_path, "--quick", "--python", f"gtsam={broken}")
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "posegraphs.json").read_text())
    assert results["simulated"]
    assert list(results["sets"]) == ["ring", "smallGrid3D"]
    text = (tmp_path / "posegraphs.md").read_text()
    assert "simulated worlds" in text
    assert "failed: no such library here" in text
    for name, found in results["sets"].items():
        ours = found["runs"]["leadline"]["auto"]
        assert ours["said"]["converged"]
        assert ours["outcome"] == "optimum"
        assert ours["chi2"]["g2o"] == pytest.approx(ours["cost"], rel=1e-9)
        assert found["optimum"]["g2o"] <= ours["chi2"]["g2o"] <= found["optimum"]["g2o"] * (1 + 1e-6)
        assert found["optimum"]["gtsam"] <= ours["chi2"]["gtsam"]
        assert ours["said"]["dof"] == found["dof"]
        assert ours["total"] == pytest.approx(sum(ours["cpu"].values()))
        assert {"load", "start", "optimize"} == set(ours["cpu"]) == set(ours["wall"])
        assert all(milliseconds > 0 for milliseconds in ours["cpu"].values())
        assert ours["peak"] > 20
        assert found["marginals"]["leadline"] > 0
        assert found["fastest"]["leadline"] == "auto"
        assert set(found["ratio"]) == set(found["fastest"]) - {"leadline"}
        for peer, ratio in found["ratio"].items():
            assert ratio > 0
            assert found["runs"][peer][found["fastest"][peer]]["outcome"] == "optimum"
        assert 0.8 < ours["chi2"]["g2o"] / found["dof"] < 1.25  # the noise of the file is the noise of the world
        assert f"| {name} | {found['edges']:,} | leadline |" in text
        assert {each["failed"] for each in found["runs"]["gtsam"].values()} == {"no such library here"}
        assert "gtsam" not in found["ratio"]


def test_wrong_options_are_refused(tmp_path: Path) -> None:
    for words in ("--rounds 0", "--sets nowhere", "--python nobody=/bin/sh", "--python gtsam=/no"):
        done = run("posegraphs.py", "--out", tmp_path, *words.split())
        assert done.returncode == 2
        assert words.split()[1].split("=")[-1] in done.stderr


def test_the_last_lines_say_who_was_not_compared(part: Callable[[str], Any]) -> None:
    sets = {"ring": {"ratio": {"gtsam": 1.25}}, "intel": {"ratio": {"gtsam": 0.5, "ceres_cpp": 0.5}}}
    assert [part("posegraphs_report").beside(peer, sets) for peer in ("gtsam", "g2o_cpp", "ceres_cpp")] == [
        "gtsam: compared on 2 of 2 sets; leadline is slower on ring (1.25 of its time)",
        "g2o_cpp: not compared, it has a time on none of 2 sets",
        "ceres_cpp: compared on 1 of 2 sets; leadline is faster on all of them",
    ]


def timed(load: float, optimize: float, g2o: float, gtsam: float) -> dict[str, Any]:
    cpu = {"load": load, "start": 1.0, "optimize": optimize}
    return {"cpu": cpu, "total": sum(cpu.values()), "chi2": {"g2o": g2o, "gtsam": gtsam}}


def test_only_who_reached_the_optimum_counts(part: Callable[[str], Any]) -> None:
    modules = {"leadline": SimpleNamespace(COST="g2o"), "gtsam": SimpleNamespace(COST="gtsam")}
    runs = {
        "leadline": {"auto": timed(10.0, 9.0, 100.00005, 203.0)},
        "gtsam": {
            "elsewhere": timed(1.0, 1.0, 100.0, 210.0),
            "early": timed(1.0, 2.0, 100.0, 200.001),
            "quick": timed(1.0, 38.0, 101.0, 200.0),
            "slow": timed(1.0, 78.0, 101.0, 199.99999),
            "refused": {"failed": "no"},
        },
    }
    found: dict[str, Any] = {"optimum": {"g2o": 100.0, "gtsam": 200.0}, "runs": runs}
    part("posegraphs").judge(found, modules, 30)
    outcomes = [each.get("outcome") for each in runs["gtsam"].values()]
    assert outcomes == ["another optimum", "not converged", "optimum", "optimum", None]
    assert found["fastest"] == {"leadline": "auto", "gtsam": "quick"}
    assert found["ratio"] == {"gtsam": 20.0 / 40.0}
    assert found["theirs_is_lower"] == []


def test_who_computes_another_cost_has_no_time(part: Callable[[str], Any], tmp_path: Path) -> None:
    problem, out = part("posegraphs").prepare("ring", tmp_path, None), tmp_path / "solution.npz"
    stack = problem.values.stack("x")
    np.savez(out, ids=stack.numbers, X=stack.X)
    chi2 = problem.graphs["g2o"].chi2(problem.values)
    for cost, convention, failure in ((chi2 * (1 + 1e-7), "g2o", ""), (chi2 / 2, "g2o", f"its cost is {chi2 / 2:.9g}")):
        run = part("posegraphs").evaluated(problem, {"cost": cost}, out, convention)
        assert run.get("failed", "").startswith(failure)
        assert ("failed" in run) == bool(failure)
    np.savez(out, ids=stack.numbers, X=np.full_like(stack.X, np.nan))
    assert "not finite" in part("posegraphs").evaluated(problem, {"cost": chi2}, out, "g2o")["failed"]


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
