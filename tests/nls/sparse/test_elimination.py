"""The order of an elimination, AMD's or METIS's, and for what it is kept; connected components; the size of R."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

import nls.linear.cholesky as cholesky
from models.algebra import Index
from nls.sparse.elimination import Elimination, connected, firsts
from nls.sparse.fill import counted, rows_below
from nls.sparse.pattern import Pattern
from nls.values import Values
from tests.nls.graphs import cube

CHOLMOD = pytest.mark.skipif(cholesky.cholmod() is None, reason="needs CHOLMOD")


def asked(monkeypatch: pytest.MonkeyPatch, built_with_metis: bool = True) -> list[str]:
    """The methods CHOLMOD is asked for; without METIS it falls back to AMD by itself."""
    module: Any = cholesky.cholmod()
    methods: list[str] = []

    def analyze(graph: Any, mode: str, ordering_method: str) -> Any:
        methods.append(ordering_method)
        return module.analyze(graph, mode=mode, ordering_method=ordering_method if built_with_metis else "amd")

    monkeypatch.setattr(cholesky, "cholmod", lambda: SimpleNamespace(analyze=analyze))
    return methods


def ordered(u: Index, v: Index, V: int) -> tuple[Index, float]:
    """The order, which is one, and its flops."""
    order = Elimination(u, v, V, cholesky.Cholmod.order).variables
    assert np.array_equal(np.sort(order), np.arange(V))
    return order, counted(np.ones(V, dtype=np.intp), u, v, order).flops


@CHOLMOD
def test_a_large_graph_with_much_fill_takes_metis_which_costs_less(monkeypatch: pytest.MonkeyPatch) -> None:
    u, v = cube(23)
    V = 23**3
    assert len(u) > cholesky.AMD_PAIRS
    with monkeypatch.context() as patch:
        methods = asked(patch)
        order, flops = ordered(u, v, V)
        assert methods == ["amd", "metis"]
        assert np.array_equal(ordered(u, v, V)[0], order)  # every time the same
    with monkeypatch.context() as patch:
        methods = asked(patch, built_with_metis=False)
        without, _ = ordered(u, v, V)
        assert methods == ["amd", "metis"]
    monkeypatch.setattr(cholesky, "AMD_PAIRS", len(u))
    amd, more = ordered(u, v, V)
    assert np.array_equal(without, amd)
    assert not np.array_equal(order, amd)
    assert more > cholesky.COSTLY * len(u)
    assert flops < 0.7 * more


@CHOLMOD
def test_a_large_graph_with_little_fill_stays_with_amd(monkeypatch: pytest.MonkeyPatch) -> None:
    V = 40_000
    methods = asked(monkeypatch)
    _, flops = ordered(np.arange(V - 1), np.arange(1, V), V)
    assert flops < 10 * V
    assert methods == ["amd"]


@CHOLMOD
def test_a_small_graph_is_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def counting(*_: object) -> None:
        raise AssertionError("counted")

    u, v = cube(21)
    assert 20_687 < len(u) <= cholesky.AMD_PAIRS  # city10000, the largest public set of its kind
    monkeypatch.setattr(cholesky, "counted", counting)
    methods = asked(monkeypatch)
    _, flops = ordered(u, v, 21**3)
    assert flops > cholesky.COSTLY * len(u)
    assert methods == ["amd"]
    with pytest.raises(AssertionError, match="counted"):
        ordered(*cube(23), 23**3)


def test_an_elimination_is_kept_for_the_same_pairs_and_for_no_others() -> None:
    def backward(u: Index, v: Index, V: int) -> Index:
        return np.arange(V)[::-1]

    def forward(u: Index, v: Index, V: int) -> Index:
        return np.arange(V)

    pattern, u, v = Pattern([], Values()), np.array([0, 1, 2]), np.array([1, 2, 3])
    first = pattern.elimination(u, v, 4, backward)
    assert pattern.elimination(u.copy(), v.copy(), 4, backward) is first
    assert pattern.hessian(np.arange(0)).elimination is not first  # its order is given: it is not in the way
    assert pattern.elimination(u, v, 4, backward) is first
    for other in ((np.array([0, 1, 1]), v, 4, backward), (u, np.array([1, 2, 0]), 4, backward), (u, v, 5, backward)):
        new = pattern.elimination(*other)
        assert new is not first
        assert (new.u.tolist(), new.v.tolist(), len(new.variables)) == (other[0].tolist(), other[1].tolist(), other[2])
        first = pattern.elimination(u, v, 4, backward)
        assert first.variables.tolist() == [3, 2, 1, 0]
    assert pattern.elimination(u, v, 4, forward).variables.tolist() == [0, 1, 2, 3]


# ---- connected components, against scipy's


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
    assert (connected(none, none, 3).tolist(), connected(none, none, 0).tolist()) == ([0, 1, 2], [])
    assert firsts(np.array([0, 0]), none).tolist() == []


# ---- the size of R, counted before it is computed


def elimination(V: int, row: Index, column: Index, widths: Index) -> list[int]:
    """Rows below every block column by eliminating one after the other."""
    L = np.zeros((V, V), dtype=bool)
    L[row, column] = True
    for j in range(V):
        below = np.flatnonzero(L[:, j])
        for i in below:
            L[below[below > i], i] = True
    return [int(widths[L[:, j]].sum()) for j in range(V)]


def test_rows_below_are_those_of_an_elimination() -> None:
    """Repeated pairs, nodes without any, several components, everything joined to everything."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        V = int(rng.integers(1, 30))
        u, v = rng.integers(0, V, (2, int(rng.integers(0, 3 * V))))
        u, v = u[u != v], v[u != v]
        row, column, widths = np.maximum(u, v), np.minimum(u, v), rng.integers(1, 7, V)
        assert rows_below(widths, row, column).tolist() == elimination(V, row, column, widths), seed


def test_the_count_of_nothing_and_of_a_full_matrix() -> None:
    none = np.zeros(0, dtype=np.intp)
    assert counted(none, none, none, none).nnz == 0
    u, v = np.triu_indices(5, 1)
    full = counted(np.full(5, 3), u, v, np.array([3, 1, 4, 0, 2]))
    assert full.nnz == 15 * 16 // 2
    assert full.flops == sum(k**2 for k in range(1, 16))
