"""Sightings without names: their pairs are found again, whatever their order; what is false stays out."""

from __future__ import annotations

import sys
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from factors import Bearing, Isotropic, Prior
from models import R
from models.algebra import Array, Index, Mask
from models.errors import GraphError, OptionError, UnderconstrainedError
from nls import FactorGraph, Values, kinds
from nls.filters.association import pair_precision_recall
from nls.metrics import ate
from nls.missions.contacts import Associated, associate
from nls.missions.contacts.splitting import Cuts
from tests.nls.missions.contacts.scenes import Scene, floor, in_plane, poor_ranges

x, l, m = kinds("x", "l", "m")


@cache
def answer(seed: int = 1, outliers: float = 0.0) -> Associated:
    """The association of one leg over the floor."""
    return associated(floor(seed, outliers))


def associated(scene: Scene) -> Associated:
    return associate(scene.graph, scene.values, scene.sightings, scene.aperture)


def error(scene: Scene, values: Values) -> float:
    """ATE, m; nothing is aligned."""
    return float(ate(values[x], scene.truth[x]).rmse)


def partition(numbers: Index) -> set[frozenset[int]]:
    return {frozenset(np.flatnonzero(numbers == number).tolist()) for number in set(numbers[numbers >= 0].tolist())}


@pytest.mark.parametrize("seed", [1, 2])
def test_pairs_over_the_floor(seed: int) -> None:
    scene, result = floor(seed), answer(seed)
    score = pair_precision_recall(result.numbers, scene.true)
    assert score.precision >= 0.97
    assert score.recall >= 0.9
    assert result.settled
    assert result.share > 0.95
    assert error(scene, result.values) < error(scene, scene.values)
    assert abs(result.landmarks - len(np.unique(scene.true))) <= 2


def test_what_is_returned_fits_together() -> None:
    scene, result = floor(), answer()
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
    scene, result = floor(), answer()
    order = np.random.default_rng(3).permutation(len(scene.true))
    other = associate(scene.graph, scene.values, scene.sightings[order], scene.aperture)
    numbers = np.empty_like(other.numbers)
    numbers[order] = other.numbers
    assert partition(numbers) == partition(result.numbers)


def test_names_have_no_influence_nothing_is_changed_and_it_comes_out_the_same_again() -> None:
    scene, result = in_plane(), associated(in_plane())
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


def test_without_noise_all_pairs_are_found() -> None:
    scene = floor(1, 0.0, 0.0)
    result = associated(scene)
    score = pair_precision_recall(result.numbers, scene.true)
    assert min(score) > 0.99
    assert np.nanmax(result.d2) < 1


def named(scene: Scene) -> Values:
    """The solution with the true names and without false contacts."""
    true = np.flatnonzero(scene.true >= 0)
    measured = scene.pings.of_landmarks(scene.true[true], true)
    graph = FactorGraph([*scene.graph.factors, measured, scene.pings.aperture_factor(measured)])
    return graph.optimize(scene.truth_of(scene.true[true])).values


@pytest.mark.parametrize("seed", [1, 2, 4])
def test_false_contacts_stay_out(seed: int) -> None:
    scene, result = floor(seed, 0.1), answer(seed, 0.1)
    score = pair_precision_recall(result.numbers, scene.true)
    assert score.precision >= 0.9
    assert score.recall >= 0.9
    assert error(scene, result.values) < 1.1 * error(scene, named(scene))
    assert np.mean(result.numbers[scene.true < 0] < 0) > 0.7


def test_bearings_and_ranges_in_the_plane() -> None:
    """One scene whose odometry drifts by meters, one where it is better than the sensor."""
    for scene in (in_plane(), poor_ranges()):
        result = associated(scene)
        score = pair_precision_recall(result.numbers, scene.true)
        assert (score.precision, result.settled) == (1.0, True)
        assert score.recall > 0.98
        assert result.values.stack("l").manifold is R(2)
    assert error(in_plane(), associated(in_plane()).values) < error(in_plane(), in_plane().values) / 3


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


def test_gates_become_wider_and_poses_better_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next width comes where a round moves few sightings; the poses of a round are known by the round before."""
    rounds = sys.modules["nls.missions.contacts.associate"]
    real, widths, sigmas = rounds.near_landmarks, [], []

    def near_landmarks(pings: object, estimate: object, Sigma: Array, *others: object) -> object:
        widths.append(others[-1])
        sigmas.append(np.sqrt(Sigma.trace(axis1=1, axis2=2)).max())
        return real(pings, estimate, Sigma, *others)

    monkeypatch.setattr(rounds, "near_landmarks", near_landmarks)
    result = associated(in_plane())
    assert len(widths) == len(result.rounds)
    assert widths[0] == 2.0
    assert all(later in (width, 2 * width, np.inf) for width, later in pairwise(widths))
    assert len(widths) - len(set(widths)) < 2 < len(set(widths))
    assert max(sigmas[1:]) < sigmas[0] / 2


def test_what_a_cut_takes_away_is_apart_after_the_round(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here it takes every other sighting of the largest landmark."""
    masks: list[Mask] = []

    def leaving(cuts: Cuts, *_: object) -> Mask:
        tracks = cuts.tied.tracks
        masks.append((tracks == np.bincount(tracks).argmax()) & (np.arange(len(tracks)) % 2 == 0))
        return masks[-1]

    monkeypatch.setattr(Cuts, "leaving", leaving)
    for tracks, mask in zip(associated(floor(1)).history, masks, strict=True):
        assert mask.any()
        assert len(np.unique(tracks[mask])) == 1
        assert not np.isin(tracks[mask], tracks[~mask]).any()


def test_other_unknowns_of_the_graph_have_no_influence() -> None:
    """Such as a scale error of the log, which a prior holds."""
    scene = in_plane()
    graph = FactorGraph([*scene.graph.factors, Prior(m[0], [0.5], Isotropic(0.1))])
    values = Values.of([*scene.values.stacks.values(), Values({m: (R(1), [0.0])}).stack("m")])
    result = associate(graph, values, scene.sightings)
    np.testing.assert_array_equal(result.numbers, associated(scene).numbers)
    np.testing.assert_allclose(result.values[m], [[0.5]])


def test_the_better_answer_costs_less() -> None:
    """Rounds that end early leave landmarks in pieces."""
    scene = floor(5, 0.1)
    answers = [associate(scene.graph, scene.values, scene.sightings, scene.aperture, rounds=k) for k in (1, 3, 40)]
    cost = [answer.cost for answer in answers]
    recall = [pair_precision_recall(answer.numbers, scene.true).recall for answer in answers]
    assert cost == sorted(set(cost), reverse=True)
    assert recall == sorted(set(recall))


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
    for options in (
        {"least": 1},
        {"rounds": 0},
        {"probability": 1.0},
        {"probability": 0.0},
        {"aperture": -1.0},
        {"aperture": None},
    ):
        with pytest.raises(OptionError, match=next(iter(options))):
            associate(graph, values, sightings, **{"aperture": 0.2, **options})  # type: ignore[arg-type]
    with pytest.raises(GraphError, match="kind 'x' has values already"):
        associate(graph, values, sightings, 0.2, kind=x)
    plane = in_plane()
    pose = plane.sightings.keys[0]
    with pytest.raises(GraphError, match="Bearing leaves more free"):
        associate(plane.graph, plane.values, Bearing(pose, l[plane.true], plane.sightings.z[:, :1], Isotropic(0.1)))
    with pytest.raises(UnderconstrainedError):
        associate(FactorGraph(graph.factors[1:2]), values, sightings, scene.aperture)
