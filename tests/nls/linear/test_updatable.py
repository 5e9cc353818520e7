"""Factorizations that take new rows against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from nls.linear.cholesky import cholmod
from nls.linear.factorization import SingularSystemError
from nls.linear.updatable import Refactorized, Updated

both = pytest.mark.parametrize("kind", [Updated, Refactorized] if cholmod() else [Refactorized])


@both
def test_rows_are_added(kind: type[Updated | Refactorized]) -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(12, 8)) * (rng.random((12, 8)) < 0.4) + np.eye(12, 8)
    H = A.T @ A
    factor, g = kind(sp.csc_matrix(np.tril(H))), rng.normal(size=8)
    np.testing.assert_allclose(factor.solve(g), np.linalg.solve(H, g), rtol=1e-9)
    for _ in range(3):
        C = np.zeros((8, 2))
        C[rng.choice(8, 3, replace=False)] = rng.normal(size=(3, 2))
        factor.add(sp.csc_matrix(C))
        H = H + C @ C.T
        np.testing.assert_allclose(factor.solve(g), np.linalg.solve(H, g), rtol=1e-8)


@both
def test_a_dense_matrix_takes_rows_and_is_refused_where_a_pivot_vanishes(kind: type[Updated | Refactorized]) -> None:
    """CHOLMOD factorizes it by supernodes first."""
    rng = np.random.default_rng(1)
    A, C, g = rng.normal(size=(300, 200)), rng.normal(size=(200, 3)), rng.normal(size=200)
    H = A.T @ A
    factor = kind(sp.csc_matrix(np.tril(H)))
    np.testing.assert_allclose(factor.solve(g), np.linalg.solve(H, g), rtol=1e-8)
    factor.add(sp.csc_matrix(C))
    np.testing.assert_allclose(factor.solve(g), np.linalg.solve(H + C @ C.T, g), rtol=1e-8)
    A[:, 150] = A[:, 3]
    with pytest.raises(SingularSystemError):
        kind(sp.csc_matrix(np.tril(A.T @ A)))


@both
def test_what_is_not_positive_definite_is_refused(kind: type[Updated | Refactorized]) -> None:
    for H in (np.zeros((2, 2)), np.array([[1.0, 1.0], [1.0, 1.0]]), np.diag([1.0, -1.0])):
        with pytest.raises(SingularSystemError):
            kind(sp.csc_matrix(np.tril(H)))
