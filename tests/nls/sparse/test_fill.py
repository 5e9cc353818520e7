"""The size of R, counted before it is computed, against an elimination column after column."""

from __future__ import annotations

import numpy as np

from models.algebra import Index
from nls.sparse.fill import counted, rows_below


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
