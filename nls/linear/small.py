"""Cholesky of A'A as one dense matrix by NumPy, the default for few columns: no ordering, and nothing to import.

Eleven edges from a file to their optimum take three quarters of the processor time that CHOLMOD and SciPy's sparse
matrices take, because importing these takes longer than everything else.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index
from nls.linear.factorization import Decomposition
from nls.linear.normal import SparseSolver
from nls.linear.singular import SingularSystemError
from nls.sparse.hessian import Hessian
from nls.sparse.threads import single_thread

__all__ = ["FEW", "Dense", "Small"]

FEW = 150  # columns, up to which NumPy is as fast as CHOLMOD


class Dense(Decomposition):
    """H = L L' by LAPACK, in the given order; L^-1 is kept."""

    @staticmethod
    def order(u: Index, v: Index, V: int) -> Index:
        return np.arange(V)

    def __init__(self, hessian: Hessian, dtype: type = float) -> None:
        self._hessian = hessian
        self._H: Array = np.zeros((hessian.n, hessian.n), dtype=dtype)
        self._lower = hessian.indices, np.arange(hessian.n).repeat(np.diff(hessian.indptr))

    def factorize(self, S: Array) -> Array:
        self._H[self._lower] = self._hessian.data(S)
        try:
            with single_thread():
                self._L = np.linalg.cholesky(self._H)  # of the lower triangle
                self._inverse = np.linalg.inv(self._L)
        except np.linalg.LinAlgError as error:
            raise SingularSystemError(str(error)) from error
        return np.asarray(np.square(np.diagonal(self._L).real))

    def solve(self, g: Array) -> Array:
        with single_thread():
            return np.asarray(self._inverse.conj().T @ (self._inverse @ g))

    def lower(self) -> tuple[sp.csc_array, Index]:
        return sp.csc_array(self._L), np.arange(self._hessian.n)


class Small(SparseSolver):
    """A'A = L L' as a dense matrix."""

    name = "cholesky"
    decomposition = Dense
    per_number = 32.0
