"""Loops of a floor that is flown there and back, by a vehicle that hardly knows its heading."""

from __future__ import annotations

from functools import cache
from importlib import import_module

import numpy as np
import pytest

import sim
from factors import XYH, Diagonal
from models.algebra import Index
from nls import FactorGraph, Values, kinds
from nls.filters.association import pair_precision_recall
from nls.sonar.contacts import tracks as of
from nls.sonar.contacts.alignment import Alignment
from nls.sonar.contacts.loops import closed
from nls.sonar.contacts.places import Pings
from sim.mission import Mission

x, l = kinds("x", "l")
HEADING = 0.02  # rad, sigma of a step


@cache
def drifted() -> tuple[Mission, Pings, FactorGraph, Values, Index]:
    """Four legs, odometry with a poor heading, and tracks that are right in every stretch."""
    mission = sim.hauv_floor(np.random.default_rng(3), legs=4, per_leg=20)
    odometry, *others = mission.graph.factors[:4]
    assert isinstance(odometry, XYH)
    error = HEADING * np.random.default_rng(0).normal(size=len(odometry))
    z = odometry.z + error[:, None] * [0, 0, 1]
    graph = FactorGraph([XYH(*odometry.keys, z, Diagonal([0.01, 0.01, HEADING])), *others])
    values = graph.optimize(Values.of([mission.start.stack("x")])).values
    pings = Pings.of(mission.contacts, values, l, mission.sonar.aperture)
    stretch = pings.ping * 4 // len(pings.poses)
    tracks = of.renamed(mission.contacts.keys[1].numbers * 4 + stretch)
    return mission, pings, graph, values, tracks


def ate(mission: Mission, values: Values) -> float:
    """Error of the poses, m."""
    return mission.ate(mission.truth.replaced({"x": values[x]}))


def test_loops_bring_the_poses_back_and_join_the_tracks(monkeypatch: pytest.MonkeyPatch) -> None:
    mission, pings, graph, values, tracks = drifted()
    monkeypatch.setattr(import_module("nls.sonar.contacts.loops"), "PINGS", -(-len(pings.poses) // 4))
    joined, poses = closed(pings, graph, values, tracks, 3, 0.999)
    assert ate(mission, values) > 0.25  # landmarks are half a meter apart
    assert ate(mission, poses) < 0.6 * ate(mission, values)
    true = mission.contacts.keys[1].numbers
    score = pair_precision_recall(joined, true)
    assert score.precision > 0.99
    assert score.recall > 2 * pair_precision_recall(tracks, true).recall


def test_without_landmarks_the_poses_stay() -> None:
    mission, pings, graph, values, tracks = drifted()
    alone = np.arange(len(tracks))  # no landmark has three sightings
    joined, poses = closed(pings, graph, values, alone, 3, 0.999)
    np.testing.assert_array_equal(joined, alone)
    assert ate(mission, poses) == ate(mission, values)


def test_a_loop_that_nothing_holds_together_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    mission, pings, graph, values, tracks = drifted()
    loops, k = import_module("nls.sonar.contacts.loops"), np.arange(20)
    wrong = Alignment(np.array([2.0, 0, 0, 0, 0, 0]), 1e4 * np.eye(6), 40, 0, k, k[::-1], np.zeros(20))
    monkeypatch.setattr(loops, "PINGS", -(-len(pings.poses) // 4))
    answers = iter([wrong])
    monkeypatch.setattr(loops, "aligned", lambda *_: next(answers, None))
    said: list[str] = []
    monkeypatch.setattr(loops, "announce", said.append)
    joined, poses = closed(pings, graph, values, tracks, 3, 0.999)
    assert [line.split()[0] for line in said] == ["1", "0"]
    np.testing.assert_array_equal(joined, tracks)
    assert ate(mission, poses) < 2 * ate(mission, values)
