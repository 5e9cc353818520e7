"""Landmarks made of two: the fall of chi2 against a second solution, and right landmarks that stay whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from factors import Diagonal
from factors.base import Factor
from factors.sighting import Sighting
from models.algebra import Array, Index, Mask
from nls import FactorGraph, Marginals
from nls.analysis.chi_squared import chi2_gate
from nls.missions.contacts.estimate import Estimate, estimated
from nls.missions.contacts.splitting import Cuts
from nls.missions.contacts.tracks import renamed, several
from tests.nls.missions.contacts.scenes import Scene, floor, in_plane


def solved(scene: Scene, tracks: Index) -> Estimate:
    return estimated(scene.pings, scene.graph, scene.at_the_truth(), renamed(tracks))


def split(scene: Scene, estimate: Estimate, pieces: Index, gate: float) -> Mask:
    """The sightings that leave their landmarks."""
    cuts = Cuts(scene.pings, scene.graph, estimate, pieces)
    return cuts.leaving(Marginals(cuts.tied.graph, cuts.tied.values), gate)


def in_time(scene: Scene, parts: int) -> Index:
    """Pieces of the true landmarks: their sightings of every such part of the mission."""
    pings = scene.pings
    return renamed(scene.true * parts + pings.ping * parts // len(pings.poses))


def scaled(scene: Scene, times: float) -> Scene:
    """A scene in the plane with all lengths and their sigmas times a number."""

    def larger(factor: Factor, lengths: Array, W: Array) -> Factor:
        return type(factor)(*factor.keys, factor.z * lengths, Diagonal(lengths / W))

    of_pose, of_sighting = np.array([times, times, 1.0]), np.array([1.0, times])
    graph = FactorGraph([larger(f, of_pose, scene.values.gather(f)[0].W) for f in scene.graph.factors])
    sightings = larger(scene.sightings, of_sighting, scene.pings.model(np.arange(1)).W.reshape(-1))
    values, truth = (old.replaced({"x": old.stack("x").X * of_pose}) for old in (scene.values, scene.at_the_truth()))
    assert isinstance(sightings, Sighting)
    return replace(scene, graph=graph, values=values, sightings=sightings, truth=truth)


@pytest.mark.parametrize(("scene", "number"), [(floor(1), 0), (floor(2), 0), (in_plane(), 1)])
def test_the_fall_of_chi2_is_that_of_a_second_solution(scene: Scene, number: int) -> None:
    """Ranges of one landmark are longer on the way back: a gate below the fall parts it, a gate above keeps it."""
    late = in_time(scene, 2) != renamed(scene.true)
    sigma = 1 / scene.pings.model(np.arange(1)).W.reshape(-1)[-number]
    twice = [k for k in np.unique(scene.true[late]) if np.count_nonzero(scene.true[~late] == k) > 2]
    for k in twice[:3]:
        chosen, sightings, z = late & (scene.true == k), scene.sightings, scene.sightings.z.copy()
        z[chosen, number] += 4 * sigma
        sightings = type(sightings)(*sightings.keys[:2], z, sightings.noise, sightings.offset)
        longer, apart = replace(scene, sightings=sightings), np.where(chosen, len(z), scene.true)
        one, two = solved(longer, scene.true), solved(longer, apart)
        fall = float(one.graph.chi2(one.values) - two.graph.chi2(two.values))
        pieces = renamed(apart)
        leaving = split(longer, one, pieces, 0.5 * fall)
        assert set(pieces[leaving]) in ({int(np.argmax(chosen))}, {int(np.argmax(scene.true == k))})
        assert np.array_equal(leaving, pieces == pieces[leaving][0])
        assert not split(longer, one, pieces, 2 * fall).any()


@pytest.mark.parametrize("parts", [2, 6])
def test_a_landmark_stays_whole_in_any_pieces(parts: int) -> None:
    """Of right landmarks few seem to be two, at 99 %, and no more where pieces are many."""
    gate, count, split_up = chi2_gate(3, 0.99), 0, 0
    for seed in range(1, 5):
        scene = floor(seed)
        pieces = in_time(scene, parts)
        estimate = solved(scene, scene.true)
        leaving = split(scene, estimate, pieces, gate)
        count += len(np.unique(scene.true[several(estimate.tracks, pieces)]))
        split_up += len(np.unique(scene.true[leaving]))
    assert count > 80
    assert split_up <= 0.02 * count


def test_sightings_of_a_piece_may_share_an_error() -> None:
    """Sigmas are wider than the scatter, and pieces of one target in four are off: it is seen from several sides."""
    gate, count, whole, independent = chi2_gate(3, 0.99), 0, 0, 0
    for seed in range(1, 4):
        scene = floor(seed)
        rng, pieces, sightings = np.random.default_rng(seed), in_time(scene, 4), scene.sightings
        sigma = 5 / scene.pings.model(np.arange(1)).W.reshape(-1)
        off = rng.normal(0, 1.5 * sigma, sightings.z.shape)[pieces]
        z = sightings.z + np.where(scene.true % 4 == 0, 1, 0)[:, None] * off
        wide = replace(scene, sightings=type(sightings)(*sightings.keys[:2], z, Diagonal(sigma), sightings.offset))
        estimate = solved(wide, scene.true)
        assert 0.1 < estimate.reduced_chi2 < 0.9
        count += len(np.unique(scene.true[several(estimate.tracks, pieces)]))
        whole += len(np.unique(scene.true[split(wide, estimate, pieces, gate)]))
        estimate = replace(estimate, reduced_chi2=1.0)
        independent += len(np.unique(scene.true[split(wide, estimate, pieces, gate)]))
    assert whole <= 0.02 * count
    assert independent >= 0.1 * count


def test_pieces_are_put_in_the_order_of_their_pulls() -> None:
    """Every other of six pieces is of a target farther off: they leave together, from between the others."""
    scene = floor(1)
    pieces, part = in_time(scene, 6), scene.pings.ping * 6 // len(scene.pings.poses)
    sigma = 1 / scene.pings.model(np.arange(1)).W.reshape(-1)[0]
    parts = [len(np.unique(part[scene.true == k])) for k in range(scene.true.max() + 1)]
    chosen = (scene.true == int(np.argmax(parts))) & (part % 2 == 1)
    z = scene.sightings.z.copy()
    z[chosen, 0] += 8 * sigma
    sightings = type(scene.sightings)(*scene.sightings.keys[:2], z, scene.sightings.noise, scene.sightings.offset)
    farther = replace(scene, sightings=sightings)
    leaving = split(farther, solved(farther, scene.true), pieces, chi2_gate(3, 0.95))
    other = (scene.true == int(np.argmax(parts))) & ~chosen
    assert max(parts) > 3
    assert np.array_equal(leaving, chosen) or np.array_equal(leaving, other)


@pytest.mark.parametrize("times", [1e-2, 1e-1, 1e1])
def test_a_scene_of_another_size_is_cut_in_the_same_way(times: float) -> None:
    """All lengths and their sigmas times a number: chi2 and its falls stay as they are."""
    falls = []
    for scene in (in_plane(), scaled(in_plane(), times)):
        cuts = Cuts(scene.pings, scene.graph, solved(scene, scene.true), in_time(scene, 4))
        falls.append(cuts.falls(Marginals(cuts.tied.graph, cuts.tied.values)))
    np.testing.assert_allclose(falls[1], falls[0], rtol=0.01)


def test_a_landmark_of_one_piece_stays() -> None:
    scene = floor()
    estimate = solved(scene, scene.true)
    assert not split(scene, estimate, renamed(scene.true), 1e-9).any()
