"""Distances in sigmas: those of true pairs are as chi2 has them, those of others are not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from factors import RangeAzimuth
from models.algebra import Array, Index
from nls import FactorGraph, Marginals, kinds
from nls.missions.contacts import gates
from nls.missions.contacts import tracks as of
from tests.nls.missions.contacts.scenes import (
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


def test_pairs_are_the_same_at_once_or_a_few_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = floor()
    whole = pairs_of(scene)[:2]
    monkeypatch.setattr(gates, "AT_ONCE", 7)
    np.testing.assert_array_equal(pairs_of(scene)[:2], whole)


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


def test_the_arc_against_numerical_derivatives() -> None:
    """d2 along a fine arc. S of its middle by differences of the motion, and of both numbers of the first contact."""
    scene = floor()
    pings, (c, d) = scene.pings, true_pairs(scene)
    group, values = pings.group, scene.values
    c, d = c[::40], d[::40]
    i, j = pings.poses[pings.ping[c]], pings.poses[pings.ping[d]]
    Sigma = Marginals(scene.graph, values, pairs=[(i, j)]).relative(i, j)
    elevation = np.linspace(-1, 1, 801) * pings.limit
    sensor, n, step = pings.sensors(values)[c], len(elevation), 1e-6
    d2, widths = sighting_distances(scene, c, d)
    for k in range(len(c)):
        model, X = pings.model(np.full(n, d[k])), np.repeat(values[j[[k]]], n, axis=0)

        def innovation(delta: Array, dz: Array, k: int = k, model: Any = model, X: Array = X) -> Array:
            z = np.repeat(pings.model(c[[k]]).z + dz, n, axis=0)
            L = group.act(np.repeat(sensor[[k]], n, axis=0), RangeAzimuth.arc(z, elevation))
            return np.asarray(model.error(group.compose(X, group.exp(np.tile(delta, (n, 1)))), L))

        zero, still = np.zeros(group.dim), np.zeros(2)
        b, middle = innovation(zero, still), n // 2
        A = np.stack([(innovation(e, still) - b)[middle] / step for e in step * np.eye(group.dim)], axis=1)
        B = np.stack([(innovation(zero, e) - b)[middle] / step for e in step * np.eye(2)], axis=1)
        S = np.eye(2) + A @ Sigma[k] @ A.T + (B / pings.model(c[[k]]).W.reshape(-1) ** 2) @ B.T
        assert d2[k] == pytest.approx((b * np.linalg.solve(S, b.T).T).sum(axis=1).min(), rel=0.01, abs=0.01)
        assert widths[k] == pytest.approx(np.sqrt(np.linalg.eigvalsh(S)[-1]), rel=1e-4)


@pytest.mark.parametrize("name", ["floor", "in_plane"])
def test_a_landmark_known_from_elsewhere(name: str) -> None:
    """Landmarks of the first pings, and poses that have not seen them; beside it the gate by the joint covariance P."""
    scene = {"floor": floor, "in_plane": in_plane}[name]()
    pings, first = scene.pings, 12
    early = np.flatnonzero((pings.ping < first) & np.isin(scene.true, scene.true[pings.ping == 3]))
    late = np.flatnonzero((pings.ping >= first) & np.isin(scene.true, scene.true[early]))[::2]
    tracks = np.full(len(scene.true), -1)
    tracks[early] = early[of.renamed(scene.true[early])]
    numbers = np.unique(tracks[early])
    first_of = dict(zip(scene.true[numbers].tolist(), numbers.tolist(), strict=True))
    target = np.array([first_of[name] for name in scene.true[late].tolist()])
    measured = pings.of_landmarks(tracks[early], early)
    graph = FactorGraph([*scene.graph.factors, measured])
    if pings.limit:
        graph.add(pings.aperture_factor(measured))
    values = graph.optimize(scene.truth_by(tracks[early])).values
    estimate = estimate_of(tracks, graph, values)
    d2, widths = landmark_distances(pings, estimate, late, target)
    pose, landmark, A, b = estimate.linearized(pings, late, target)
    marginals, joint_d2, joint_width = Marginals(graph, values), np.empty(len(late)), np.empty(len(late))
    for k in range(len(late)):
        P = marginals.joint([pose[k], landmark[k]], frame="body").matrix
        A_k = np.concatenate([A[0][k], A[1][k]], axis=1)
        S = np.eye(2) + A_k @ P @ A_k.T
        joint_d2[k], joint_width[k] = b[k] @ np.linalg.solve(S, b[k]), np.sqrt(np.linalg.eigvalsh(S)[-1])
    assert 1 < np.median(widths / joint_width) < 1.3  # errors count as independent
    assert 0.7 < np.median(d2 / joint_d2) < 1
    assert np.mean(d2 < GATE) > 0.9
    wrong = np.roll(target, 1)
    other = wrong != target
    assert np.median(landmark_distances(pings, estimate, late[other], wrong[other])[0]) > GATE
    assert [len(array) for array in landmark_distances(pings, estimate, late[:0], wrong[:0])] == [0, 0]
