"""Matrices of blocks on a graph, such as its Laplacian: one elimination order for blocks of every size."""

from __future__ import annotations

import numpy as np

from models.algebra import Array, Index
from nls.linear.default import best_decomposition
from nls.linear.factorization import Factorization
from nls.sparse.elimination import Eliminations
from nls.sparse.hessian import Hessian

__all__ = ["Laplacian"]

LARGEST = 3  # columns of a node in a start, at most


class Laplacian:
    """Symmetric matrices of blocks (k, k) at V nodes and at P pairs of them; all sizes k have one elimination order.

    Parameters
    ----------
    u, v : (P,) the pairs, repeats allowed: their blocks add up.
    V : the number of nodes.
    eliminations : structure kept by others, such as `Pattern.eliminations`; None for a new one.
    """

    def __init__(self, u: Index, v: Index, V: int, eliminations: Eliminations | None = None) -> None:
        self._decomposition = best_decomposition(LARGEST * V)
        self._elimination = (eliminations or Eliminations()).of(u, v, V, self._decomposition.order)
        self._factorizations: dict[int, Factorization] = {}

    def factorized(self, on_diagonal: Array, off: Array) -> Factorization:
        """Factorization of the matrix of diagonal blocks (V, k, k) and blocks (u, v) (P, k, k); (v, u) are adjoint.

        All matrices of one k are real, or all complex. Raises SingularSystemError where one is not positive definite.
        """
        S, V, k = np.concatenate([on_diagonal, off]), len(on_diagonal), off.shape[-1]
        if np.iscomplexobj(S):  # a `Hessian` transposes these blocks
            np.conjugate(S[V:], out=S[V:], where=self._elimination.turned[:, None, None])
        if k not in self._factorizations:
            begin = np.arange(len(S)) * k * k
            hessian = Hessian(self._elimination, np.full(V, k), begin[:V], begin[V:])
            self._factorizations[k] = Factorization(hessian, self._decomposition(hessian, S.dtype.type))
        return self._factorizations[k].factorize(S.reshape(-1))
