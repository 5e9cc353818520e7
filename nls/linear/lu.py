"""Sparse LU of A'A by SciPy's SuperLU: needs nothing but SciPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index
from nls.linear.base import SparseSolver
from nls.linear.factorization import Decomposition, SingularSystemError
from nls.sparse.hessian import Hessian


def dominant(u: Index, v: Index, V: int) -> sp.csc_array:
    """Diagonally dominant (V, V) matrix with the pattern of a graph of variables: in its factors nothing cancels."""
    i, j = np.concatenate([u, v]), np.concatenate([v, u])
    adjacency = sp.coo_array((np.full(len(i), -1.0), (i, j)), shape=(V, V))
    return sp.csc_array(adjacency + sp.diags_array(1.0 - adjacency.sum(axis=0)))


def factored(H: sp.csc_array | sp.csc_matrix, order: str = "NATURAL") -> Any:
    """SuperLU's factors of a symmetric matrix, with symmetric pivoting.

    Columns are not merged into wider ones beforehand (``relax``), which is 25 times slower on 20,000 poses: the order
    given is no postorder, so SuperLU merges columns that have little in common.

    Raises
    ------
    SingularSystemError
        A pivot is exactly zero.
    """
    from scipy.sparse.linalg import splu

    try:
        return splu(H, permc_spec=order, diag_pivot_thresh=0.0, relax=1, options={"SymmetricMode": True})
    except RuntimeError as error:  # SuperLU's way to say it
        raise SingularSystemError(str(error)) from error


class SuperLU(Decomposition):
    """H = L U with symmetric pivoting. SuperLU's minimum degree orders the graph of variables, once per graph."""

    @staticmethod
    def order(u: Index, v: Index, V: int) -> Index:
        return np.argsort(factored(dominant(u, v, V), "MMD_AT_PLUS_A").perm_c)

    _H: sp.csc_array | None = None  # the matrix of the latest factors

    def __init__(self, hessian: Hessian, dtype: type = float) -> None:
        self._hessian = hessian

    def __getstate__(self) -> tuple[Hessian, sp.csc_array | None]:
        return self._hessian, self._H

    def __setstate__(self, state: tuple[Hessian, sp.csc_array | None]) -> None:
        """Factorize the same numbers again: SuperLU's factors do not leave the process."""
        self._hessian, H = state
        if H is not None:
            self._factorize(H)

    def factorize(self, S: Array) -> Array:
        self._factorize(self._hessian.symmetric(S))
        return np.asarray(self._lu.U.diagonal()[self._lu.perm_c].real)

    def _factorize(self, H: sp.csc_array) -> None:
        self._H = None
        self._lu = factored(H)
        self._H = H

    def solve(self, g: Array) -> Array:
        return np.asarray(self._lu.solve(g))

    def lower(self) -> tuple[sp.csc_array, Index]:
        lu = self._lu  # symmetric pivoting: L of ones on the diagonal, U = D L'
        return sp.csc_array(lu.L @ sp.diags_array(np.sqrt(lu.U.diagonal()))), np.argsort(lu.perm_c)


class LU(SparseSolver):
    """A'A = L U by SciPy's SuperLU: the default where SuiteSparse is not installed."""

    name = "lu"
    decomposition = SuperLU
    per_number = 144.0
