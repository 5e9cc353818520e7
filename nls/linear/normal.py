"""Solving the normal equations A'A dx = A'b by a sparse factorization of H = A'A."""

from __future__ import annotations

from abc import abstractmethod
from time import perf_counter
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import scipy.sparse as sp

from models.abstract import Abstract
from models.algebra import Array
from models.errors import EvaluationError
from nls.hessian import Blocks, Hessian
from nls.linear.base import NULL, SINGULAR, WEAK, LinearSolution, LinearSolver, SingularSystemError
from nls.linear.limits import checked_limit, default_limit, refuse_above

if TYPE_CHECKING:
    from nls.assemble import Pattern
    from nls.elimination import Index
    from nls.system import LinearSystem

__all__ = ["Assembled", "Factorization", "NormalEquations", "NormalState"]


FADED = 0.5  # of a diagonal entry of A'A: an unknown less is known about wants a step that the old one is too stiff for


class Factorization(Abstract):
    """A sparse factorization of a positive definite matrix whose structure is fixed."""

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
        """Solution of H x = g for g (n,) or (n, k), in the order of the `Hessian`."""

    @abstractmethod
    def lower(self) -> tuple[sp.csc_array, Index]:
        """Sparse lower triangular L and its order p, with H[p][:, p] = L L', H in the order of the `Hessian`."""

    def upper(self) -> tuple[sp.csc_array, Index]:
        """Sparse upper triangular R = L' and its order p, with H[p][:, p] = R'R, H in the order of the `Hessian`."""
        L, p = self.lower()
        return sp.csc_array(L.T), p


class NormalState:
    """A symmetric structure and its factorization.

    Parameters
    ----------
    hessian : the structure.
    kind : the factorization to use.
    dtype : of the numbers, float or complex.
    """

    _latest: tuple[LinearSystem, Array] | None = None

    def __init__(self, hessian: Hessian, kind: type[Factorization], dtype: type = float) -> None:
        self.hessian = hessian
        self.factorization = kind(hessian, dtype)
        self._judged: Array | float = np.inf  # pivots, as parts of the diagonal, when they were looked at last

    def filled(self, blocks: Blocks, system: LinearSystem) -> Array:
        """Flat blocks of A'A, to be changed; those of the latest system are kept for the next damping of it."""
        if self._latest is None or self._latest[0] is not system:
            self._latest = system, blocks.fill(system)
        return self._latest[1].copy()

    def solve(self, g: Array) -> Array:
        """H^-1 g with rows in the order of the columns of A."""
        x = np.empty_like(g)
        x[self.hessian.permutation] = self.factorization.solve(g[self.hessian.permutation])
        return x

    def lower(self) -> tuple[sp.csc_array, Index]:
        """L and p with H[p][:, p] = L L', H = A'A with the columns in the order of A."""
        L, p = self.factorization.lower()
        return L, self.hessian.permutation[p]

    def upper(self) -> tuple[sp.csc_array, Index]:
        """R and p with H[p][:, p] = R'R, H = A'A with the columns in the order of A."""
        R, p = self.factorization.upper()
        return R, self.hessian.permutation[p]

    def factorize(self, S: Array) -> Array:
        """Factorize H from its flat blocks; returns the diagonal of H, in its order.

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
                raise EvaluationError(
                    "the squares of weights or Jacobians overflow in A'A; check sigmas and units", where="A'A"
                )
            raise SingularSystemError("A'A is not finite")
        pivots = self.factorization.factorize(S)
        if not (pivots > SINGULAR * diagonal).all():
            raise SingularSystemError("a pivot of A'A vanishes")
        self._kept, self.diagonal = pivots / np.where(diagonal > 0, diagonal, 1.0), diagonal
        return diagonal

    def refuse_free(self, system: LinearSystem) -> None:
        """Look for a free direction that rounding has hidden from the pivots of the latest factorization.

        A'A squares the condition of A: a pivot that ought to be 0 may come out as large as 1e-9 of its diagonal entry
        where another one is small. Inverse iteration, three solves, finds the direction, and A itself, which keeps
        twice the digits, tells whether it is free. A later linearization is looked at where a pivot has halved since.

        Raises
        ------
        SingularSystemError
        """
        weak = self._kept < WEAK
        if not (weak & (self._kept < 0.5 * self._judged)).any():
            return
        D = 1 / np.where(system.column_norms > 0, system.column_norms, 1.0)
        v = np.random.default_rng(0).normal(size=len(D))
        for _ in range(3):
            v = self.solve(v / D) / D
            v /= np.linalg.norm(v)
        if np.linalg.norm(system.times(D * v)) <= NULL:
            raise SingularSystemError("A'A has a null direction that its pivots do not show")
        self._judged = self._kept


class Assembled(LinearSolver):
    """A solver that fills A'A and A'b from the blocks; what is done with A'A is a matter of the state."""

    def solve(
        self, analyzed: tuple[Blocks, NormalState], system: LinearSystem, damping: Array | None = None
    ) -> LinearSolution:
        blocks, state = analyzed
        t0 = perf_counter()
        with np.errstate(over="ignore", invalid="ignore"):  # an overflow is refused by name in factorize
            S = state.filled(blocks, system)
            gradient = system.gradient
        if damping is not None:
            state.hessian.damp(S, damping)
        t1 = perf_counter()
        try:
            diagonal = state.factorize(S)
        except EvaluationError as error:
            raise system.overflow() from error
        if damping is None:
            squared_norms = np.empty_like(gradient)
            squared_norms[state.hessian.permutation] = diagonal
            system.column_norms = np.sqrt(squared_norms)  # known now; the stop rule asks for them
            state.refuse_free(system)
        t2 = perf_counter()
        dx = state.solve(gradient)
        if not np.isfinite(dx.sum()):
            raise SingularSystemError("the solution of the normal equations is not finite")
        return LinearSolution(dx, {"assemble": t1 - t0, "factorize": t2 - t1, "solve": perf_counter() - t2})


class NormalEquations(Assembled):
    """A solver by factorization of A'A; subclasses name the factorization.

    Parameters
    ----------
    memory_limit : bytes a solve may take; more is refused beforehand. Half of the memory when omitted,
        `nls.linear.limits`.
    """

    factorization: ClassVar[type[Factorization]]
    per_number: ClassVar[float]  # bytes at the peak per number of R, measured: nls.linear.limits

    def __init__(self, memory_limit: float | None = None) -> None:
        self.memory_limit = checked_limit(memory_limit)

    def analyze(self, pattern: Pattern) -> tuple[Blocks, NormalState]:
        """Ordering and symbolic factorization.

        Raises
        ------
        MissingSolverError
        ResourceLimitError
            R would take more than the limit.
        """
        self.require()
        blocks = Blocks(pattern)
        hessian = blocks.structure(self.factorization.order)
        refuse_above(self.memory_limit or default_limit(), self.per_number, blocks, hessian, self.name)
        return blocks, NormalState(hessian, self.factorization)

    def again(self, analyzed: tuple[Blocks, NormalState], system: LinearSystem) -> LinearSolution | None:
        started, (_, state) = perf_counter(), analyzed
        if (np.square(system.column_norms)[state.hessian.permutation] < FADED * state.diagonal).any():
            return None
        dx = state.solve(system.gradient)
        return LinearSolution(dx, {"solve": perf_counter() - started})
