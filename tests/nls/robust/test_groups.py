"""Which closures are judged together: clusters, and the loose parts of large ones."""

from __future__ import annotations

import numpy as np

from factors import Between, Diagonal
from models import SE2
from models.algebra import Index
from nls import FactorGraph, Values, kinds
from nls.robust.groups import misfits, witnesses
from nls.robust.loop_graph import Neighbors, loop_graph

(x,) = kinds("x")


def row(ends: list[int], window: int = 5) -> Index:
    """Pairs (p, 2) of closures at some steps that are at most so far from each other."""
    at = np.asarray(ends)
    i, j = np.triu_indices(len(at), 1)
    return np.column_stack([i, j])[at[j] - at[i] <= window]


def neighbors(ends: list[int]) -> Neighbors:
    """One cluster of closures at some steps."""
    n = len(ends)
    return Neighbors(np.zeros(n, dtype=np.intp), np.zeros(n, dtype=np.intp), near=row(ends))


def test_closures_that_are_far_from_all_others_of_their_cluster_are_a_part_of_their_own() -> None:
    parts = neighbors([*range(100), *range(113, 123)]).parts(np.ones(110, dtype=bool))
    assert parts.tolist() == [0] * 100 + [100] * 10


def test_a_row_falls_apart_where_what_joins_it_was_not_accepted() -> None:
    accepted, cluster = np.ones(90, dtype=bool), neighbors([*range(90)])
    assert not cluster.parts(accepted).any()
    accepted[30:50] = False
    assert set(cluster.parts(accepted)[accepted]) == {0, 50}


def test_a_wrong_part_of_a_large_cluster_is_contradicted_by_the_rest() -> None:
    rng, n = np.random.default_rng(3), 120
    sigma = np.array([0.05, 0.05, 0.02])
    turn = SE2.exp(np.tile([1.0, 0.0, 2 * np.pi / n], (2 * n - 1, 1)))
    noise = Diagonal(x=sigma[0], y=sigma[1], yaw=sigma[2])
    odometry = Between(
        x[0 : 2 * n - 1], x[1 : 2 * n], SE2.compose(turn, SE2.exp(rng.normal(0, sigma, turn.shape))), noise
    )
    right = Between(x[0:n], x[n : 2 * n], SE2.exp(rng.normal(0, sigma, (n, 3))), noise)
    ahead, aside = SE2.exp([[11.0, 0.0, 11 * 2 * np.pi / n]] * 8), np.tile([0.0, 1.5, 0.0], (8, 1))
    z = SE2.compose(SE2.compose(ahead, aside), SE2.exp(rng.normal(0, sigma, (8, 3))))
    graph = FactorGraph([odometry, right, Between(x[40:48], x[n + 51 : n + 59], z, noise)])
    loops = loop_graph(graph, Values({x: (SE2, np.zeros((2 * n, 3)))}))
    assert len(np.unique(loops.neighbors.cluster)) == 1
    result = graph.optimize(loops.values)
    judged = list(witnesses(loops, result.values, np.ones(n + 8, dtype=bool)))
    assert np.flatnonzero(misfits(judged, result, loops)).tolist() == [*range(n, n + 8)]
