r"""Factorizations that take new rows, and one of A'A that has room for variables to come.

New rows come by CHOLMOD's rank updates. Where CHOLMOD is missing SuperLU makes the factorization anew.

H = A'A is factorized at one linearization, in an order of little fill, with columns in reserve behind it that have
nothing but a small number on the diagonal. Rows C of new measurements are added by a rank update,

    L L' <- L L' + C'C,

whose cost is that of the columns of L above their variables. Nothing is linearized again: L L' is near H, and as a
preconditioner of conjugate gradients that is enough. Source: T. Davis, W. Hager, "Row modifications of a sparse
Cholesky factorization", SIAM J. Matrix Anal. Appl. 26(3), 2005.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse as sp

from models.algebra import Array
from nls.linear.cholesky import cholmod
from nls.linear.factorization import SingularSystemError, refuse_vanishing
from nls.linear.lu import factored
from nls.sparse.hessian import Hessian
from nls.sparse.threads import single_thread

RESERVE, GROWTH = 200, 16  # columns for variables to come: 200, or one for 16 that are there if that is more
SMALL = 3  # numbers of variables whose columns are few enough to be factorized one by one
Parts = tuple[Array, npt.NDArray[np.int32], npt.NDArray[np.int32]]  # numbers of a sparse matrix, their rows, begins


class Updated:
    """H = L D L' by CHOLMOD; new rows change the columns of L above their variables: H <- H + C C'.

    CHOLMOD makes columns of supernodes when the first rows come, and their zeros stay in L. A solution of city10000
    then takes 0.49 ms instead of 0.39. A factorization of sphere2500 takes 11 ms by supernodes, and 50 by columns.

    Source: T. Davis, W. Hager, "Dynamic supernodes in sparse Cholesky update/downdate and triangular solves", ACM TOMS
    35(4), 2009.

    Parameters
    ----------
    H : lower triangle of a positive definite matrix (n, n), in the order of elimination.
    by_columns : whether to factorize without supernodes; when omitted, CHOLMOD chooses.

    Raises
    ------
    SingularSystemError
        H is not positive definite.
    """

    name = "rank updates (CHOLMOD)"

    def __init__(self, H: sp.csc_matrix, by_columns: bool = False) -> None:
        module = cholmod()
        self._chol = module.analyze(H, ordering_method="natural", mode="simplicial" if by_columns else "auto")
        try:
            self._chol.cholesky_inplace(H)
        except module.CholmodNotPositiveDefiniteError as error:
            raise SingularSystemError(str(error)) from error
        refuse_vanishing(self._chol.D(), H.diagonal())  # the natural order: that of H

    def add(self, C: sp.csc_matrix) -> None:
        """H <- H + C C', C (n, k)."""
        self._chol.update_inplace(C)

    def solve(self, g: Array) -> Array:
        """H^-1 g (n,)."""
        return np.asarray(self._chol.solve_A(g))


class Refactorized:
    """H = L U by SciPy's SuperLU, made anew for new rows; otherwise as `Updated`."""

    name = "a new factorization for new rows (SuperLU)"

    def __init__(self, H: sp.csc_matrix, by_columns: bool = False) -> None:
        self._H = sp.csc_matrix(H + sp.tril(H, -1).T)
        self._factorize()

    def _factorize(self) -> None:
        self._lu = factored(self._H)
        refuse_vanishing(self._lu.U.diagonal()[self._lu.perm_c], self._H.diagonal())

    def add(self, C: sp.csc_matrix) -> None:
        self._H = sp.csc_matrix(self._H + C @ C.T)
        self._factorize()

    def solve(self, g: Array) -> Array:
        return np.asarray(self._lu.solve(g))


def updatable_class() -> type[Updated] | type[Refactorized]:
    """The best one installed."""
    return Refactorized if cholmod() is None else Updated


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
        more = max(RESERVE, hessian.n // GROWTH)
        self.used, self.rows, self.n = hessian.n, 0, hessian.n + more
        self.width = self.n + 16  # numbers of a variable that is held, at most
        small = 1e-6 * float(hessian.diagonal(S).mean())  # in reserve
        reserve = hessian.n + np.arange(more, dtype=np.int32)
        indptr = np.concatenate([hessian.indptr, hessian.indptr[-1] + 1 + np.arange(more, dtype=np.int32)])
        data = np.concatenate([hessian.data(S), np.full(more, small)])
        self._begun = data, np.concatenate([hessian.indices, reserve]), indptr
        self._added: list[Parts] = []
        self._by_columns = bool((hessian.dims <= SMALL).all())
        self._begin()

    def __getstate__(self) -> dict[str, Any]:
        """All that the factorization was made of: equal steps make it equal to the bit."""
        return {name: value for name, value in vars(self).items() if name != "_factor"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        with single_thread():
            self._begin()

    def _begin(self) -> None:
        """Factorize, and enter the rows that were added."""
        self._factor = updatable_class()(sp.csc_matrix(self._begun, shape=(self.n, self.n)), self._by_columns)
        for rows in self._added:
            self._enter(rows)

    def _enter(self, rows: Parts) -> None:
        self._factor.add(sp.csc_matrix(rows, shape=(self.n, len(rows[2]) - 1)))

    def column(self, d: int) -> int | None:
        """The first of d columns of a new variable; None where no room is left."""
        column, self.used = self.used, self.used + d
        return column if self.used <= self.n else None

    def add(self, A: Array, columns: npt.NDArray[np.int32]) -> None:
        """Add rows of A (k, D), and their columns (k, D)."""
        if not len(A):
            return
        self.rows += len(A)
        free = columns < self.n
        indptr = np.concatenate([[0], np.cumsum(free.sum(axis=1))]).astype(np.int32)
        self._added.append((A[free], columns[free], indptr))
        self._enter(self._added[-1])

    def solve(self, g: Array) -> Array:
        """(A'A)^-1 g (width,), nearly; 0 for what is held."""
        x = np.zeros_like(g)
        x[: self.n] = self._factor.solve(g[: self.n])
        return x
