"""The benchmark of pose graphs, as its users start it: without a peer, on simulated worlds and on public sets."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "benchmarks" / "posegraphs.py"


def run(out: Path, *options: str, data: Path | None = None) -> dict[str, Any]:
    if not SCRIPT.exists():
        pytest.skip("there are no benchmarks here (an installed copy has none)")
    env = {k: v for k, v in os.environ.items() if k != "LEADLINE_DATA"}
    env["PYTHONPATH"] = str(ROOT)
    if data is not None:
        env["LEADLINE_DATA"] = str(data)
    command = [sys.executable, str(SCRIPT), "--rounds", "1", "--out", str(out), *options]
    done = subprocess.run(command, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads((out / "posegraphs.json").read_text())
    return found


def check(found: dict[str, Any]) -> dict[str, Any]:
    """What holds of every set; gives leadline's run."""
    ours: dict[str, Any] = found["runs"]["leadline"]["auto"]
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
    return ours


def test_quick_on_simulated_worlds_and_a_peer_that_fails(tmp_path: Path) -> None:
    """An interpreter that has no such package: it has no ratio, the run goes on, its last words are in the table."""
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho 'no such library here' >&2\nexit 3\n")
    broken.chmod(0o755)
    results = run(tmp_path, "--quick", "--python", f"gtsam={broken}")
    assert results["simulated"]
    assert list(results["sets"]) == ["ring", "smallGrid3D"]
    text = (tmp_path / "posegraphs.md").read_text()
    assert "simulated worlds" in text
    assert "failed: no such library here" in text
    for name, found in results["sets"].items():
        ours = check(found)
        assert 0.8 < ours["chi2"]["g2o"] / found["dof"] < 1.25  # the noise of the file is the noise of the world
        assert f"| {name} | {found['edges']:,} | leadline |" in text
        assert {run["failed"] for run in found["runs"]["gtsam"].values()} == {"no such library here"}
        assert "gtsam" not in found["ratio"]


def test_wrong_options_are_refused(tmp_path: Path) -> None:
    for words in ("--rounds 0", "--sets nowhere", "--python nobody=/bin/sh", "--python gtsam=/no"):
        options = words.split()
        command = [sys.executable, str(SCRIPT), "--out", str(tmp_path), *options]
        done = subprocess.run(command, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
        assert done.returncode == 2
        assert options[1].split("=")[-1] in done.stderr
