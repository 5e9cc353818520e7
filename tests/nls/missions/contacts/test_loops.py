"""Loops of a floor that is flown there and back, by a vehicle that hardly knows its heading."""

from __future__ import annotations

from functools import cache
from importlib import import_module

import numpy as np
import pytest

import sim
from factors import XYH, Between, Diagonal, Isotropic, Prior
from models import SE2, SE3
from models.algebra import Index
from nls import FactorGraph, Values, kinds
from nls.filters.association import pair_precision_recall
from nls.missions.contacts import tracks as of
from nls.missions.contacts.estimate import estimated
from nls.missions.contacts.loops import Loop, _held, _Placed, closed
from nls.missions.contacts.maps import LocalMap, local_maps
from nls.missions.contacts.places import Pings
from nls.missions.contacts.stretches import stretches
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


def maps_of(pings: Pings, graph: FactorGraph, values: Values, tracks: Index) -> list[list[LocalMap]]:
    """The maps of four stretches."""
    maps = []
    for rows, part, between, start in stretches(pings, graph, values, -(-len(pings.poses) // 4)):
        estimate = estimated(part, between, start, of.renamed(tracks[rows]))
        maps.append([local.renumbered(rows) for local in local_maps(part, estimate, 3)])
    return maps


def test_loops_bring_the_poses_back_and_join_the_tracks() -> None:
    mission, pings, graph, values, tracks = drifted()
    joined, poses = closed(pings, graph, values, tracks, maps_of(pings, graph, values, tracks), 0.999)
    assert ate(mission, values) > 0.25  # landmarks are half a meter apart
    assert ate(mission, poses) < 0.6 * ate(mission, values)
    true = mission.contacts.keys[1].numbers
    score = pair_precision_recall(joined, true)
    assert score.precision > 0.99
    assert score.recall > 1.5 * pair_precision_recall(tracks, true).recall


def test_without_landmarks_the_poses_stay() -> None:
    mission, pings, graph, values, tracks = drifted()
    joined, poses = closed(pings, graph, values, tracks, [[], []], 0.999)
    np.testing.assert_array_equal(joined, tracks)
    assert ate(mission, poses) == ate(mission, values)


def test_a_loop_that_does_not_fit_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    mission, pings, graph, values, tracks = drifted()
    maps, loops = maps_of(pings, graph, values, tracks), import_module("nls.missions.contacts.loops")
    wrong, said, tried = SE3.exp(np.array([[2.0, 0, 0, 0, 0, 0]]))[0], [], []

    def never(_: object, a: int, b: int, *__: object) -> Loop | None:
        tried.append((a, b))
        k = np.arange(20)
        return Loop(wrong, 1e4 * np.eye(6), k, k[::-1], np.zeros(20)) if len(tried) == 1 else None

    monkeypatch.setattr(loops._Placed, "loop", never)
    monkeypatch.setattr(loops, "announce", said.append)
    joined, poses = closed(pings, graph, values, tracks, maps, 0.999)
    assert [line.split()[0] for line in said] == ["0"]
    assert tried.count(tried[0]) == 1
    assert not any(a // 2 == b // 2 for a, b in tried)  # two maps of one stretch
    np.testing.assert_array_equal(joined, tracks)
    assert ate(mission, poses) < 1.01 * ate(mission, values)


def test_held_poses_have_no_loop_to_find() -> None:
    mission, pings, graph, values, tracks = drifted()
    maps = maps_of(pings, graph, values, tracks)
    held = FactorGraph(graph.factors, [pings.poses])
    _, poses = closed(pings, held, values, tracks, maps, 0.999)
    assert ate(mission, poses) == ate(mission, values)


def test_a_wrong_loop_is_taken_back_and_right_ones_stay() -> None:
    """It draws the poses after it, so that its own residual is small and those of others are not."""
    n = 12
    truth = np.column_stack([[*range(6), *range(5, -1, -1)], [0.0] * 6 + [0.5] * 6, np.zeros(n)])
    i, sigmas = np.arange(n - 1), np.array([0.1, 0.1, 0.01])
    steps = Between(x[i], x[i + 1], SE2.between(truth[:-1], truth[1:]), Diagonal(sigmas))
    graph, values = FactorGraph([Prior(x[0], truth[0], Isotropic(1e-3)), steps]), Values({x: (SE2, truth)})
    loops = {}
    for a in range(6):
        motion = SE2.between(truth[[a]], truth[[n - 1 - a]])[0]
        none = np.zeros(0, dtype=np.intp)
        loops[a, n - 1 - a] = Loop(
            motion + np.array([1.0, 0, 0]) * (a == 2), np.eye(3) / 0.02**2, none, none, np.zeros(0)
        )
    held, marginals = _held(graph, values, x[np.arange(n)], loops, 0.995)
    assert [*held] == [pair for pair in loops if pair[0] != 2]
    np.testing.assert_allclose(marginals.values[x], truth, atol=1e-6)


def test_loops_of_one_map_share_its_errors() -> None:
    """Three of them: the motion is known a third as well as each one says."""
    truth, k = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0]]), np.arange(3)
    steps = Between(x[k], x[k + 1], SE2.between(truth[:-1], truth[1:]), Isotropic(10.0))
    graph, values = FactorGraph([Prior(x[0], truth[0], Isotropic(1e-3)), steps]), Values({x: (SE2, truth)})
    none = np.zeros(0, dtype=np.intp)
    loops = {
        (0, b): Loop(SE2.between(truth[[0]], truth[[b]])[0], np.eye(3) / 0.02**2, none, none, np.zeros(0))
        for b in (1, 2, 3)
    }
    held, marginals = _held(graph, values, x[np.arange(4)], loops, 0.995)
    assert [*held] == [*loops]
    C = marginals.relative(x[[0, 0, 0]], x[[1, 2, 3]])
    np.testing.assert_allclose(C, np.broadcast_to(3 * 0.02**2 * np.eye(3), C.shape), rtol=1e-3, atol=1e-6)


def test_maps_are_aligned_in_the_frame_of_the_second(monkeypatch: pytest.MonkeyPatch) -> None:
    C = np.diag([0.01, 0.04]) * np.eye(3)[:, :, None, None]
    p = np.array([[1.0, 2], [3, 4], [5, 6]])
    first, second = (LocalMap(x[[k]], np.arange(3), p, C) for k in range(2))
    X, seen = np.array([[0.0, 0, 0], [1, 2, np.pi / 2]]), []
    monkeypatch.setattr(import_module("nls.missions.contacts.loops"), "aligned", lambda *args: seen.append(args))
    assert _Placed(SE2, [first, second], X, np.zeros((2, 2, 3, 3)), 9.0).loop(0, 1, np.eye(3)) is None
    _, a, b, *_ = seen[0]
    np.testing.assert_allclose(a.p, [[0, 0], [2, -2], [4, -4]], atol=1e-12)
    np.testing.assert_allclose(a.C, np.broadcast_to(np.diag([0.04, 0.01]), (3, 2, 2)), atol=1e-12)
    np.testing.assert_array_equal(b.C, np.broadcast_to(np.diag([0.01, 0.04]), (3, 2, 2)))
