"""Sparse QR of A by SPQR. The one file that imports sparseqr."""

from __future__ import annotations

from functools import cache
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from models.algebra import Array
from nls.linear.base import INSTALL_SUITESPARSE, SINGULAR, LinearSolution, LinearSolver, SingularSystemError
from nls.linear.threads import single_thread

if TYPE_CHECKING:
    from nls.assemble import Pattern
    from nls.system import LinearSystem

__all__ = ["QR"]


@cache
def spqr() -> Any | None:
    """The SPQR binding, or None where it is not installed."""
    try:
        import sparseqr
    except ImportError:
        return None
    return sparseqr


class QR(LinearSolver):
    """A P = Q R by SPQR; R P'dx = Q'b. Slower than Cholesky, with half the digits lost on ill-conditioned systems."""

    name = "qr"

    @classmethod
    def missing(cls) -> str | None:
        return None if spqr() is not None else INSTALL_SUITESPARSE

    def analyze(self, pattern: Pattern) -> None:
        self.require()

    def solve(self, analyzed: None, system: LinearSystem, damping: Array | None = None) -> LinearSolution:
        module = spqr()
        assert module is not None
        t0 = perf_counter()
        A, b = self.damped(system.A, system.b, damping)
        n = A.shape[1]
        lengths = system.column_norms if damping is None else np.sqrt(system.column_norms**2 + damping)
        if n == 0:
            return LinearSolution(np.zeros(0))
        if (lengths == 0).any() or A.shape[0] < n:
            raise SingularSystemError("A has a column of zeros, or fewer rows than columns")
        scaled = sp.coo_matrix(A @ sp.diags_array(1 / lengths))
        t1 = perf_counter()
        with single_thread():
            Z, R, E, _ = module.rz(scaled, b, tolerance=SINGULAR)
        t2 = perf_counter()
        R = sp.csr_array(R)[:n]
        if R.shape[0] < n or (np.abs(R.diagonal()) <= SINGULAR).any():
            raise SingularSystemError("a diagonal entry of R vanishes")
        y = sp.linalg.spsolve_triangular(R, Z[:n, 0], lower=False)
        dx = np.empty(n)
        dx[E] = y
        dx /= lengths
        return LinearSolution(dx, {"assemble": t1 - t0, "factorize": t2 - t1, "solve": perf_counter() - t2})
