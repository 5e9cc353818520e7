"""Blocks of the selected inverse against those of the dense one, in either order of a pair."""

from __future__ import annotations

import numpy as np

from nls.covariance.selected import SelectedInverse
from nls.linear.default import factorize
from tests.nls.graphs import mixed


def test_blocks_against_the_dense_inverse() -> None:
    sample = mixed(0)
    system = sample.graph.linearize(sample.values)
    factorization = factorize(system, None)
    selected, hessian = SelectedInverse(factorization, 4e9), factorization.hessian
    inverse, dims = np.linalg.inv((system.A.T @ system.A).toarray()), hessian.dims
    first, u, v = np.cumsum(dims) - dims, hessian.elimination.u, hessian.elimination.v
    kinds = {(int(dims[i]), int(dims[j])) for i, j in zip(u, v, strict=True)}
    assert len(kinds) > 1
    for d, e in kinds:
        same = (dims[u] == d) & (dims[v] == e)
        orders = [(u[same], v[same]), (v[same], u[same])]
        if d == e:  # both orders at once
            orders.append((np.append(u[same], v[same]), np.append(v[same], u[same])))
        for i, j in orders:
            rows, columns = (first[k][:, None] + np.arange(dims[k[0]]) for k in (i, j))
            np.testing.assert_allclose(
                selected.blocks(i, j, len(rows[0]), len(columns[0])),
                inverse[rows[..., None], columns[:, None]],
                atol=1e-9,
            )


def test_pairs_without_a_block() -> None:
    system = mixed(0).graph.linearize(mixed(0).values)
    factorization = factorize(system, None)
    u, v, V = factorization.hessian.elimination.u, factorization.hessian.elimination.v, len(factorization.hessian.dims)
    i, j = np.triu_indices(V, 1)
    linked = np.isin(i * V + j, np.minimum(u, v) * V + np.maximum(u, v))
    selected = SelectedInverse(factorization, 4e9)
    assert np.array_equal(selected.lacks(i, j), ~linked)
    assert np.array_equal(selected.lacks(j, i), ~linked)
    assert not selected.lacks(i, i).any()
