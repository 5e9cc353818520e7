"""Distances in sigmas: those of true pairs are as chi2 has them, those of others are not."""

from __future__ import annotations

import numpy as np
import pytest

from models.algebra import Array, Index
from nls import FactorGraph, Marginals, kinds
from tests.nls.sonar.contacts.scenes import (
    GATE,
    Scene,
    estimate_of,
    floor,
    in_plane,
    landmark_distances,
    sighting_distances,
    true_pairs,
)

l = kinds("l")[0]


def pairs_of(scene: Scene) -> tuple[Array, Array, Index, Index]:
    """d2 and widths of all true pairs, by dead reckoning, and the pairs."""
    c, d = true_pairs(scene)
    return *sighting_distances(scene, c, d), c, d


@pytest.mark.parametrize("seed", [1, 2])
def test_true_pairs_are_within_the_gate(seed: int) -> None:
    """The arc leaves one of two numbers free at worst, so that the mean is between 1 and 2."""
    scene = floor(seed)
    d2, widths, c, _ = pairs_of(scene)
    assert 0.8 < d2.mean() < 2.3
    assert np.mean(d2 < GATE) > 0.99
    assert (widths > 1).all()
    far = scene.pings.ping[c] < 2  # dead reckoning is poor, and the widths know
    assert widths[far].max() > 2 * np.quantile(widths, 0.1)


def test_in_the_plane_the_mean_is_that_of_two_numbers() -> None:
    d2, _, c, d = pairs_of(in_plane())
    near = in_plane().pings.ping[d] - in_plane().pings.ping[c] < 10  # errors of the whole way are not linear
    assert d2[near].mean() == pytest.approx(2, abs=0.4)
    assert np.mean(d2[near] < GATE) > 0.99


def test_pairs_of_different_landmarks_are_outside() -> None:
    for scene in (floor(), in_plane()):
        pings = scene.pings
        c, d = np.nonzero((scene.true[:, None] != scene.true) & (pings.ping[:, None] + 1 == pings.ping))
        apart = np.linalg.norm(scene.truth[l[scene.true[c]]] - scene.truth[l[scene.true[d]]], axis=1) > 2
        d2, _ = sighting_distances(scene, c[apart], d[apart])
        assert len(d2) > 100
        assert d2.min() > GATE


def test_a_point_between_two_of_the_arc_is_as_good() -> None:
    """Without noise a true pair has d2 = 0 at any elevation: the polyline through the points is the arc, nearly."""
    scene = floor(1, 0.0, 0.0)
    d2, _, _, _ = pairs_of(scene)
    assert d2.max() < 0.05


def test_a_landmark_known_from_elsewhere_against_the_dense_covariance() -> None:
    """Landmarks of the first pass, and a pose that has not seen them: b' (I + A P A')^-1 b with the joint P."""
    scene = floor()
    pings = scene.pings
    early = np.flatnonzero((pings.ping < 12) & np.isin(scene.true, scene.true[pings.ping == 3]))
    graph = FactorGraph([*scene.graph.factors, pings.of_landmarks(scene.true[early], early)])
    graph.add(pings.aperture_factor(pings.of_landmarks(scene.true[early], early)))
    values = graph.optimize(scene.truth_of(scene.true[early])).values
    late = np.flatnonzero((pings.ping >= 12) & np.isin(scene.true, scene.true[early]))[::7]
    estimate = estimate_of(scene.true, graph, values)
    d2, widths = landmark_distances(pings, estimate, late, scene.true[late], np.inf)
    marginals = Marginals(graph, values)
    for k in range(0, len(late), 4):
        pose, point = scene.sightings.keys[0][late[k]], l[int(scene.true[late[k]])]
        P = marginals.joint([pose, point], frame="body").matrix
        model = pings.model(late[[k]])
        (A_X, A_l), b = model.linearize(values[pose][None], values[point][None])
        A = np.concatenate([A_X[0], A_l[0]], axis=1)
        S = np.eye(2) + A @ P @ A.T
        assert d2[k] == pytest.approx(b[0] @ np.linalg.solve(S, b[0]), rel=1e-6)
        assert widths[k] == pytest.approx(np.sqrt(np.linalg.eigvalsh(S)[-1]), rel=1e-6)
    assert np.mean(d2 < GATE) > 0.9
    wrong = np.roll(scene.true[late], 1)
    other = wrong != scene.true[late]
    exact = landmark_distances(pings, estimate, late[other], wrong[other], np.inf)[0]
    assert np.median(exact) > GATE
    quick = landmark_distances(pings, estimate, late[other], wrong[other], GATE)[0]
    assert np.array_equal(quick < GATE, exact < GATE)
    assert (quick <= exact * (1 + 1e-9)).all()  # a bound from below
    assert (quick < 0.99 * exact).any()
    np.testing.assert_allclose(quick[quick < GATE], exact[quick < GATE])
    assert [len(array) for array in landmark_distances(pings, estimate, late[:0], wrong[:0], GATE)] == [0, 0]
