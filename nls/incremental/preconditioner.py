r"""A Cholesky factor of A'A that takes new rows, and has room for variables to come.

H = A'A is factorized at one linearization, in an order of little fill, with columns in reserve behind it that have
nothing but a small number on the diagonal. Rows C of new measurements are added by a rank update,

    L L' <- L L' + C'C,

whose cost is that of the columns of L above their variables. Nothing is linearized again: L L' is near H, and as a
preconditioner of conjugate gradients that is enough. Source: T. Davis, W. Hager, "Row modifications of a sparse
Cholesky factorization", SIAM J. Matrix Anal. Appl. 26(3), 2005.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from models.algebra import Array, Index
from nls.linear.cholesky import Updatable
from nls.sparse.hessian import Hessian

__all__ = ["Preconditioner", "stacked"]

RESERVE = 600  # columns for variables to come
SMALL = 1e-6  # on the diagonal of a column in reserve, of the mean of the others


class Preconditioner:
    """A'A, factorized, with room for more.

    Parameters
    ----------
    hessian, S : structure and blocks of A'A.

    Attributes
    ----------
    n : columns, with those in reserve.

    Raises
    ------
    SingularSystemError
        Something is free.
    """

    def __init__(self, hessian: Hessian, S: Array) -> None:
        self._used, self.n = hessian.n, hessian.n + RESERVE
        small = SMALL * float(hessian.diagonal(S).mean())
        reserve = hessian.n + np.arange(RESERVE, dtype=np.int32)
        indptr = np.concatenate([hessian.indptr, hessian.indptr[-1] + 1 + np.arange(RESERVE, dtype=np.int32)])
        data = np.concatenate([hessian.data(S), np.full(RESERVE, small)])
        H = sp.csc_matrix((data, np.concatenate([hessian.indices, reserve]), indptr), shape=(self.n, self.n))
        self._factor = Updatable(H)

    def column(self, d: int) -> int | None:
        """The first of d columns of a new variable; None where no room is left."""
        column, self._used = self._used, self._used + d
        return column if self._used <= self.n else None

    def add(self, C: sp.csc_matrix) -> None:
        """Add rows of A, the columns of C (n, k)."""
        self._factor.add(C)

    def solve(self, g: Array) -> Array:
        """(A'A)^-1 g (n,), nearly."""
        return self._factor.solve(g)


def stacked(blocks: Sequence[tuple[list[tuple[Index, Array]], int]], columns: int) -> sp.csc_matrix:
    """Rows of A as the columns of a sparse matrix C', from the blocks of several batches."""
    data, indices, counts = [], [], []
    for slots, _ in blocks:
        place = [np.where(first[:, None] < 0, -1, first[:, None] + np.arange(A.shape[2])) for first, A in slots]
        index = np.concatenate(place, axis=1)  # (k, D)
        order = np.argsort(index, axis=1, kind="stable")
        index = np.take_along_axis(index, order, axis=1)
        A = np.concatenate([A for _, A in slots], axis=2)  # (k, m, D)
        A = np.take_along_axis(A, np.broadcast_to(order[:, None], A.shape), axis=2)
        every = np.broadcast_to(index[:, None], A.shape)
        free = every >= 0
        data.append(A[free])
        indices.append(every[free])
        counts.append(free.sum(axis=2).reshape(-1))
    indptr = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
    return sp.csc_matrix((np.concatenate(data), np.concatenate(indices).astype(np.int32), indptr.astype(np.int32)), shape=(columns, len(indptr) - 1))
