"""The evidence about wrong closures: what is planted, what is counted, and what tells a failed trial."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from json import dumps
from pathlib import Path
from time import process_time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import nls
import sim
from factors import Between, Diagonal
from models import SE2
from nls import FactorGraph
from nls.robust.closures import chained
from nls.robust.consistency import neighbors


def busy(until: float) -> None:
    """Use up processor time."""
    while process_time() < until:
        pass


@pytest.fixture
def evidence(script: Callable[[str], Any]) -> Any:
    return script("robust")


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


@pytest.mark.parametrize("size", [1, 5])
def test_planted_closures(planting: Any, ring: Any, size: int) -> None:
    """As many as the share says, all wrong, of the weights of right ones; those of one group agree, others do not."""
    wrong = planting.spoiled(ring, 0.4, size, np.random.default_rng(1))
    i, j = (keys.numbers for keys in wrong.keys)
    assert len(wrong) == 40  # 40 of 100
    assert (np.abs(i - j) >= 10).all()
    assert (wrong.chi2(ring.best) > 100).all()
    np.testing.assert_allclose(wrong.bind(SE2, SE2).W, [[1 / 0.06, 1 / 0.06, 50]])
    _, links, odometry = chained(FactorGraph([ring.edges, wrong]), ring.best)
    near = neighbors(links[~odometry], links[odometry], ring.best.stack("x").X)
    support, cluster = near.support[60:], near.cluster[60:]
    if size == 1:
        assert np.median(support) == 0
    else:
        assert np.mean(support >= size - 2) > 0.9
        assert (cluster.reshape(-1, size) == cluster[::size, None]).mean() > 0.9
    again = planting.spoiled(ring, 0.4, size, np.random.default_rng(1))
    np.testing.assert_array_equal(again.z, wrong.z)


def test_a_trial(trials: Any, planting: Any, ring: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """`nls.gnc` solves the ring, least squares does not; trials come back from their file as they were."""
    monkeypatch.setitem(planting.SETS, "ring", "ring.g2o")
    task = trials.Task("ring", 5, 0.4, 0)
    found = trials.tried(tmp_path, task)
    plain = trials.tried(tmp_path, replace(task, method="plain"))
    assert found.fine
    assert found.recall == 1
    assert not plain.fine
    assert plain.off > 0.05
    assert np.isnan(plain.strain)
    path = tmp_path / "trials"
    path.write_text("".join(dumps(asdict(each)) + "\n" for each in (found, plain)))
    assert repr(trials.kept_in(path)) == repr([found, plain])
    assert trials.kept_in(tmp_path / "none") == []
    assert repr(trials.run(tmp_path, [task], path, 1, 0.0)) == repr([found])  # nothing begins after 0 minutes


def test_what_is_counted(
    trials: Any, planting: Any, ring: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """By hand: 6 of 60 right closures rejected, and 30 of 40 wrong ones."""
    weights = [np.ones(299), np.zeros(40)]
    weights[0][np.flatnonzero(ring.loops)[:6]] = 0
    weights[1][:10] = 1
    result = SimpleNamespace(values=ring.best, chi2_final=50.0, dof=100)
    found = SimpleNamespace(result=result, weights=weights, doubted=100, strain=1.5)
    monkeypatch.setitem(planting.SETS, "ring", "ring.g2o")
    monkeypatch.setattr(nls, "gnc", lambda *_: found)
    trial = trials.tried(tmp_path, trials.Task("ring", 5, 0.4, 0))
    assert (trial.recall, trial.kept, trial.strain, trial.noise) == (0.75, 0.9, 1.5, 0.5)
    assert (trial.precision, trial.rejected) == (30 / 36, 0.36)


def test_patience(trials: Any) -> None:
    """What takes too long is ended, and what follows is not."""
    began = process_time()
    with pytest.raises(trials.GivenUpError), trials.patience(0.05):
        busy(began + 5)
    assert process_time() - began < 2
    with trials.patience(0.5):
        pass
    assert sum(k for k in range(10**5)) == 10**5 * (10**5 - 1) // 2


def test_what_is_tried(trials: Any) -> None:
    """Every task once, the whole first seed before the second."""
    wanted = trials.tasks(3)
    assert len(wanted) == len(set(wanted)) == 30 * 3 + 12 * 3 + 30 * 3
    assert {task.seed for task in wanted[: 30 + 12 + 90]} == {0}


def test_telling_failed_from_good(evidence: Any, trials: Any) -> None:
    """By hand: of 2 failed and 4 good ones the failed one is the larger in 7.5 of 8 pairs."""
    failed, good = np.array([3.0, 5.0]), np.array([1.0, 2.0, 2.5, 3.0])
    assert evidence.area(failed, good) == pytest.approx(7.5 / 8)
    assert evidence.best_threshold(failed, good) == pytest.approx(2.75)  # both failed ones and one good one above it
    made = [
        trials.Trial(trials.Task("intel", 1, 0.5, k), off, 1.0, 0.9, 0.99, strain, 0.5, 0.2, 2.0)
        for k, (off, strain) in enumerate(
            [(0.2, 3.0), (0.3, 5.0), (0.001, 1.0), (0.002, 2.0), (0.003, 2.5), (0.004, 3.0)]
        )
    ]
    (row,) = [line for line in evidence.telling(made) if "strain" in line]
    assert row == "| `strain` | 0.94 | 2.75 | 2 of 2 | 1 of 4 | 0.94 |"
    assert evidence.telling(made[2:]) == ["Of all 4 trials 0 failed: nothing to tell apart."]
    *_, line = evidence.ours(made, [trials.Task("intel", 1, 0.5, 0)])
    assert line == "| intel | single | 50 | 4 of 6 | 0.35 | 30 | 100.0 | 90.0 | 99.0 | 2.75 | 5.00 | 2.0 |"


def test_real_closures(data: Path, script: Callable[[str], Any]) -> None:
    """Bovisa04: of 197 closures 75 are within 2 m of GPS and 93 off by more than 5; odometry is off by 11 m."""
    log = script("robust_real").bovisa(data / "robust-real")
    assert ((log.off < 2).sum(), (log.off > 5).sum(), len(log.off)) == (75, 93, 197)
    odometry = nls.initialize(log.graph, log.start, "odometry")[0]
    assert log.error(odometry).rmse == pytest.approx(11.2, abs=0.1)
