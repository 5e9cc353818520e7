"""Sparse Cholesky by CHOLMOD. The one file that imports scikit-sparse.

Measured choices (SuiteSparse 5.12, OpenBLAS, two cores):

- AMD orders the graph of *variables*, one node per pose, and the matrix is handed over already in that order. This has
  the fill of scalar AMD at half the time.
- METIS (nested dissection) orders again where more than `AMD_PAIRS` pairs of variables share a factor. AMD's order must
  cost more than `COSTLY` flops a pair, a variable taken as one column. The order of fewer flops is taken. 10^9 flops of
  a factorization, AMD -> METIS, simulated: city of 100,000 edges 10.1 -> 4.4, of a million 548 -> 166; sphere of
  100,000 116 -> 36; filled cube of 100,000 3555 -> 392. Per 100,000 edges METIS takes 0.2 - 0.6 s, AMD 0.02 - 0.12,
  counting flops 0.07 - 0.15. So smaller graphs (city10000 has 20,687 pairs) are not even counted. A CHOLMOD built
  without METIS answers a request for it with AMD's order: then that one stays.
- CHOLMOD chooses itself between columns one by one and supernodes (dense blocks), at 40 flops per number of R. With its
  threads kept in check supernodes are faster on every graph measured. kitti_00 takes 3 ms against 12, city10000 63
  against 92, sphere2500 65 against 398.
- One thread: see `nls.sparse.threads`.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index
from nls.linear.base import INSTALL_SUITESPARSE, SparseSolver
from nls.linear.factorization import Decomposition, SingularSystemError
from nls.sparse.fill import counted
from nls.sparse.hessian import Hessian
from nls.sparse.threads import single_thread

AMD_PAIRS = 30_000  # pairs of variables; up to here the order is AMD's, and nothing is counted
COSTLY = 2000.0  # flops a pair; below, METIS takes longer than it saves


@cache
def cholmod() -> Any:
    """The CHOLMOD binding, or None where it is not installed."""
    try:
        import sksparse.cholmod as module
    except ImportError:
        return None
    return module if hasattr(module, "analyze") and hasattr(module.Factor, "cholesky_inplace") else None


def _order(graph: sp.csc_matrix, method: str) -> Index:
    """Elimination order by a method of CHOLMOD, in postorder."""
    return np.asarray(cholmod().analyze(graph, mode="simplicial", ordering_method=method).P(), dtype=np.intp)


class Cholmod(Decomposition):
    """P H P' = L L' or L D L' of a `Hessian` by CHOLMOD."""

    @staticmethod
    def order(u: Index, v: Index, V: int) -> Index:
        """Approximate minimum degree of the graph of variables; METIS where that is large and METIS's costs less."""
        ends = np.arange(V + 1) + np.searchsorted(v, np.arange(V + 1))  # every column: its diagonal, then its pairs
        rows = np.empty(V + len(u), dtype=np.int32)
        rows[ends[:-1]] = np.arange(V)
        rows[np.arange(len(u)) + v + 1] = u
        graph = sp.csc_matrix((np.ones(len(rows)), rows, ends.astype(np.int32)), shape=(V, V))
        amd = _order(graph, "amd")
        if len(u) <= AMD_PAIRS:
            return amd
        unit_dims = np.ones(V, dtype=np.intp)
        flops = counted(unit_dims, u, v, amd).flops
        if flops <= COSTLY * len(u):
            return amd
        metis = _order(graph, "metis")
        return metis if counted(unit_dims, u, v, metis).flops < flops else amd

    def __init__(self, hessian: Hessian, dtype: type = float) -> None:
        self._module, self._hessian, self._factorized = cholmod(), hessian, False
        self._H = hessian.matrix(np.ones(len(hessian.indices), dtype=dtype))
        if dtype not in hessian.analyses:
            hessian.analyses[dtype] = self._module.analyze(self._H, mode="auto", ordering_method="natural")
        self._chol = hessian.analyses[dtype].copy()

    def __getstate__(self) -> tuple[Hessian, Array, bool]:
        return self._hessian, self._H.data, self._factorized

    def __setstate__(self, state: tuple[Hessian, Array, bool]) -> None:
        """Factorize the same numbers again: CHOLMOD's factor itself does not leave the process."""
        Cholesky().require()
        hessian, data, factorized = state
        self.__init__(hessian, data.dtype.type)  # type: ignore[misc]
        self._H.data[:] = data
        if factorized:
            self._factorize()

    def factorize(self, S: Array) -> Array:
        self._hessian.data(S, out=self._H.data)
        self._factorize()
        return np.asarray(self._chol.D().real)

    def _factorize(self) -> None:
        try:
            with single_thread():
                self._chol.cholesky_inplace(self._H)
        except self._module.CholmodNotPositiveDefiniteError as error:
            self._factorized = False
            raise SingularSystemError(str(error)) from error
        self._factorized = True

    def solve(self, g: Array) -> Array:
        with single_thread():
            return np.asarray(self._chol.solve_A(g))

    def lower(self) -> tuple[sp.csc_array, Index]:
        return sp.csc_array(self._chol.L()), np.arange(self._hessian.n)


class Cholesky(SparseSolver):
    """A'A = L L' by CHOLMOD: the fastest for sparse systems, and the default where it is installed."""

    name = "cholesky"
    decomposition = Cholmod
    per_number = 17.0

    @classmethod
    def missing(cls) -> str | None:
        return None if cholmod() is not None else INSTALL_SUITESPARSE
