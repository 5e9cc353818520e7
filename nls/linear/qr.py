"""Sparse QR of A by SPQR. The one file that imports sparseqr."""

from __future__ import annotations

from functools import cache
from threading import Lock
from time import perf_counter
from typing import Any

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index
from nls.linear.base import INSTALL_SUITESPARSE, Analysis, LinearSolution, LinearSolver, with_damping
from nls.linear.default import best_decomposition
from nls.linear.factorization import SINGULAR, Factorization, SingularSystemError
from nls.linear.limits import always_fits, checked_limit, refuse_above
from nls.sparse.pattern import Pattern
from nls.sparse.threads import single_thread
from nls.system import LinearSystem

# sparseqr keeps one CHOLMOD workspace for the process and lets other Python threads run meanwhile: two of them inside
# at once end the process.
ONE_AT_A_TIME = Lock()


@cache
def spqr() -> Any | None:
    """The SPQR binding, or None where it is not installed."""
    try:
        import sparseqr
    except ImportError:
        return None
    return sparseqr


class QR(LinearSolver):
    """A P = Q R by SPQR; R P'dx = Q'b. Slower than Cholesky, with half the digits lost on ill-conditioned systems.

    Parameters
    ----------
    memory_limit : bytes a solve may take; more is refused beforehand. Half of the memory when omitted,
        `nls.linear.limits`.
    """

    name = "qr"
    per_number = 88.0  # bytes at the peak per number of R, measured: nls.linear.limits

    def __init__(self, memory_limit: float | None = None) -> None:
        self.memory_limit = checked_limit(memory_limit)

    @classmethod
    def missing(cls) -> str | None:
        return None if spqr() is not None else INSTALL_SUITESPARSE

    def analyze(self, pattern: Pattern) -> QRAnalysis:
        """Nothing but the estimate of memory, for the elimination order of the default solver.

        Raises
        ------
        MissingSolverError
        ResourceLimitError
            R would take more than the limit.
        """
        self.require()
        if not always_fits(self.memory_limit, self.per_number, pattern.n):
            refuse_above(self.memory_limit, self.per_number, pattern.hessian(best_decomposition().order), self.name)
        return QRAnalysis(self.name)

    def factorization(self, system: LinearSystem) -> Factorization:
        self.analyze(system.pattern)
        return OrthogonalFactor(system)


class OrthogonalFactor(Factorization):
    """R of A P = Q R in place of the Cholesky factor of P'A'A P, so that no digit is lost to squares.

    Parameters
    ----------
    system : one linearization.

    Raises
    ------
    SingularSystemError
        A is rank deficient.
    """

    def __init__(self, system: LinearSystem) -> None:
        decomposition = best_decomposition(system.pattern.n)
        hessian = system.pattern.hessian(decomposition.order)
        super().__init__(hessian, decomposition(hessian))
        p, lengths = hessian.permutation, system.column_norms
        # SPQR's order 0: the columns stay as they are
        _, R, _ = _decomposed(system.A[:, p], np.zeros(system.pattern.m), lengths[p], 0)
        self._R = sp.csr_array(sp.diags_array(np.sign(R.diagonal())) @ R @ sp.diags_array(lengths[p]))
        self._L = sp.csr_array(self._R.T)

    def solve(self, g: Array) -> Array:
        from scipy.sparse.linalg import spsolve_triangular

        x, p = np.empty_like(g), self.hessian.permutation
        x[p] = spsolve_triangular(self._R, spsolve_triangular(self._L, g[p]), lower=False)
        return x

    def lower(self) -> tuple[sp.csc_array, Index]:
        return sp.csc_array(self._R.T), self.hessian.permutation


def _decomposed(A: sp.csr_array, b: Array, lengths: Array, order: int | None) -> tuple[Array, sp.csr_array, Index]:
    """Q'b, R and the column order of A with columns of length 1."""
    module, n = spqr(), A.shape[1]
    assert module is not None
    if (lengths == 0).any() or A.shape[0] < n:
        raise SingularSystemError("A has a column of zeros, or fewer rows than columns")
    with single_thread(), ONE_AT_A_TIME:
        Z, R, E, _ = module.rz(sp.coo_matrix(A @ sp.diags_array(1 / lengths)), b, SINGULAR, order)
    R = sp.csr_array(R)[:n]
    if R.shape[0] < n or (np.abs(R.diagonal()) <= SINGULAR).any():
        raise SingularSystemError("a diagonal entry of R vanishes")
    return Z[:n, 0], R, E


class QRAnalysis(Analysis):
    """Nothing is kept between solves."""

    def solve(self, system: LinearSystem, damping: Array | None = None) -> LinearSolution:
        from scipy.sparse.linalg import spsolve_triangular

        t0 = perf_counter()
        A, b = with_damping(system.A, system.b, damping)
        n = A.shape[1]
        lengths = system.column_norms if damping is None else np.sqrt(system.column_norms**2 + damping)
        if n == 0:
            return LinearSolution(np.zeros(0), {})
        t1 = perf_counter()
        z, R, E = _decomposed(A, b, lengths, None)
        t2 = perf_counter()
        dx = np.empty(n)
        dx[E] = spsolve_triangular(R, z, lower=False)
        dx /= lengths
        return LinearSolution(dx, {"assemble": t1 - t0, "factorize": t2 - t1, "solve": perf_counter() - t2})
