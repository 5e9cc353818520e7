"""Stretches of a mission: all sightings once, and only measurements between the poses of each."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest

from factors import Between, Isotropic, Prior
from models import R
from nls import FactorGraph, Values, kinds
from nls.filters.association import pair_precision_recall
from nls.missions.contacts import associate
from nls.missions.contacts.stretches import stretches
from tests.nls.missions.contacts.scenes import floor, in_plane

x, l, m = kinds("x", "l", "m")


def test_every_sighting_and_its_ping_is_in_one_stretch() -> None:
    scene = floor()
    pings = scene.pings
    parts = list(stretches(pings, scene.graph, scene.values, -(-len(pings.poses) // 3)))
    rows = [rows for rows, *_ in parts]
    np.testing.assert_array_equal(np.sort(np.concatenate(rows)), np.arange(len(pings)))
    assert len(parts) == 3
    assert pings.ping[rows[0]].max() + 1 == pings.ping[rows[1]].min() == len(pings.poses) // 3
    for of_stretch, part, _, values in parts:
        np.testing.assert_array_equal(part.sightings.keys[0].numbers, scene.sightings.keys[0].numbers[of_stretch])
        np.testing.assert_array_equal(part.points, pings.points[of_stretch])
        assert part.limit == pings.limit
        np.testing.assert_array_equal(values[x], scene.values[x[values.stack("x").numbers]])


def test_measurements_between_stretches_are_in_none() -> None:
    scene = floor()
    pings = scene.pings
    (*_, first, early), (*_, second, late) = stretches(pings, scene.graph, scene.values, -(-len(pings.poses) // 2))
    assert len(scene.graph) - len(first) - len(second) == 1  # the odometry from the one to the other
    assert len(early.stack("x")) + len(late.stack("x")) == len(scene.values.stack("x"))
    for graph, values in ((first, early), (second, late)):
        assert [keys.numbers.tolist() for keys in graph.fixed] == [[values.stack("x").numbers.min()]]
        graph.optimize(values)  # nothing is free


def test_the_first_pose_of_every_component_is_held_and_all_other_unknowns() -> None:
    """Odometry is missing after the first pose of the second stretch; a scale is shared by both."""
    scene = in_plane()
    pings = scene.pings
    gap = int(pings.poses.numbers[len(pings.poses) // 2])
    odometry = next(factor for factor in scene.graph.factors if isinstance(factor, Between))
    rest = [factor for factor in scene.graph.factors if factor is not odometry]
    graph = FactorGraph([*rest, odometry[odometry.keys[0].numbers != gap], Prior(m[0], [0.5], Isotropic(0.1))])
    values = Values.of([*scene.values.stacks.values(), Values({m: (R(1), [0.0])}).stack("m")])
    *_, (_, _, part, late) = stretches(pings, graph, values, -(-len(pings.poses) // 2))
    held = {
        keys.kind: sorted(np.concatenate([k.numbers for k in part.fixed if k.kind == keys.kind])) for keys in part.fixed
    }
    assert held == {"x": [gap, gap + 1]}
    assert "m" not in late.stacks


@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_stretches_lead_to_the_same_pairs(monkeypatch: pytest.MonkeyPatch, outliers: float) -> None:
    scene = floor(1, outliers)
    whole = associate(scene.graph, scene.values, scene.sightings, scene.aperture)
    monkeypatch.setattr(import_module("nls.missions.contacts.associate"), "PINGS", len(scene.values) // 4)
    parts = associate(scene.graph, scene.values, scene.sightings, scene.aperture)
    for answer in (whole, parts):
        score = pair_precision_recall(answer.numbers, scene.true)
        assert score.precision > 0.9
        assert score.recall > 0.9
        assert answer.settled
    assert abs(parts.cost - whole.cost) < 0.05 * whole.cost
