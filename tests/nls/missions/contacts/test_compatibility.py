"""The sightings of a ping together: what one of them leaves open, the others decide."""

from __future__ import annotations

import numpy as np
import pytest

from factors import BearingRange, Between, Diagonal, Isotropic, Prior
from models import SE2, R
from models.algebra import Index, Mask
from nls import FactorGraph, Marginals, Values, kinds
from nls.analysis.chi_squared import chi2_gate
from nls.filters import association
from nls.missions.contacts.anchors import Anchored
from nls.missions.contacts.compatibility import resolved
from nls.missions.contacts.estimate import Estimate, estimated
from nls.missions.contacts.gates import ping_innovations
from nls.missions.contacts.pairs import near_landmarks
from nls.missions.contacts.places import Pings
from nls.missions.contacts.tracks import renamed, single, sizes
from tests.nls.missions.contacts.scenes import covariances_of_poses, landmark_distances

x, l = kinds("x", "l")
NOISE = Diagonal(bearing=0.002, range=0.02)


def row(shift: float, trees: list[int]) -> tuple[Pings, FactorGraph, Values]:
    """Five trees 1 m apart, all visible from four poses; some from a fifth, whose dead reckoning is off by `shift`."""
    tree = np.concatenate([np.tile(np.arange(5), 4), np.array(trees, dtype=int)])
    pose = np.concatenate([np.repeat(np.arange(4), 5), np.full(len(trees), 4)])
    X = np.zeros((5, 3))
    X[:, 0] = [0, 1, 2, 3, 2]
    local = np.column_stack([tree, np.full(len(tree), 8)]) - X[pose, :2]
    z = np.column_stack([np.arctan2(local[:, 1], local[:, 0]), np.hypot(*local.T)])
    X[4, 0] += shift
    sigmas = np.array([[0.01, 0.01, 1e-3]] * 3 + [[0.5, 0.01, 1e-3]])
    odometry = Between(x[np.arange(4)], x[np.arange(1, 5)], SE2.between(X[:-1], X[1:]), Diagonal(sigmas))
    graph = FactorGraph([Prior(x[0], X[0], Isotropic(1e-3)), odometry])
    sightings = BearingRange(x[pose], l[np.zeros(len(tree), dtype=int)], z, NOISE)
    values = Values({x: (SE2, X)})
    return Pings.of(sightings, values, l, None), graph, values


def known_trees(trees: list[int]) -> Index:
    """Tracks of the sightings of a row: the trees from the first four poses, and all of the fifth alone."""
    return np.concatenate([np.tile(np.arange(5), 4), 20 + np.arange(len(trees))])


def decided(pings: Pings, estimate: Estimate, open_: Mask, least: int, probability: float) -> Index:
    """`resolved`, what is near by the covariances of the same estimate."""
    Sigma, gate = covariances_of_poses(pings, estimate), chi2_gate(2, probability)
    d, landmarks = near_landmarks(pings, estimate, Sigma, np.flatnonzero(open_), gate)
    return resolved(pings, estimate, Anchored(pings, estimate, (landmarks, d)), d, landmarks, least, probability)


def answer(shift: float, trees: list[int]) -> list[int]:
    """The tree that each sighting from the fifth pose is given to, -1 where it stays alone."""
    pings, graph, values = row(shift, trees)
    every = np.ones(len(pings), dtype=bool)
    tracks = decided(pings, estimated(pings, graph, values, known_trees(trees)), every, 3, 0.999)
    assert np.array_equal(tracks[:20], known_trees([]))
    return [int(track) if track < 5 else -1 for track in tracks[20:]]


def test_all_of_a_ping_decide_where_the_nearest_is_wrong() -> None:
    """0.6 m off, every tree but the last looks like the next one. Only without a shift have all five a tree."""
    trees = [0, 1, 2, 3, 4]
    pings, graph, values = row(0.6, trees)
    estimate = estimated(pings, graph, values, known_trees(trees))
    d, landmarks = np.repeat(20 + np.arange(5), 5), np.tile(np.arange(5), 5)
    d2, _ = landmark_distances(pings, estimate, d, landmarks)
    assert d2.reshape(5, 5).argmin(axis=1).tolist() == [1, 2, 3, 4, 4]
    assert answer(0.6, trees) == trees
    assert answer(0.6, [4, 2, 0, 1, 3]) == [4, 2, 0, 1, 3]
    assert answer(0.6, [1]) == [2]  # one alone goes to the nearest
    assert answer(0.0, [1, 3]) == [1, 3]


