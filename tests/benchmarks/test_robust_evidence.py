"""The evidence about wrong closures: what is planted, what is counted, and what tells a failed trial."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from json import dumps
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import nls
import sim
from factors import Between, Diagonal
from models import SE2
from nls import FactorGraph
from nls.robust.loop_graph import loop_graph, neighbors

SCRIPT = "robust"


@pytest.fixture
def trials(script: Callable[[str], Any]) -> Any:
    return script("robust_trials")


@pytest.fixture
def planting(script: Callable[[str], Any]) -> Any:
    return script("wrong_closures")


@pytest.fixture
def ring(planting: Any, tmp_path: Path) -> Any:
    """Four laps of 60 poses with 60 right closures, these to 6 cm and 0.02 rad, from a file, solved."""
    world = sim.ring(np.random.default_rng(3), laps=4, per_lap=60)
    steps, loops = world.graph.factors
    graph = FactorGraph([steps, Between(*loops.keys, loops.z, Diagonal(x=0.06, y=0.06, yaw=0.02))])
    nls.save(tmp_path / "ring.g2o", graph, world.start)
    return planting.solved(tmp_path / "ring.g2o")


def test_what_is_solved(ring: Any) -> None:
    """240 poses, 60 closures; the optimum is nearer to itself than the odometry is, in parts of 32 m and more."""
    assert (len(ring.edges), ring.loops.sum(), len(ring.best.stack("x"))) == (299, 60, 240)
    assert 32 < ring.extent < 36
    assert ring.off(ring.best) < 1e-9 < 0.002 < ring.off(ring.start) < 0.2


@pytest.mark.parametrize("kind", ["random", "grouped", "local in groups", "alias", "alias in groups"])
def test_planted_closures(planting: Any, ring: Any, kind: str) -> None:
    """As many as asked for, wrong, of the weights of right ones; those of one group agree where they are aliases."""
    wrong = planting.spoiled(ring, 40, kind, np.random.default_rng(1))
    i, j = (keys.numbers for keys in wrong.keys)
    assert len(wrong) == 40
    assert (np.abs(i - j) > 1).all()
    assert (np.abs(i - j) <= 20).all() == kind.startswith("local")
    assert np.median(wrong.chi2(ring.best)) > 100
    np.testing.assert_allclose(wrong.bind(SE2, SE2).W, [[1 / 0.06, 1 / 0.06, 50]])
    groups = kind.endswith(("grouped", "groups"))
    if not kind.startswith("alias"):
        assert np.abs(wrong.z).max() < 5 * 0.3  # one place, they say
        assert (len(np.unique(wrong.z, axis=0)) == 4) == groups
    if groups:
        assert (np.diff(i.reshape(4, 10), axis=1) == 1).all()
        assert (np.diff(j.reshape(4, 10), axis=1) == 1).all()
    if kind.startswith("alias"):
        loops = loop_graph(FactorGraph([ring.edges, wrong]), ring.best)
        near = neighbors(loops.closures, loops.odometry, ring.best.stack("x").X)
        support, cluster = near.support[60:], near.cluster[60:]
        assert (np.mean(support >= 8) > 0.9) == groups
        assert not groups or (cluster.reshape(-1, 10) == cluster[::10, None]).mean() > 0.9
    again = planting.spoiled(ring, 40, kind, np.random.default_rng(1))
    np.testing.assert_array_equal(again.z, wrong.z)


def test_a_trial(trials: Any, planting: Any, ring: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """`nls.gnc` solves the ring; trials come back from their file."""
    monkeypatch.setitem(planting.SETS, "ring", "ring.g2o")
    task = trials.Task("kinds", "ring", "alias in groups", 0.4, 0)
    found = trials.tried(tmp_path, task)
    assert (found.right, found.wrong, found.accepted, found.outcome) == (60, 40, 0, "solved")
    path = tmp_path / "trials"
    path.write_text("".join(dumps(asdict(trial)) + "\n" for trial in (found, found)))
    assert trials.kept_in(path) == [found, found]
    assert trials.kept_in(tmp_path / "none") == []
    assert trials.run(tmp_path, [task], path, 1, 0.0) == [found, found]  # nothing begins after 0 minutes


def test_what_is_counted(
    trials: Any, planting: Any, ring: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """By hand: 6 of 60 right closures rejected, and 30 of 40 wrong ones."""
    weights = [np.ones(299), np.zeros(40)]
    weights[0][np.flatnonzero(ring.loops)[:6]] = 0
    weights[1][:10] = 1
    result = SimpleNamespace(values=ring.start, converged=False)
    found = SimpleNamespace(result=result, weights=weights, doubts=())
    monkeypatch.setitem(planting.SETS, "ring", "ring.g2o")
    monkeypatch.setattr(nls, "gnc", lambda *_: found)
    trial = trials.tried(tmp_path, trials.Task("kinds", "ring", "grouped", 0.4, 0))
    assert (trial.right, trial.lost, trial.wrong, trial.accepted) == (60, 6, 40, 10)
    assert (trial.doubts, trial.outcome) == (["NOT_CONVERGED"], "doubtful")
    assert replace(trial, doubts=[]).outcome == ("silent" if trial.off >= 0.01 else "solved")
    assert [replace(trial, doubts=[], off=off).outcome for off in (0.009, 0.011)] == ["solved", "silent"]


def test_tables(evidence: Any, trials: Any) -> None:
    """By hand: two solved, one doubtful, one silent; three of four maps are right."""
    made = [
        trials.Trial(trials.Task(table, "intel", "local", 0.5, k), off, doubts, 100, 1, 100, 2, 3.0)
        for table in ("kinds", "protocol")
        for k, (off, doubts) in enumerate([(0.001, []), (0.002, []), (0.003, ["RIVAL"]), (0.2, [])])
    ]
    (row,) = [line for line in evidence.by_kind(made) if line.startswith("| intel")]
    assert row == "| intel | local |  |  | 2 / 1 / 1 |  | 3.0 |"
    (row,) = [line for line in evidence.protocol(made) if line.startswith("| intel")]
    assert row.count("75 (4)") == 1
    assert "**2 of 8 trials.**" in "\n".join(evidence.tables(made, []))


def test_real_closures(data: Path, script: Callable[[str], Any]) -> None:
    """Bovisa04: of 197 closures 75 are within 2 m of GPS and 93 off by more than 5; odometry is off by 11 m."""
    log = script("robust_real").bovisa(data / "robust-real")
    assert ((log.off < 2).sum(), (log.off > 5).sum(), len(log.off)) == (75, 93, 197)
    odometry = nls.initialize(log.graph, log.start, "odometry")[0]
    assert log.error(odometry).rmse == pytest.approx(11.2, abs=0.1)
