"""The benchmark of pose graphs, as its users start it: without a peer, on simulated worlds and on public sets."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.benchmarks.conftest import run


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
