"""The judgement of the pose-graph benchmark, and its gate."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np


def run(load: float, optimize: float, g2o: float, gtsam: float) -> dict[str, Any]:
    cpu = {"load": load, "start": 1.0, "optimize": optimize}
    return {"cpu": cpu, "total": sum(cpu.values()), "chi2": {"g2o": g2o, "gtsam": gtsam}}


def test_only_who_reached_the_optimum_counts(part: Callable[[str], Any]) -> None:
    modules = {"leadline": SimpleNamespace(COST="g2o"), "gtsam": SimpleNamespace(COST="gtsam")}
    runs = {
        "leadline": {"auto": run(10.0, 9.0, 100.00005, 203.0)},
        "gtsam": {
            "elsewhere": run(1.0, 1.0, 100.0, 210.0),
            "early": run(1.0, 2.0, 100.0, 200.001),
            "quick": run(1.0, 38.0, 101.0, 200.0),
            "slow": run(1.0, 78.0, 101.0, 199.99999),
            "refused": {"failed": "no"},
        },
    }
    found: dict[str, Any] = {"optimum": {"g2o": 100.0, "gtsam": 200.0}, "runs": runs}
    part("posegraphs").judge(found, modules, 30)
    outcomes = [run.get("outcome") for run in runs["gtsam"].values()]
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