def test_a_landmark_has_one_sighting_in_a_ping() -> None:
    """The second sighting of tree 2 stays alone; a decided one keeps its tree."""
    assert sorted(answer(0.0, [2, 2])) == [-1, 2]
    trees = [2, 2]
    pings, graph, values = row(0.0, trees)
    tracks = known_trees(trees)
    tracks[20] = 2  # the first is decided
    every = np.ones(len(pings), dtype=bool)
    estimate = estimated(pings, graph, values, tracks)
    assert decided(pings, estimate, every, 3, 0.999).tolist() == tracks.tolist()


def test_a_sighting_that_is_not_open_stays_alone() -> None:
    pings, graph, values = row(0.0, [1, 3])
    open_ = np.arange(len(pings)) != 21
    tracks = decided(pings, estimated(pings, graph, values, known_trees([1, 3])), open_, 3, 0.999)
    assert tracks[20:].tolist() == [1, 21]


def test_a_ping_of_too_many_sets_stays_undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    pings, graph, values = row(0.0, [1, 3])
    tracks, every = known_trees([1, 3]), np.ones(len(pings), dtype=bool)
    estimate = estimated(pings, graph, values, tracks)
    assert decided(pings, estimate, every, 3, 0.999)[20:].tolist() == [1, 3]
    monkeypatch.setattr(association, "NODES", 1)
    assert decided(pings, estimate, every, 3, 0.999).tolist() == tracks.tolist()


def test_tracks_smaller_than_a_landmark_are_open() -> None:
    """A pair of sightings of tree 1, taken for a landmark of its own, is given back to it; so is a needless track."""
    pings, graph, values = row(0.0, [1])
    for count in (1, 2):
        tracks = known_trees([1])
        tracks[tracks == 1] = [1] * (4 - count) + [20] * count
        tracks[20] = 20
        tracks = renamed(tracks)
        assert sizes(tracks)[20] == count + 1
        estimate = estimated(pings, graph, values, tracks)
        assert decided(pings, estimate, np.ones(21, dtype=bool), 3 if count == 1 else 2, 0.999).tolist() == [
            *known_trees([]),
            1,
        ]


def test_the_covariance_of_a_ping_is_that_of_the_joint_one() -> None:
    """S = A P A' + I with P of the pose and all landmarks of its ping, from `Marginals.joint`."""
    trees = [0, 2, 3]
    pings, graph, values = row(0.3, trees)
    estimate = estimated(pings, graph, values, known_trees(trees))
    d, landmarks = np.array([3, 3, 4, 20, 21, 21]), np.array([3, 2, 1, 0, 2, 1])
    marginals = Marginals(estimate.graph, estimate.values)
    for part, nu, S_ping in ping_innovations(pings, estimate, d, landmarks):
        numbers, column = np.unique(landmarks[part], return_inverse=True)
        pose = pings.poses[pings.ping[d[part]]]
        P = marginals.joint([pose[[0]], l[numbers]], frame="body").matrix
        model = pings.of_landmarks(landmarks[part], d[part]).bind(SE2, R(2))
        (A_X, A_l), innovation = model.linearize(estimate.values[pose], estimate.values[l[landmarks[part]]])
        A = np.zeros((3, 2, len(P)))
        A[:, :, :3] = A_X
        for k in range(3):
            A[k, :, 3 + 2 * column[k] : 5 + 2 * column[k]] = A_l[k]
        A = A.reshape(6, len(P))
        np.testing.assert_allclose(S_ping, A @ P @ A.T + np.eye(6), rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(nu, innovation)


def test_only_a_decided_landmark_is_given_sightings() -> None:
    """Of tree 1 two sightings are together and two alone: with three for a landmark all four are alone."""
    pings, graph, values = row(0.0, [3])
    tracks = known_trees([3])
    tree = np.flatnonzero(tracks == 1)
    tracks = single(tracks, tree[2:])
    every, estimate = np.ones(len(pings), dtype=bool), estimated(pings, graph, values, tracks)
    assert decided(pings, estimate, every, 3, 0.999)[tree].tolist() == tree.tolist()
    assert decided(pings, estimate, every, 2, 0.999)[tree].tolist() == [1, 1, 1, 1]
