"""The benchmarks that guard and describe speed: what the guard answers, and that the table of sizes can be made."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from nls import Cholesky

ROOT = Path(__file__).parents[1]
SCRIPTS = ROOT / "benchmarks"
QUICK = ("build", "linearize SE2")

pytestmark = [
    pytest.mark.skipif(not SCRIPTS.exists(), reason="there are no benchmarks here (an installed copy has none)"),
    pytest.mark.skipif(Cholesky.missing() is not None, reason="the references need CHOLMOD"),
]


def run(script: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-W", "error", str(SCRIPTS / script), *map(str, arguments)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def guard(folder: Path, **baselines: float) -> subprocess.CompletedProcess[str]:
    file = folder / "baselines.json"
    file.write_text(json.dumps({"machine": ["any"], "ratios": {k.replace("_", " "): r for k, r in baselines.items()}}))
    return run("guard.py", "--baselines", file, "--seconds", 0.05, "--only", *QUICK)


def test_the_guard_names_what_exceeds_its_baseline_and_nothing_else(tmp_path: Path) -> None:
    generous = guard(tmp_path, build=1e3, linearize_SE2=1e3)
    assert (generous.returncode, generous.stderr) == (0, "")
    ratios = {line[:20].strip(): float(line[20:].split()[0]) for line in generous.stdout.splitlines()[1:]}
    assert tuple(ratios) == QUICK
    exceeded = guard(tmp_path, build=ratios["build"] / 4, linearize_SE2=1e3)
    assert exceeded.returncode == 1
    assert exceeded.stderr.startswith("guard: build: ")
    assert exceeded.stderr.count("\n") == 1


def test_the_guard_wants_a_baseline_for_every_ratio(tmp_path: Path) -> None:
    one = guard(tmp_path, build=1e3)
    assert one.returncode == 1
    assert one.stderr == "guard: no baseline for linearize SE2: make them with --update\n"


def test_the_committed_baselines_are_those_of_the_guard() -> None:
    found = json.loads((SCRIPTS / "baselines.json").read_text())
    assert len(found["machine"]) == 3
    refused = run("guard.py", "--only", "nothing")
    assert refused.returncode == 2
    assert refused.stderr.endswith(f"no ratio nothing; there are {', '.join(found['ratios'])}\n")


def test_a_table_of_sizes(tmp_path: Path) -> None:
    """Times and memory of every stage."""
    done = run("scaling.py", "--largest", 1000, "--only", "manhattan", "grid3d", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    worlds = json.loads((tmp_path / "scaling.json").read_text())["worlds"]
    assert [world["world"] for world in worlds] == ["manhattan", "grid3d"]
    for world in worlds:
        (found,) = world["runs"]
        assert found["converged"]
        assert found["edges"] == pytest.approx(1000, rel=0.1)
        for what in ("seconds", "wall"):
            stages = dict(found[what])
            assert stages.pop("total") == pytest.approx(sum(stages.values()))
            assert min(stages.values()) > 0  # a stage that is never entered is one whose method was renamed
        assert 3e7 < found["bytes"]["factorize"] <= found["bytes"]["total"] < 1e9
    assert (tmp_path / "scaling.png").stat().st_size > 1e4
    assert "| edges | variables | read |" in (tmp_path / "scaling.md").read_text()
