"""``nls solve --sigmas estimate``: table, report, and files with the estimated noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nls
import sim
from factors.rescaled import rescaled
from nls.missions.folder.write import write_mission
from tests.nls.cli.shell import RING, SPOILED, Shell, rows


def too_sure(path: Path) -> None:
    """A file of three laps of a ring of poses that states a third of the sigmas of its errors."""
    world = sim.ring(np.random.default_rng(0), laps=3, per_lap=20)
    models = [world.start.gather(factor)[0] for factor in world.graph.factors]
    nls.save(path, nls.FactorGraph([rescaled(model, np.full((1, model.dim), 1 / 3)) for model in models]), world.start)


def test_the_table_has_a_row_a_kind_and_files_the_estimated_sigmas(shell: Shell) -> None:
    too_sure(shell / "graph.g2o")
    report = shell.report("solve graph.g2o --sigmas estimate -o solved.g2o --covariance c.csv")
    kinds = report["sigmas"]["kinds"]
    assert [kind["kind"] for kind in kinds] == ["Between, steps", "Between, closures"]
    assert all(abs(kind["scale"] - 3) < 3 * kind["scale_sigma"] for kind in kinds)
    assert "solved.g2o holds the estimated sigmas, not the stated ones" in report["notes"]
    again = shell.report("solve solved.g2o --init file")
    assert again["chi2_final"] == pytest.approx(report["chi2_final"], rel=1e-5)
    assert report["chi2_final"] == pytest.approx(report["dof"], rel=0.01)
    stated = shell("solve graph.g2o --covariance stated.csv --allow-doubtful")
    assert not rows(stated, "sigmas")
    ratio = largest(shell / "c.csv") / largest(shell / "stated.csv")
    assert 2.5**2 < ratio < 3.5**2
    table = rows(shell("solve graph.g2o --sigmas estimate:units"), "sigmas")
    assert [row.split(": stated")[0] for row in table][:2] == ["Between, steps: x, y", "Between, steps: yaw"]


def largest(path: Path) -> float:
    """Largest number of a file of covariances."""
    text = path.read_text().splitlines()
    return max(float(word) for line in text[1:] for word in line.split(",")[-6:] if word[:1].isdigit())


def test_a_kernel_and_a_chain_that_nothing_checks(shell: Shell) -> None:
    shell.file(SPOILED)
    out, _ = shell.both("solve graph.g2o --sigmas estimate --robust cauchy:2")
    assert len(rows(out, "sigmas")) == 2
    shell.file("\n".join(RING.splitlines()[:5]) + "\n")
    (row,) = rows(shell("solve graph.g2o --sigmas estimate"), "sigmas")
    assert row == "Between: stated sigmas kept, no other measurement checks them (redundancy 0 of 15 numbers)"


def test_a_mission_has_the_sigmas_of_the_estimated_noise(shell: Shell, undrawn: None) -> None:
    mission = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=6)
    write_mission(shell / "m", mission.graph, mission.sonar, mission.offset, mission.truth)
    report = shell.report("solve m --sigmas estimate -o out")
    assert report["sigmas"]["settled"]
    known = [kind for kind in report["sigmas"]["kinds"] if kind["known"]]
    assert len(known) >= 2
    assert all(abs(np.log(k["scale"])) < 4 * k["scale_sigma"] / k["scale"] + 0.1 for k in known)
    assert (shell / "out" / "trajectory.csv").exists()
