"""Covariances of pairs of poses that share no factor, in one pass."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import sim
from nls import Marginals, kinds

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
