"""Motions by anchors against the joint covariances of the graph, and landmarks beside their anchors."""

from __future__ import annotations

import numpy as np
import pytest

from models.algebra import Array, Index
from nls import FactorGraph, Marginals, kinds
from nls.missions.contacts import anchors
from nls.missions.contacts import tracks as of
from nls.missions.contacts.anchors import Anchored
from nls.missions.contacts.estimate import Estimate
from nls.missions.contacts.stretches import bounds
from tests.nls.missions.contacts.scenes import Scene, estimate_of, floor, in_plane

l = kinds("l")[0]
SCENES = {"floor": floor, "in_plane": in_plane}
PINGS = 5


@pytest.fixture(autouse=True)
def short_stretches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(anchors, "PINGS", PINGS)


def with_landmarks(scene: Scene) -> Estimate:
    """All poses and landmarks by all sightings, with their true names."""
    pings, tracks = scene.pings, of.renamed(scene.true)
    measured = pings.of_landmarks(tracks)
    graph = FactorGraph([*scene.graph.factors, measured])
    if pings.limit:
        graph.add(pings.aperture_factor(measured))
    return estimate_of(tracks, graph, graph.optimize(scene.truth_by(tracks)).values)


def first_sightings(scene: Scene) -> Index:
    """A sighting (m,) of every ping."""
    return np.unique(scene.pings.ping, return_index=True)[1]


def exact(scene: Scene, estimate: Estimate, i: Index, j: Index) -> Array:
    """Covariances (k, d, d) of motions from pings i to j, by the graph."""
    keys = scene.pings.poses[i], scene.pings.poses[j]
    return Marginals(estimate.graph, estimate.values, pairs=[keys]).relative(*keys)


def test_by_odometry_a_way_past_the_anchors_is_exact() -> None:
    scene = in_plane()
    estimate = estimate_of(np.arange(len(scene.true)), scene.graph, scene.values)
    first, begin = first_sightings(scene), bounds(len(scene.pings.poses), PINGS)
    i, j = np.triu_indices(len(first), 1)
    middle = (begin[:-1] + begin[1:]) // 2
    a, b = (middle[np.searchsorted(begin, ping, side="right") - 1] for ping in (i, j))
    motions = Anchored(scene.pings, estimate, (first[i], first[j])).of_sightings(first[i], first[j])
    Sigma, whole = motions.Sigma[motions.which], exact(scene, estimate, i, j)
    past = (i <= a) & (b <= j)
    assert (past & (a < b)).sum() > 100
    np.testing.assert_allclose(Sigma[past], whole[past], rtol=1e-6, atol=1e-12)
    more = np.linalg.eigvalsh(Sigma - whole)[~past]
    assert (more[:, 0] > -1e-9).all()  # a way back to an anchor adds its error
    assert (more[:, -1] > 1e-6).all()


@pytest.mark.parametrize("name", SCENES)
def test_with_landmarks_motions_are_not_far_from_their_joint_covariance(name: str) -> None:
    scene = SCENES[name]()
    estimate, first = with_landmarks(scene), first_sightings(scene)
    i, j = np.triu_indices(len(first), 1)
    motions = Anchored(scene.pings, estimate, (first[i], first[j])).of_sightings(first[i], first[j])
    Sigma, whole = motions.Sigma[motions.which], exact(scene, estimate, i, j)
    ratio = np.sqrt(np.trace(Sigma, axis1=1, axis2=2) / np.trace(whole, axis1=1, axis2=2))
    assert 1 < np.median(ratio) < 1.5
    assert ratio.min() > 0.9


@pytest.mark.parametrize("name", SCENES)
def test_landmarks_beside_their_anchors(name: str) -> None:
    """R_a (X_a^-1 l) moves with pose and landmark; its covariance is J P J' with the joint P."""
    scene = SCENES[name]()
    estimate, pings = with_landmarks(scene), scene.pings
    numbers, group = estimate.values.stack("l").numbers, pings.group
    anchored = Anchored(pings, estimate)
    C, marginals = anchored.landmarks(), Marginals(estimate.graph, estimate.values)
    begin = bounds(len(pings.poses), PINGS)
    for row in range(0, len(numbers), 3):
        stretch = np.searchsorted(begin, pings.ping[numbers[row]], side="right") - 1
        a = pings.poses[int((begin[stretch] + begin[stretch + 1]) // 2)]
        X, p, d = estimate.values[a][None], estimate.values[l[int(numbers[row])]][None], group.dim

        def seen(step: Array, X: Array = X, p: Array = p, d: int = d) -> Array:
            moved = group.compose(X, group.exp(step[None, :d]))
            q = group.act(group.inverse(moved), p + step[None, d:])
            return (group.rotation(X) @ q[..., None])[0, :, 0]

        steps = 1e-6 * np.eye(d + p.shape[1])
        J = np.stack([(seen(step) - seen(-step)) / 2e-6 for step in steps], axis=1)
        P = marginals.joint([a, l[int(numbers[row])]], frame="body").matrix
        np.testing.assert_allclose(C[row], J @ P @ J.T, rtol=1e-4, atol=1e-10)
