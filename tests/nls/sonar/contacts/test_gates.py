"""Distances in sigmas: those of true pairs are as chi2 has them, those of others are not; motions against samples."""

from __future__ import annotations

import numpy as np
import pytest

from factors import Between, Isotropic, Prior
from models import SE3
from models.algebra import Array, Index
from nls import FactorGraph, Marginals, Values, kinds
from nls.sonar.contacts.gates import landmark_distances, motion_covariances, sighting_distances
from nls.sonar.contacts.places import Pings
from tests.nls.sonar.contacts.scenes import GATE, Scene, estimate_of, floor, in_plane, true_pairs

x, l = kinds("x", "l")


def pairs_of(scene: Scene) -> tuple[Array, Array, Index, Index]:
    """d2 and widths of all true pairs, by dead reckoning, and the pairs."""
    c, d = true_pairs(scene)
    return *sighting_distances(scene.pings, scene.graph, scene.values, c, d), c, d


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
        d2, _ = sighting_distances(pings, scene.graph, scene.values, c[apart], d[apart])
        assert len(d2) > 100
        assert d2.min() > GATE


def test_a_point_between_two_of_the_arc_is_as_good() -> None:
    """Without noise a true pair has d2 = 0 at any elevation: the polyline through the points is the arc, nearly."""
    scene = floor(1, 0.0, 0.0)
    d2, _, _, _ = pairs_of(scene)
    assert d2.max() < 0.05


def test_motions_against_samples() -> None:
    """Poses after a chain of noisy steps: their motions scatter by these covariances, in the axes of the second."""
    rng, n, N = np.random.default_rng(1), 5, 20_000
    steps = SE3.exp(0.6 * rng.normal(size=(n - 1, 6)))
    sigma = 0.02
    graph = FactorGraph([Prior(x[0], SE3.identity(1)[0], Isotropic(0.01))])
    graph.add(Between(x[np.arange(n - 1)], x[np.arange(1, n)], steps, Isotropic(sigma)))
    X = [SE3.identity(1)]
    for step in steps:
        X.append(SE3.compose(X[-1], step[None]))
    values = Values({x: (SE3, np.concatenate(X))})
    scene = floor()
    sightings = scene.sightings[np.arange(n)]
    pings = Pings.of(type(sightings)(x[np.arange(n)], l[np.arange(n)], sightings.z, sightings.noise), values, l, 0.2)
    i, j = np.array([0, 1, 3]), np.array([4, 3, 1])
    Sigma = motion_covariances(pings, graph, values, i, j)
    noisy = [np.broadcast_to(values[x[0]], (N, 7))]
    for step in steps:
        moved = SE3.compose(noisy[-1], np.broadcast_to(step, (N, 7)))
        noisy.append(SE3.retract(moved, sigma * rng.normal(size=(N, 6))))
    for k, (a, b) in enumerate(zip(i, j, strict=True)):
        G = SE3.between(values[x[[a]]], values[x[[b]]])
        delta = SE3.local(np.broadcast_to(G, (N, 7)), SE3.between(noisy[a], noisy[b]))
        np.testing.assert_allclose(np.cov(delta.T), Sigma[k], atol=0.05 * Sigma[k].max())


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
