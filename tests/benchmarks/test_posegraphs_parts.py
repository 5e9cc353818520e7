"""The judgement of the pose-graph benchmark, and the edge functions it hands to libraries that have none."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from factors import Between, Information
from models import SE2, SE3
from nls import FactorGraph, Values, kinds

FOLDER = Path(__file__).parents[2] / "benchmarks"


def run(load: float, optimize: float, g2o: float, gtsam: float) -> dict[str, Any]:
    cpu = {"load": load, "start": 1.0, "optimize": optimize}
    return {"cpu": cpu, "total": sum(cpu.values()), "chi2": {"g2o": g2o, "gtsam": gtsam}}


def test_only_who_reached_the_optimum_counts(part: Callable[[str], Any]) -> None:
    modules = {
        "leadline": SimpleNamespace(COST="g2o", READS=True),
        "gtsam": SimpleNamespace(COST="gtsam", READS=True),
        "g2o": SimpleNamespace(COST="g2o", READS=False),
    }
    free = run(500.0, 39.0, 100.00001, 205.0) | {"total": 40.0}
    runs = {
        "leadline": {"auto": run(10.0, 9.0, 100.00005, 203.0)},
        "gtsam": {
            "elsewhere": run(1.0, 1.0, 100.0, 210.0),
            "early": run(1.0, 2.0, 100.0, 200.001),
            "quick": run(1.0, 38.0, 101.0, 200.0),
            "slow": run(1.0, 78.0, 101.0, 199.99999),
            "refused": {"failed": "no"},
        },
        "g2o": {"tree": free},
    }
    found: dict[str, Any] = {"optimum": {"g2o": 100.0, "gtsam": 200.0}, "runs": runs}
    part("posegraphs").judge(found, modules, 30)
    outcomes = {variant: run.get("outcome") for variant, run in runs["gtsam"].items()}
    assert outcomes == {
        "elsewhere": "another optimum",
        "early": "not converged",
        "quick": "optimum",
        "slow": "optimum",
        "refused": None,
    }
    assert found["fastest"] == {"leadline": "auto", "gtsam": "quick", "g2o": "tree"}
    assert found["ratio"] == {"gtsam": 20.0 / 40.0, "g2o": 10.0 / 40.0}
    assert found["theirs_is_lower"] == []


def test_a_worse_optimum_of_ours_is_said(part: Callable[[str], Any]) -> None:
    modules = {name: SimpleNamespace(COST="g2o", READS=True) for name in ("leadline", "gtsam")}
    for chi2, lower, outcome in ((100.0, ["gtsam"], "optimum"), (120.0, [], "another optimum")):
        runs = {"leadline": {"auto": run(1.0, 1.0, 110.0, 0.0)}, "gtsam": {"a": run(1.0, 1.0, chi2, 0.0)}}
        found: dict[str, Any] = {"optimum": {"g2o": 110.0}, "runs": runs}
        part("posegraphs").judge(found, modules, 30)
        assert (found["theirs_is_lower"], runs["gtsam"]["a"]["outcome"]) == (lower, outcome)


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


def test_the_gate_times_this_library_and_its_yardstick(part: Callable[[str], Any], tmp_path: Path) -> None:
    ours, yardstick = part("posegraphs").clocks(part("posegraphs").prepare("ring", tmp_path, None))
    assert 0.2 < ours() / yardstick() < 50  # 3 measured
    baselines = json.loads((FOLDER / "baselines_posegraphs.json").read_text())
    assert set(baselines["ratios"]) == set(part("posegraphs").SETS)


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_edge_functions_are_the_factors_of_the_library(group: Any, part: Callable[[str], Any]) -> None:
    """Residuals as of the convention g2o, and Jacobians for a translation in the world and a rotation in the body."""
    rng, (x,) = np.random.default_rng(3), kinds("x")
    n, d = 20, group.dim
    X, Y = (group.exp(rng.normal(size=(n, d))) for _ in range(2))
    z = group.compose(group.compose(group.inverse(X), Y), group.exp(0.3 * rng.normal(size=(n, d))))
    M = rng.normal(size=(n, d, d))
    information = M @ M.mT + 0.1 * np.eye(d)
    made = part("peers.edges").edges({"z": z, "information": information}, group is SE3)

    def moved(P: Any, k: int, step: float) -> Any:
        t = 2 if group is SE2 else 3
        shift, turn = np.zeros(d), np.zeros(d)
        (shift if k < t else turn)[k] = step
        Q = group.compose(P[None], group.exp(turn[None]))[0]
        Q[:t] += shift[:t]
        return Q

    step = 1e-6
    for k, edge in enumerate(made):
        noise = Information(information[k])
        graph = FactorGraph([Between(x[0], x[1], z[k], noise, convention="g2o")])
        r, Ji, Jj = edge(X[k], Y[k])
        assert r @ r == pytest.approx(graph.chi2(Values({x: (group, np.stack([X[k], Y[k]]))})), rel=1e-9)
        for c in range(d):
            di = (edge(moved(X[k], c, step), Y[k])[0] - edge(moved(X[k], c, -step), Y[k])[0]) / (2 * step)
            dj = (edge(X[k], moved(Y[k], c, step))[0] - edge(X[k], moved(Y[k], c, -step))[0]) / (2 * step)
            assert Ji[:, c] == pytest.approx(di, abs=1e-7)
            assert Jj[:, c] == pytest.approx(dj, abs=1e-7)
