"""The benchmarks that guard and describe speed: what the guard answers, and that every table can be made."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from nls import Cholesky
from tests.benchmarks.conftest import run

QUICK = ("build", "linearize SE2")

pytestmark = pytest.mark.skipif(Cholesky.missing() is not None, reason="the references need CHOLMOD")


def table(folder: Path, script: str, world: str, *arguments: object) -> dict[str, list[str]]:
    """Cells of the rows of a world, by the method in the fifth."""
    done = run(f"{script}.py", "--quick", *arguments, "--out", folder)
    assert done.returncode == 0, done.stderr
    lines = [line for line in (folder / f"{script}.md").read_text().splitlines() if line.startswith(f"| {world}")]
    return {line.split("|")[5].strip(" `"): [cell.strip() for cell in line.split("|")] for line in lines}


def test_the_guard_measures_what_is_asked_for_and_wants_a_baseline(tmp_path: Path) -> None:
    file = tmp_path / "baselines.json"
    file.write_text(json.dumps({"machine": ["any"], "ratios": {"build": 1e3}}))
    done = run("guard.py", "--baselines", file, "--seconds", 0.05, "--only", *QUICK)
    assert tuple(line[:20].strip() for line in done.stdout.splitlines()[1:]) == QUICK
    assert done.returncode == 1
    assert done.stderr == "guard: no baseline for linearize SE2: make them with --update\n"


def test_a_table_of_sizes(tmp_path: Path) -> None:
    """Times and memory of every stage."""
    done = run("scaling.py", "--largest", 1000, "--only", "grid3d", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    (world,) = json.loads((tmp_path / "scaling.json").read_text())["worlds"]
    (found,) = world["runs"]
    assert (world["world"], found["converged"]) == ("grid3d", True)
    assert found["edges"] == pytest.approx(1000, rel=0.1)
    for what in ("seconds", "wall"):
        stages = dict(found[what])
        assert stages.pop("total") == pytest.approx(sum(stages.values()))
        assert min(stages.values()) > 0  # a stage that is never entered is one whose method was renamed
    assert 3e7 < found["bytes"]["factorize"] <= found["bytes"]["total"] < 1e9
    assert (tmp_path / "scaling.png").stat().st_size > 1e4
    assert "| edges | variables | read |" in (tmp_path / "scaling.md").read_text()


def test_all_elimination_orders_give_the_same_step(tmp_path: Path) -> None:
    rows = table(tmp_path, "schur", "floor", "--flops", "1e10")
    assert list(rows) == ["schur", "cholesky", "natural"]
    assert rows["natural"][7] == "not run"
    flops = {name: float(cells[10].replace(",", "")) for name, cells in rows.items()}
    assert flops["natural"] > 20 * max(flops["schur"], flops["cholesky"])
    for name in ("schur", "cholesky"):
        assert float(rows[name][7]) > 0
        assert float(rows[name][12]) < 1e-12


def test_every_stage_of_closing_loops_is_timed() -> None:
    done = run("scans.py", "--child", "whole", 60)
    assert done.returncode == 0, done.stderr
    seconds = json.loads(done.stdout)["seconds"]
    assert min(seconds[stage] for stage in ("pairs", "windows", "matching", "solving")) > 0
