"""Accepted groups that nothing verifies, in the result of `gnc`, in its report and in the record for programs."""

from __future__ import annotations

import numpy as np
import pytest

import nls
import sim
from factors import Between, Diagonal
from nls import FactorGraph, kinds
from nls.analysis import unverified_groups
from nls.cli.outliers import record
from nls.io.report import Source
from nls.robust import Robustified

(x,) = kinds("x")


@pytest.fixture(scope="module")
def carried() -> Robustified:
    """A choice that rejected two single closures and accepted ten wrong ones that agree."""
    world = sim.ring(np.random.default_rng(0), laps=2, per_lap=60)
    k = np.arange(10)
    alone = Between(x[[3]], x[[33]], np.zeros((1, 3)), Diagonal(x=0.05, y=0.05, yaw=0.01))
    mixed = Between(x[np.r_[7, k]], x[np.r_[90, k + 50]], np.zeros((11, 3)), Diagonal(x=0.05, y=0.05, yaw=0.01))
    masks = [np.zeros(1, dtype=bool), np.ones(119, dtype=bool), np.arange(11) > 0]
    graph = FactorGraph([alone, world.graph.factors[0], mixed]).only(masks)
    result = graph.optimize(world.start)
    return Robustified(result, graph, [mask.astype(float) for mask in masks], (), 12, 1.0, 0.99)


def test_the_choice_its_report_and_its_record_have_the_group(carried: Robustified) -> None:
    """Its closures are numbered as in the given graph, not as in the graph of the chosen."""
    (group,) = carried.unverified
    (same,) = unverified_groups(carried.graph, carried.result.values)
    assert same.closures == tuple((1, k) for k in range(10))
    assert group.closures == tuple((2, k) for k in range(1, 11))
    assert group.names == same.names
    assert carried.unverified is carried.unverified
    numbers = f"redundancy 0.00, the map moves {group.meters:.3g} m ({group.sigmas:.2g} sigmas) without it"
    assert f"accepted, not verified: Between(x0, x50) and 9 more: {numbers}" in carried.report()
    (entry,) = record(carried, [Source("a.g2o", np.zeros(len(w), np.intp)) for w in carried.weights])["unverified"]
    assert entry["factors"] == [f"Between(x{k}, x{k + 50})" for k in range(10)]
    assert [entry[name] for name in ("redundancy", "meters", "rms", "sigmas")] == [
        group.redundancy,
        group.meters,
        group.rms,
        group.sigmas,
    ]


def test_a_choice_of_right_closures_has_none() -> None:
    world = sim.ring(np.random.default_rng(0), laps=2, per_lap=60)
    choice = nls.gnc(world.graph, world.truth)
    assert choice.unverified == ()
    assert record(choice, ())["unverified"] == []
    assert not any("not verified" in line for line in choice.report())
