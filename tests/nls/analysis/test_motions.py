"""Covariances of pairs of poses that share no factor, in one pass."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import sim
from factors import Between, Isotropic, Prior
from models import SE3
from nls import FactorGraph, Marginals, Values, kinds

(x,) = kinds("x")
PAIRS = np.array([[7, 2], [0, 9], [4, 4], [2, 7], [11, 38], [0, 0], [7, 2]])


@pytest.mark.parametrize("kind", [sim.ring, sim.sphere])
def test_the_block_of_any_pair_is_that_of_their_joint_covariance(kind: Callable[..., sim.World]) -> None:
    world = kind(np.random.default_rng(1))
    graph, truth, (i, j) = world.graph, world.truth, PAIRS.T
    C = Marginals(graph, truth, pairs=[(x[i], x[j])]).cross(x[i], x[j], frame="body")
    known, joint = np.unique(PAIRS), Marginals(graph, truth).joint(x[np.unique(PAIRS)], frame="body").matrix
    d = C.shape[1]
    blocks = joint.reshape(len(known), d, len(known), d).transpose(0, 2, 1, 3)
    expected = blocks[np.searchsorted(known, i), np.searchsorted(known, j)]
    np.testing.assert_allclose(C, expected, atol=1e-9 * np.abs(expected).max())
    assert not C[[1, 5]].any()  # x0 is held
    assert np.abs(C[[0, 2, 4]]).max(axis=(1, 2)).min() > 1e-3 * np.abs(expected).max()


def test_pairs_of_one_pose_alone_join_nothing() -> None:
    world = sim.ring(np.random.default_rng(2))
    C = Marginals(world.graph, world.truth, pairs=[(x[[5]], x[[5]])]).cross(x[[5]], x[[5]], frame="body")
    np.testing.assert_allclose(C[0], Marginals(world.graph, world.truth).covariance(x[5], frame="body"), rtol=1e-9)
    motion = Marginals(world.graph, world.truth, pairs=[(x[[5]], x[[25]])]).relative(x[[5]], x[[25]])
    assert np.linalg.eigvalsh(motion[0]).min() > 0


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
    i, j = np.array([0, 1, 3]), np.array([4, 3, 1])
    Sigma = Marginals(graph, values, pairs=[(x[i], x[j])]).relative(x[i], x[j])
    noisy = [np.broadcast_to(values[x[0]], (N, 7))]
    for step in steps:
        moved = SE3.compose(noisy[-1], np.broadcast_to(step, (N, 7)))
        noisy.append(SE3.retract(moved, sigma * rng.normal(size=(N, 6))))
    for k, (a, b) in enumerate(zip(i, j, strict=True)):
        G = SE3.between(values[x[[a]]], values[x[[b]]])
        delta = SE3.local(np.broadcast_to(G, (N, 7)), SE3.between(noisy[a], noisy[b]))
        np.testing.assert_allclose(np.cov(delta.T), Sigma[k], atol=0.05 * Sigma[k].max())
