r"""A Cholesky factor of A'A that takes new rows, and has room for variables to come.

H = A'A is factorized at one linearization, in an order of little fill, with columns in reserve behind it that have
nothing but a small number on the diagonal. Rows C of new measurements are added by a rank update,

    L L' <- L L' + C'C,

whose cost is that of the columns of L above their variables. Nothing is linearized again: L L' is near H, and as a
preconditioner of conjugate gradients that is enough. Source: T. Davis, W. Hager, "Row modifications of a sparse
Cholesky factorization", SIAM J. Matrix Anal. Appl. 26(3), 2005.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import sparse as sp

from models.algebra import Array
from nls.linear.updatable import updatable_class
from nls.sparse.hessian import Hessian

__all__ = ["Preconditioner"]

WIDEST = 16  # numbers of a variable that is held, at most
RESERVE = 600  # columns for variables to come
SMALL = 1e-6  # on the diagonal of a column in reserve, of the mean of the others


class Preconditioner:
    """A'A, factorized, with room for more.

    Parameters
    ----------
    hessian, S : structure and blocks of A'A.

    Attributes
    ----------
    used : columns that variables have.
    rows : that came later.
    n : columns, with those in reserve.
    width : with those of what is held, behind them.

    Raises
    ------
    SingularSystemError
        Something is free.
    """

    def __init__(self, hessian: Hessian, S: Array) -> None:
        self.used, self.rows, self.n = hessian.n, 0, hessian.n + RESERVE
        self.width = self.n + WIDEST
        small = SMALL * float(hessian.diagonal(S).mean())
        reserve = hessian.n + np.arange(RESERVE, dtype=np.int32)
        indptr = np.concatenate([hessian.indptr, hessian.indptr[-1] + 1 + np.arange(RESERVE, dtype=np.int32)])
        data = np.concatenate([hessian.data(S), np.full(RESERVE, small)])
        H = sp.csc_matrix((data, np.concatenate([hessian.indices, reserve]), indptr), shape=(self.n, self.n))
        self._factor = updatable_class()(H)

    def column(self, d: int) -> int | None:
        """The first of d columns of a new variable; None where no room is left."""
        column, self.used = self.used, self.used + d
        return column if self.used <= self.n else None

    def add(self, A: Array, columns: npt.NDArray[np.int32]) -> None:
        """Add rows of A (k, D), and their columns (k, D)."""
        self.rows += len(A)
        free = columns < self.n
        indptr = np.concatenate([[0], np.cumsum(free.sum(axis=1))])
        self._factor.add(sp.csc_matrix((A[free], columns[free], indptr), shape=(self.n, len(A))))

    def solve(self, g: Array) -> Array:
        """(A'A)^-1 g (width,), nearly; 0 for what is held."""
        x = np.zeros_like(g)
        x[: self.n] = self._factor.solve(g[: self.n])
        return x
