"""Near pairs: all true ones where the poses are known, and none of the same ping."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from factors import Isotropic, Prior
from models.algebra import Array, Index
from nls import FactorGraph, Values, kinds
from nls.covariance import Marginals
from nls.missions.contacts.estimate import Estimate
from nls.missions.contacts.pairs import MOST, near_landmarks, near_pings, near_sightings
from nls.missions.contacts.places import Pings
from tests.nls.missions.contacts.scenes import (
    GATE,
    Scene,
    covariances_of_poses,
    estimate_of,
    floor,
    in_plane,
    poor_ranges,
    sighting_distances,
    true_pairs,
)

l = kinds("l")[0]
Near = Callable[[Pings, Estimate, Array, Index, float], tuple[Index, Index]]
SCENES = {"floor": floor, "in_plane": in_plane, "poor_ranges": poor_ranges}


def nearest(near: Near, pings: Pings, estimate: Estimate, which: Index, gate: float) -> tuple[Index, Index]:
    """What is near by the covariances of this estimate."""
    return near(pings, estimate, covariances_of_poses(pings, estimate), which, gate)


def among(pairs: tuple[Index, Index], others: tuple[Index, Index]) -> list[bool]:
    """Whether each pair is among others."""
    known = set(zip(*(array.tolist() for array in others), strict=True))
    return [pair in known for pair in zip(*(array.tolist() for array in pairs), strict=True)]


@pytest.mark.parametrize("name", SCENES)
def test_sightings_of_following_pings(name: str) -> None:
    scene = SCENES[name]()
    pings, lags = scene.pings, 2
    c, d, motions = near_pings(pings, scene.graph, scene.values, lags, GATE)
    i, j = (pings.poses[pings.ping[of]] for of in (c, d))
    exact = Marginals(scene.graph, scene.values, pairs=[(i, j)]).relative(i, j)
    np.testing.assert_allclose(motions.Sigma[motions.which], exact, rtol=1e-9, atol=1e-15)
    lag = pings.ping[d] - pings.ping[c]
    assert (lag.min(), lag.max()) == (1, lags)
    assert len(set(zip(c.tolist(), d.tolist(), strict=True))) == len(c)
    every = true_pairs(scene)
    follow = pings.ping[every[1]] - pings.ping[every[0]] <= lags
    assert np.mean(among((every[0][follow], every[1][follow]), (c, d))) > 0.99
    assert len(c) < 0.5 * len(pings) * (lags * len(pings) / len(pings.poses))  # not simply all


def test_one_ping_has_none_after_it() -> None:
    scene = floor()
    one = Scene(scene.graph, scene.values, scene.sightings[[0, 1]], scene.aperture, scene.true[:2], scene.truth)
    c, d, motions = near_pings(one.pings, one.graph, one.values, 3, GATE)
    assert [len(array) for array in (c, d, *motions)] == [0, 0, 0, 0]


@pytest.mark.parametrize("name", ["in_plane", "poor_ranges"])
def test_sightings_from_anywhere(name: str) -> None:
    """Few enough that the nearest `MOST` are no limit: those far apart in time, whose later pose is known less."""
    scene = SCENES[name]()
    pings = scene.pings
    which = np.sort(np.random.default_rng(0).choice(len(pings), MOST, replace=False))
    c, d = nearest(near_sightings, pings, estimate_of(scene.true, scene.graph, scene.values), which, GATE)
    assert (pings.ping[c] < pings.ping[d]).all()
    assert np.isin([c, d], which).all()
    assert len(set(zip(c.tolist(), d.tolist(), strict=True))) == len(c)
    e, f = true_pairs(scene)
    chosen = np.isin(e, which) & np.isin(f, which)
    d2, _ = sighting_distances(scene, e[chosen], f[chosen])
    inside = d2 < GATE
    assert inside.sum() > 20
    assert all(among((e[chosen][inside], f[chosen][inside]), (c, d)))


def with_landmarks(scene: Scene, values: Values) -> FactorGraph:
    """The graph of a scene with its landmarks known to 0.1 m."""
    numbers = values.stack("l").numbers
    return FactorGraph([*scene.graph.factors, Prior(l[numbers], values[l], Isotropic(0.1))])


@pytest.mark.parametrize("name", ["floor", "in_plane"])
def test_landmarks_near_a_sighting(name: str) -> None:
    """Every sighting, each a track of its own, is near its landmark; a sighting of that landmark's track is not."""
    scene = SCENES[name]()
    pings, which = scene.pings, np.arange(0, len(scene.true), 3)
    values, nothing = scene.truth_of(scene.true), np.full(len(scene.true), -7)
    graph = with_landmarks(scene, values)
    d, landmarks = nearest(near_landmarks, pings, estimate_of(nothing, graph, values), which, GATE)
    assert all(among((which, scene.true[which]), (d, landmarks)))
    assert set(d.tolist()) <= set(which.tolist())
    assert len(d) < 0.7 * len(which) * len(np.unique(scene.true))
    d, landmarks = nearest(near_landmarks, pings, estimate_of(scene.true, graph, values), which, GATE)
    assert len(d) or name == "in_plane"  # where they are too far apart
    assert (scene.true[d] != landmarks).all()


def test_a_landmark_far_above_the_aperture_was_not_seen() -> None:
    """Half the aperture is 7 deg. On the arc, prolonged: at 6 deg it may have been seen, at 15 deg not."""
    scene = floor()
    pings, which = scene.pings, np.array([5])
    far = float(np.linalg.norm(pings.middle[5]))
    for degrees, count in ((6.0, 1), (15.0, 0)):
        local = pings.middle[5] * np.cos(np.radians(degrees)) + [0, 0, far * np.sin(np.radians(degrees))]
        point = pings.group.act(pings.sensors(scene.values)[5:6], local[None])
        values = Values.of([*scene.values.stacks.values()])
        values.add(l, scene.truth.stack("l").manifold, point, [900])
        graph = with_landmarks(scene, values)
        d, landmarks = nearest(near_landmarks, pings, estimate_of(np.arange(len(pings)), graph, values), which, 1e3)
        assert (d.tolist(), landmarks.tolist()) == ([5] * count, [900] * count)


def test_without_landmarks_none_is_near() -> None:
    scene = in_plane()
    every = np.arange(len(scene.true))
    estimate = estimate_of(every, scene.graph, scene.values)
    assert [len(array) for array in nearest(near_landmarks, scene.pings, estimate, every, GATE)] == [0, 0]
    assert [len(array) for array in nearest(near_sightings, scene.pings, estimate, every[:0], GATE)] == [0, 0]
