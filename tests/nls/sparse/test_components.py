"""Connected components against scipy's, under every numbering of the nodes."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from nls.sparse.elimination import connected, firsts


def test_components_of_trajectories_with_gaps_and_closures() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 60))
        step = np.flatnonzero(rng.random(n - 1) < 0.8)  # some neighbors are not joined
        closures = rng.integers(0, n, (2, 4))
        for order in (np.arange(n), np.arange(n)[::-1], rng.permutation(n)):
            i, j = order[np.append(step, closures[0])], order[np.append(step + 1, closures[1])]
            turned = rng.random(len(i)) < 0.3
            i, j = np.where(turned, j, i), np.where(turned, i, j)
            _, label = connected_components(sp.csr_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)
            assert connected(i, j, n).tolist() == [int(np.argmax(label == own)) for own in label], seed


def test_no_pairs_and_no_nodes() -> None:
    none = np.zeros(0, dtype=np.intp)
    assert connected(none, none, 3).tolist() == [0, 1, 2]
    assert connected(none, none, 0).tolist() == []
    assert firsts(np.array([0, 0]), none).tolist() == []


def test_the_first_of_some_nodes_in_every_component() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        component = connected(rng.integers(0, 30, 15), rng.integers(0, 30, 15), 30)
        nodes = rng.permutation(30)[:20]
        expected = {int(c): next(int(v) for v in nodes if component[v] == c) for c in component[nodes]}
        assert firsts(component, nodes).tolist() == [expected[c] for c in sorted(expected)]
