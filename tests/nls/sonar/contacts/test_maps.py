"""Local maps: their joint covariance against a graph that holds the anchor, and the motion between two of them."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2, SE3, LieGroup
from nls import FactorGraph, Marginals, kinds
from nls.analysis.chi_squared import chi2_gate
from nls.sonar.contacts import tracks as of
from nls.sonar.contacts.maps import LocalMap, local_maps, measured_motion
from tests.nls.sonar.contacts.scenes import estimate_of, in_plane

x, l = kinds("x", "l")
GROUPS: dict[str, LieGroup] = {"plane": SE2, "space": SE3}


def test_maps_are_known_as_by_a_graph_that_holds_the_anchor() -> None:
    scene = in_plane()
    pings, tracks = scene.pings, of.renamed(scene.true)
    start, odometry = scene.graph.factors
    sightings = pings.of_landmarks(tracks)
    graph = FactorGraph([start, odometry, sightings])
    values = graph.optimize(scene.truth_by(tracks)).values
    maps = local_maps(pings, estimate_of(tracks, graph, values), 3)
    half = pings.ping >= len(pings.poses) // 2
    assert len(maps) == 2
    for k, local in enumerate(maps):
        landmarks = l[tracks[local.sightings]]
        several = [t for t in np.unique(tracks) if np.count_nonzero((tracks == t) & (half == k)) >= 3]
        assert landmarks.numbers.tolist() == several
        assert (half[local.sightings] == k).all()
        held = FactorGraph([odometry, sightings], [local.anchor])
        n, X = len(several), values[local.anchor]
        C = Marginals(held, values).joint(landmarks).matrix.reshape(n, 2, n, 2).swapaxes(1, 2)
        R = SE2.rotation(X)[0]
        np.testing.assert_allclose(local.C, R.T @ C @ R, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(SE2.act(X, local.p), values[landmarks], atol=1e-12)
        np.testing.assert_array_equal(local.own[-1], local.C[n - 1, n - 1])


def test_a_map_of_few_sightings_has_no_landmark() -> None:
    scene = in_plane()
    alone = np.arange(len(scene.pings))
    assert local_maps(scene.pings, estimate_of(alone, scene.graph, scene.at_the_truth()), 3) == []


def two_maps(group: LieGroup, rng: np.random.Generator) -> tuple[LocalMap, LocalMap, np.ndarray]:
    """Maps of the same 40 landmarks, whose errors grow together with the way to the anchor, and the motion between."""
    k, d = 40, group.point_dim
    xi = rng.normal(size=group.dim) * ([2.0] * d + [0.3] * (group.dim - d))
    G = group.exp(xi[None])
    p = rng.uniform(-6, 6, (k, d))
    maps = []
    for seen in (group.act(G, p), p):
        bend = np.einsum("k,ij->kij", np.abs(seen[:, 0]), np.eye(d)) * 0.02
        C = np.einsum("kia,lja->klij", bend, bend) + np.einsum("kl,ij->klij", np.eye(k), 0.02**2 * np.eye(d))
        L = np.linalg.cholesky(C.swapaxes(1, 2).reshape(k * d, k * d))
        maps.append(LocalMap(x[[0]], np.arange(k), seen + (L @ rng.normal(size=k * d)).reshape(k, d), C))
    return maps[0], maps[1], G


@pytest.mark.parametrize("name", GROUPS)
def test_the_information_of_a_motion_is_neither_more_nor_less_than_its_error(name: str) -> None:
    group, rng, k = GROUPS[name], np.random.default_rng(0), np.arange(40)
    nees = []
    for _ in range(100):
        a, b, G = two_maps(group, rng)
        start = group.compose(G, group.exp(0.05 * rng.normal(size=(1, group.dim))))[0]
        motion, Omega, agree = measured_motion(group, a, b, k, k, start, chi2_gate(group.point_dim, 0.9999))
        error = group.log(group.between(motion[None], G))[0]
        nees.append(error @ Omega @ error)
        assert np.count_nonzero(~agree) <= 2
    assert 0.8 * group.dim < np.mean(nees) < 1.25 * group.dim


@pytest.mark.parametrize("name", GROUPS)
def test_a_match_that_the_others_contradict_is_left_out(name: str) -> None:
    group, k = GROUPS[name], np.arange(40)
    gate = chi2_gate(group.point_dim, 0.999)
    a, b, G = two_maps(group, np.random.default_rng(1))
    others = np.where(k < 3, (k + 1) % 3, k)  # three landmarks are taken for one another
    motion, _, agree = measured_motion(group, a, b, k, others, G[0], gate)
    assert not agree[:3].any()
    assert np.count_nonzero(agree) >= 35
    same = np.flatnonzero(agree)
    np.testing.assert_allclose(motion, measured_motion(group, a, b, same, same, G[0], gate)[0], atol=1e-6)
