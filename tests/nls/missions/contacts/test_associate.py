"""Sightings without names: their pairs are found again, whatever their order; what is false stays out."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest

import sim
from factors import XYH, Bearing, BearingRange, Between, Diagonal, Isotropic, Prior
from factors.sighting import Sighting
from models import SE2, R
from models.algebra import Array, Index
from models.errors import GraphError, OptionError, UnderconstrainedError
from nls import FactorGraph, Marginals, Values, kinds
from nls.filters.association import pair_precision_recall
from nls.metrics import ate
from nls.missions.contacts import Associated, associate
from nls.missions.contacts.loops import Loop, Loops, _held
from sim.mission import Mission


@dataclass(frozen=True)
class Scene:
    """Measurements without contacts, poses by them, contacts without names, and the answer.

    Attributes
    ----------
    graph, values : what is known without the contacts.
    sightings : all of landmark 0.
    aperture : of the sonar, rad; None where a sighting locates its target.
    true : (n,) landmark of each sighting, -1 of a false one.
    truth : poses and landmarks.
    """

    graph: FactorGraph
    values: Values
    sightings: Sighting
    aperture: float | None
    true: Index
    truth: Values


def poses_of(values: Values) -> Values:
    """The poses without the landmarks."""
    return Values.of([values.stack("x")])


def unnamed(sightings: Sighting) -> Sighting:
    """The sightings, all of landmark 0."""
    pose, nothing = sightings.keys[0], np.zeros(len(sightings), dtype=int)
    return type(sightings)(pose, l[nothing], sightings.z, sightings.noise, sightings.offset)


def scene_of(mission: Mission, graph: FactorGraph) -> Scene:
    true = np.where(mission.wrong, -1, mission.contacts.keys[1].numbers)
    start, seen = poses_of(mission.start), unnamed(mission.contacts)
    return Scene(graph, start, seen, mission.sonar.aperture, true, mission.truth)


@cache
def floor(seed: int = 1, outliers: float = 0.0, noise_scale: float = 1.0) -> Scene:
    """One leg over the sea floor, there and back."""
    rng = np.random.default_rng(seed)
    mission = sim.hauv_floor(rng, legs=1, per_leg=12, outliers=outliers, noise_scale=noise_scale)
    return scene_of(mission, FactorGraph(mission.graph.factors[:4]))


@cache
def drifted() -> Scene:
    """Two legs there and back, by a vehicle that hardly knows its heading."""
    mission = sim.hauv_floor(np.random.default_rng(3), legs=2, per_leg=16)
    odometry, *others = mission.graph.factors[:4]
    assert isinstance(odometry, XYH)
    z = odometry.z + 0.02 * np.random.default_rng(0).normal(size=len(odometry))[:, None] * [0, 0, 1]
    return scene_of(mission, FactorGraph([XYH(*odometry.keys, z, Diagonal([0.01, 0.01, 0.02])), *others]))


@cache
def in_plane() -> Scene:
    """A lap of an underwater vehicle in the plane: bearings and ranges of six landmarks."""
    world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    sightings = world.graph.factors[2]
    assert isinstance(sightings, BearingRange)
    known, start = FactorGraph(world.graph.factors[:2]), poses_of(world.start)
    return Scene(known, start, unnamed(sightings), None, sightings.keys[1].numbers, world.truth)


@cache
def poor_ranges() -> Scene:
    """A straight way by good odometry, past targets whose range is measured to 0.3 m."""
    rng, n = np.random.default_rng(0), 20
    X = np.column_stack([np.arange(n), np.zeros((n, 2))])
    sigmas = np.array([1e-3, 1e-3, 1e-4])
    step = SE2.between(X[:-1], X[1:]) + rng.normal(size=(n - 1, 3)) * sigmas
    steps = Between(x[np.arange(n - 1)], x[np.arange(1, n)], step, Diagonal(sigmas))
    points = rng.uniform([-5, -15], [25, 15], (12, 2))
    i, k = np.nonzero(np.linalg.norm(X[:, None, :2] - points, axis=2) < 12)
    d = points[k] - X[i, :2]
    z = np.column_stack([np.arctan2(d[:, 1], d[:, 0]), np.hypot(*d.T)]) + rng.normal(size=(len(i), 2)) * [0.003, 0.3]
    sightings = BearingRange(x[i], l[np.zeros(len(i), dtype=int)], z, Diagonal(bearing=0.003, range=0.3))
    values = Values({x: (SE2, X)})
    return Scene(FactorGraph([Prior(x[0], X[0], Isotropic(1e-3)), steps]), values, sightings, None, k, values)


x, l, m = kinds("x", "l", "m")


@cache
def answer(
    make: Callable[..., Scene], seed: int = 1, outliers: float = 0.0, pings: int = 150, noise_scale: float = 1.0
) -> Associated:
    """The association of a scene, with so many pings in a stretch."""
    scene = made(make, seed, outliers, pings, noise_scale)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys.modules["nls.missions.contacts.associate"], "STRETCH_PINGS", pings)
        return associate(scene.graph, scene.values, scene.sightings, scene.aperture)


def made(make: Callable[..., Scene], seed: int = 1, outliers: float = 0.0, pings: int = 0, noise: float = 1.0) -> Scene:
    return make(seed, outliers, noise) if make is floor else make()


def error(scene: Scene, values: Values) -> float:
    """ATE, m; nothing is aligned."""
    return float(ate(values[x], scene.truth[x]).rmse)


def partition(numbers: Index) -> set[frozenset[int]]:
    return {frozenset(np.flatnonzero(numbers == number).tolist()) for number in set(numbers[numbers >= 0].tolist())}


# scene, seed, false contacts, pings of a stretch, noise in stated sigmas; decided after each round, landmarks, cost
ANSWERS = [
    ((floor, 1), [384, 384, 385, 385, 390, 390], 34, 1241.7016865017736),
    ((floor, 1, 0.2, 150, 0.7), [299, 300, 306, 305, 308, 314, 314], 33, 1375.6092920432054),
    ((floor, 3, 0.1, 150, 2.0), [204, 209, 224, 218, 217, 217, 218], 33, 1570.5794108704881),
    ((floor, 4, 0.1), [312, 317, 321, 322], 37, 1359.630270051628),
    ((floor, 1, 0.0, 5), [377, 378, 380, 384, 384, 391, 391], 34, 1242.9376811056113),
    ((in_plane,), [176] * 6, 6, 349.81794254992474),
    ((poor_ranges,), [120, 120], 10, 282.74375310014807),
    ((drifted, 1, 0.0, 17), [953, 1065, 1126, 1143, 1143, 1171, 1171], 129, 4904.51112616657),
]


@pytest.mark.parametrize(("scene", "rounds", "landmarks", "cost"), ANSWERS)
def test_any_step_that_changes_shows_in_rounds_and_cost(
    scene: tuple[Any, ...], rounds: list[int], landmarks: int, cost: float
) -> None:
    result = answer(*scene)
    assert (list(result.rounds), result.landmarks) == (rounds, landmarks)
    assert result.cost == pytest.approx(cost, rel=1e-6)


@pytest.mark.parametrize(
    ("scene", "precision", "recall", "gain"),
    [
        ((floor, 1), 0.97, 0.9, 1),
        ((floor, 2), 0.97, 0.9, 1),
        ((floor, 2, 0.1), 0.9, 0.9, 0),
        ((floor, 4, 0.1), 0.9, 0.9, 0),
        ((in_plane,), 1.0, 0.98, 3),
        ((poor_ranges,), 1.0, 0.98, 0),
        ((drifted, 1, 0.0, 17), 0.95, 0.9, 2),
    ],
)
def test_pairs_are_found_again(scene: tuple[Any, ...], precision: float, recall: float, gain: float) -> None:
    """Where odometry drifts and where it is better than the sensor; what is false stays out, and loops join tracks."""
    known, result = made(*scene), answer(*scene)
    score = pair_precision_recall(result.numbers, known.true)
    assert score.precision >= precision
    assert score.recall >= recall
    assert result.settled
    assert gain * error(known, result.values) <= error(known, known.values)
    false, true = known.true < 0, len(np.unique(known.true))
    if false.any():
        assert np.mean(result.numbers[false] < 0) > 0.7
    else:
        assert abs(result.landmarks - true) <= 0.06 * true


def test_what_is_returned_fits_together() -> None:
    scene, result = floor(), answer(floor)
    decided = np.flatnonzero(result.numbers >= 0)
    counts = np.bincount(result.numbers[decided])
    assert counts.min() >= 3
    assert len(counts) == result.landmarks == len(result.values.stack("l"))
    first = [int(np.argmax(result.numbers == k)) for k in range(result.landmarks)]
    assert first == sorted(first)
    pose, target = result.sightings.keys[:2]
    assert np.array_equal(target.numbers, result.numbers[decided])
    assert np.array_equal(pose.numbers, scene.sightings.keys[0].numbers[decided])
    assert np.array_equal(result.sightings.z, scene.sightings.z[decided])
    assert np.array_equal(np.isnan(result.d2), result.numbers < 0)
    np.testing.assert_allclose(result.d2[decided], result.sightings.chi2(result.values))
    poses, nis = result.nis
    for k in (0, len(poses) // 2):
        assert nis[k] == pytest.approx(result.d2[decided][pose.numbers == poses.numbers[k]].mean())
    assert result.rounds[-1] == len(decided)
    distance = np.linalg.norm(result.values[l] - scene.truth[l[scene.true[first]]], axis=1)
    assert np.median(distance) < 0.3


def test_the_order_of_the_sightings_does_not_matter() -> None:
    scene, result = floor(), answer(floor)
    order = np.random.default_rng(3).permutation(len(scene.true))
    other = associate(scene.graph, scene.values, scene.sightings[order], scene.aperture)
    numbers = np.empty_like(other.numbers)
    numbers[order] = other.numbers
    assert partition(numbers) == partition(result.numbers)


def test_names_have_no_influence_nothing_is_changed_and_it_comes_out_the_same_again() -> None:
    scene, result = in_plane(), answer(in_plane)
    pose, noise = scene.sightings.keys[0], scene.sightings.noise
    named = type(scene.sightings)(pose, l[scene.true], scene.sightings.z, noise)
    factors, poses = list(scene.graph.factors), scene.values[x].copy()
    again = associate(scene.graph, scene.values, named)
    assert list(scene.graph.factors) == factors
    assert np.array_equal(scene.values[x], poses)
    assert list(scene.values.stacks) == ["x"]
    assert np.array_equal(again.numbers, result.numbers)
    assert np.array_equal(again.values[x], result.values[x])
    assert np.array_equal(again.values[l], result.values[l])
    assert again.rounds == result.rounds


def test_least_kind_rounds_and_history() -> None:
    """A landmark that is seen less often than `least` is none."""
    scene = in_plane()
    counts = np.bincount(scene.true)
    result = associate(scene.graph, scene.values, scene.sightings, kind=m, least=int(counts.min()) + 1)
    assert result.landmarks == np.count_nonzero(counts > counts.min())
    assert set(result.values.stacks) == {"x", "m"}
    for tracks, decided in zip(result.history, result.rounds, strict=True):
        size = np.bincount(tracks)[tracks]
        assert np.count_nonzero(size > counts.min()) == decided
    short = associate(scene.graph, scene.values, scene.sightings, rounds=1)
    assert (len(short.rounds), short.settled) == (1, False)


def test_other_unknowns_of_the_graph_have_no_influence() -> None:
    """Such as a scale error of the log, which a prior holds."""
    scene = in_plane()
    graph = FactorGraph([*scene.graph.factors, Prior(m[0], [0.5], Isotropic(0.1))])
    values = Values.of([*scene.values.stacks.values(), Values({m: (R(1), [0.0])}).stack("m")])
    result = associate(graph, values, scene.sightings)
    np.testing.assert_array_equal(result.numbers, answer(in_plane).numbers)
    np.testing.assert_allclose(result.values[m], [[0.5]])


def test_where_nothing_belongs_together_nothing_is_decided() -> None:
    """One ping, whose sightings are all different targets."""
    scene = floor()
    result = associate(scene.graph, scene.values, scene.sightings[[0, 1, 2]], scene.aperture)
    assert (result.numbers.tolist(), result.landmarks, result.share) == ([-1, -1, -1], 0, 0.0)
    assert len(result.sightings) == len(result.nis[0]) == 0
    assert result.settled
    assert list(result.values.stacks) == ["x"]


def test_refusals() -> None:
    scene = floor()
    graph, values, sightings = scene.graph, scene.values, scene.sightings
    wrong = {"least": [1], "rounds": [0], "probability": [1.0, 0.0], "aperture": [-1.0, None]}
    for name, value in ((name, value) for name, several in wrong.items() for value in several):  # type: ignore[attr-defined]
        with pytest.raises(OptionError, match=name):
            associate(graph, values, sightings, **{"aperture": 0.2, name: value})
    with pytest.raises(GraphError, match="kind 'x' has values already"):
        associate(graph, values, sightings, 0.2, kind=x)
    plane = in_plane()
    pose = plane.sightings.keys[0]
    with pytest.raises(GraphError, match="Bearing leaves more free"):
        associate(plane.graph, plane.values, Bearing(pose, l[plane.true], plane.sightings.z[:, :1], Isotropic(0.1)))
    with pytest.raises(UnderconstrainedError):
        associate(FactorGraph(graph.factors[1:2]), values, sightings, scene.aperture)


def held(truth: Array, sigmas: list[float], pairs: list[tuple[int, int]], wrong: int = -1) -> tuple[Loops, Marginals]:
    """Loops of some pairs among poses (n, 3) of a track, one of which is a meter wrong; what is held of them."""
    n, none = len(truth), np.zeros(0, dtype=np.intp)
    steps = Between(x[0 : n - 1], x[1:n], SE2.between(truth[:-1], truth[1:]), Diagonal(sigmas))
    graph, loops = FactorGraph([Prior(x[0], truth[0], Isotropic(1e-3)), steps]), {}
    for k, (a, b) in enumerate(pairs):
        motion = SE2.between(truth[[a]], truth[[b]])[0] + np.array([1.0, 0, 0]) * (k == wrong)
        loops[a, b] = Loop(motion, np.eye(3) / 0.02**2, none, none, np.zeros(0))
    return _held(graph, Values({x: (SE2, truth)}), x[0:n], loops, 0.995)


def test_a_wrong_loop_is_taken_back_and_right_ones_stay() -> None:
    """The wrong one draws the poses after it, so that its own residual is small and those of others are not."""
    truth = np.column_stack([[*range(6), *range(5, -1, -1)], [0.0] * 6 + [0.5] * 6, np.zeros(12)])
    pairs = [(a, 11 - a) for a in range(6)]
    loops, marginals = held(truth, [0.1, 0.1, 0.01], pairs, wrong=2)
    assert [*loops] == pairs[:2] + pairs[3:]
    np.testing.assert_allclose(marginals.values[x], truth, atol=1e-6)


def test_loops_of_one_map_share_its_errors() -> None:
    """Three of them: the motion is known a third as well as each one says."""
    truth = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0]])
    loops, marginals = held(truth, [10.0] * 3, [(0, 1), (0, 2), (0, 3)])
    assert len(loops) == 3
    C = marginals.relative(x[[0, 0, 0]], x[[1, 2, 3]])
    np.testing.assert_allclose(C, np.broadcast_to(3 * 0.02**2 * np.eye(3), C.shape), rtol=1e-3, atol=1e-6)
