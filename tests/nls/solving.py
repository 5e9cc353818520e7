"""What the tests of linear solvers share: a solver or a factorization, skipped where it is not installed; closeness."""

from __future__ import annotations

import numpy as np
import pytest

from models.algebra import Array
from nls import LinearSystem
from nls.linear import SOLVERS, LinearSolver
from nls.linear.cholesky import Cholmod
from nls.linear.dense import Lapack
from nls.linear.factorization import NULL, Decomposition, Factorization
from nls.linear.lu import SuperLU
from nls.linear.null_space import weakest

DECOMPOSITIONS: tuple[type[Decomposition], ...] = (Cholmod, SuperLU, Lapack)


def make(name: str) -> LinearSolver:
    solver = SOLVERS[name]()
    if (why := solver.missing()) is not None:
        pytest.skip(f"{name}: {why}")
    return solver


def factorized(kind: type[Decomposition], system: LinearSystem) -> Factorization:
    if kind is Cholmod:
        make("cholesky")
    hessian = system.pattern.hessian(kind.order)
    return Factorization(hessian, kind(hessian)).factorize(system.H_blocks)


def near(found: Array, expected: Array, tolerance: float) -> None:
    """Equal to a part of the largest number."""
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max(initial=1e-300))


def dense_step(system: LinearSystem, damping: Array | None = None) -> Array:
    """(A'A + diag(damping))^-1 A'b."""
    A, b = system.A.toarray(), system.b
    if damping is None:
        return np.asarray(np.linalg.lstsq(A, b)[0])
    return np.asarray(np.linalg.solve(A.T @ A + np.diag(damping), A.T @ b))


def null_space(system: LinearSystem) -> Array:
    """Free directions (n, k), whatever the weights."""
    s, N = weakest(system.balanced)
    return N[:, s <= NULL]
