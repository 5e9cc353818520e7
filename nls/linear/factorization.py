"""A block-sparse symmetric matrix H, factorized: solve, L, R, blocks of the inverse; and when it counts as singular."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from scipy import sparse as sp

from models.abstract import Abstract
from models.algebra import Array, Index
from models.errors import EvaluationError
from nls.sparse.hessian import Hessian
from nls.sparse.quadratic_forms import quadratic_forms
from nls.sparse.takahashi import Supernodes, inverse_blocks, supernodes
from nls.system import LinearSystem

SINGULAR = 1e-13
"""A pivot below this, relative to the diagonal entry it came from (so whatever the units), is rounding: 13 of the 16
digits of the column were cancelled by the columns before it, and the direction counts as free."""


ROUNDING = 1e-14  # of the longest column of the variable: a column this short is zero

WEAK, NULL = 1e-6, 1e-9
"""Where the smallest pivot, relative to its diagonal entry, is below WEAK, rounding may hide a free direction; it is
one when |A v| is below NULL for a vector v of length 1, the columns of A scaled to length 1."""

GOLDEN = (5**0.5 - 1) / 2  # fractions of its multiples spread evenly: a start of iterations in no direction


class SingularSystemError(np.linalg.LinAlgError):
    """The system has no unique solution; optimizers turn this into `UnderconstrainedError` with names."""


class UnsolvedSystemError(SingularSystemError):
    """An iteration did not reach its tolerance: too near to singular for it, or given too few steps."""


def refuse_vanishing(pivots: Array, diagonal: Array) -> None:
    """Refuse pivots (n,) that are rounding beside the diagonal entries (n,) they came from.

    Raises
    ------
    SingularSystemError
        One of them is.
    """
    if not (pivots > SINGULAR * diagonal).all():
        raise SingularSystemError("a pivot of A'A vanishes")


class Decomposition(Abstract):
    """H = L L' by one program, for a positive definite H of fixed structure, columns in the order of the `Hessian`."""

    @staticmethod
    @abstractmethod
    def order(u: Index, v: Index, V: int) -> Index:
        """Elimination order (V,) of V variables with the given pairs: each once, u > v, by rising v and then u."""

    @abstractmethod
    def __init__(self, hessian: Hessian, dtype: type = float) -> None: ...

    @abstractmethod
    def factorize(self, S: Array) -> Array:
        """Factorize from the flat blocks; returns the squared pivots (n,), or raises SingularSystemError."""

    @abstractmethod
    def solve(self, g: Array) -> Array:
        """Solution of H x = g for g (n,) or (n, k)."""

    @abstractmethod
    def lower(self) -> tuple[sp.csc_array, Index]:
        """Sparse lower triangular L and its order p, with H[p][:, p] = L L'."""


class Factorization:
    """H, factorized; rows and columns in the order in which its variables were given.

    Parameters
    ----------
    hessian : the structure.
    decomposition : what factorizes it.

    Attributes
    ----------
    diagonal : (n,) of the latest H.
    """

    diagonal: Array

    def __init__(self, hessian: Hessian, decomposition: Decomposition) -> None:
        self.hessian, self.decomposition = hessian, decomposition
        self._supernodes: Supernodes | None = None  # the structure of L, for `inverse_blocks`
        self._judged: Array | float = np.inf  # pivots, as parts of the diagonal, when they were looked at last

    def factorize(self, S: Array) -> Factorization:
        """Factorize H from its flat blocks.

        Raises
        ------
        EvaluationError
            The diagonal, sums of squares, has overflowed.
        SingularSystemError
            H is rank deficient.
        """
        diagonal = self.hessian.diagonal(S)
        if not np.isfinite(diagonal).all():
            if np.isinf(diagonal).any():
                why = "the squares of weights or Jacobians overflow in A'A; check sigmas and units"
                raise EvaluationError(why, where="A'A")
            raise SingularSystemError("A'A is not finite")
        pivots = self.decomposition.factorize(S)
        refuse_vanishing(pivots, diagonal)
        self._pivots = pivots / np.where(diagonal > 0, diagonal, 1.0)
        self.diagonal = np.empty_like(diagonal)
        self.diagonal[self.hessian.permutation] = diagonal
        return self

    def solve(self, g: Array) -> Array:
        """H^-1 g for g (n,) or (n, k)."""
        x = np.empty_like(g)
        x[self.hessian.permutation] = self.decomposition.solve(g[self.hessian.permutation])
        return x

    def lower(self) -> tuple[sp.csc_array, Index]:
        """Sparse lower triangular L and an order p, with H[p][:, p] = L L'."""
        L, p = self.decomposition.lower()
        return L, self.hessian.permutation[p]

    def upper(self) -> tuple[sp.csc_array, Index]:
        """Sparse upper triangular R = L' and its order p, with H[p][:, p] = R'R."""
        L, p = self.lower()
        return sp.csc_array(L.T), p

    def inverse_blocks(self, i: Index, j: Index, memory_limit: float) -> Array:
        """Blocks (i, j) of H^-1, (d_i, d_j) row by row, one after the other.

        Parameters
        ----------
        i, j : (k,) free variables, by their number among these; any two that share a factor, or one twice.
        memory_limit : bytes the dense fronts may take.

        Raises
        ------
        ResourceLimitError
            They would take more.
        """
        return inverse_blocks(*self._fronts(), self.hessian.dims, i, j, memory_limit) if len(i) else np.zeros(0)

    def quadratic_forms(self, U: sp.csc_array, d: int) -> Array:
        """U_k' H^-1 U_k (g, d, d) of g sparse matrices of d columns, side by side in U (n, g d)."""
        return quadratic_forms(*self._fronts(), U, d) if U.nnz else np.zeros((U.shape[1] // d, d, d))

    def _fronts(self) -> tuple[Supernodes, sp.csc_array, Index]:
        """The supernodes of L, and L with its order p."""
        L, p = self.lower()
        L.eliminate_zeros()  # CHOLMOD pads its supernodes
        if self._supernodes is None:
            self._supernodes = supernodes(self.hessian, p)
        return self._supernodes, L, p

    def refuse_free(self, system: LinearSystem) -> None:
        """Look for a free direction that rounding has hidden from the pivots of the latest factorization.

        A'A squares the condition of A. A pivot that ought to be 0 may come out as large as 1e-9 of its diagonal entry
        where another one is small. Inverse iteration, three solves, finds the direction, and A itself, which keeps
        twice the digits, tells whether it is free. A later linearization is looked at where a pivot has halved since.

        Raises
        ------
        SingularSystemError
        """
        weak = self._pivots < WEAK
        if not (weak & (self._pivots < 0.5 * self._judged)).any():
            return
        D = 1 / np.where(system.column_norms > 0, system.column_norms, 1.0)
        v = np.arange(len(D)) * GOLDEN
        v -= np.floor(v) + 0.5
        for _ in range(3):
            v = self.solve(v / D) / D
            v /= np.linalg.norm(v)
        if np.linalg.norm(system.times(D * v)) <= NULL:
            raise SingularSystemError("A'A has a null direction that its pivots do not show")
        self._judged = self._pivots
