"""Solving the normal equations A'A dx = A'b by a sparse factorization of H = A'A."""

from __future__ import annotations

from abc import abstractmethod
from time import perf_counter
from typing import ClassVar

import numpy as np
from scipy import sparse as sp

from models.algebra import Array
from models.errors import EvaluationError
from nls.linear.base import Analysis, LinearSolution, LinearSolver
from nls.linear.factorization import Decomposition, Factorization
from nls.linear.limits import checked_limit, refuse_above
from nls.linear.singular import SingularSystemError
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem

__all__ = ["NormalAnalysis", "NormalEquations", "SparseSolver"]


FADED = 0.5  # of a diagonal entry of A'A: an unknown less is known about wants a step that the old one is too stiff for


class NormalAnalysis(Analysis):
    """The structure of A'A, and the factorization of the latest linearization.

    Parameters
    ----------
    name : of the solver.
    factorization : of the structure; its numbers change with every linearization.
    """

    def __init__(self, name: str, factorization: Factorization) -> None:
        super().__init__(name)
        self.factorization = factorization

    def factorize(self, system: LinearSystem, damping: Array | None = None) -> Factorization:
        """H = A'A, with the damping on its diagonal, factorized; free directions are refused where there is none.

        Raises
        ------
        EvaluationError
            Squares of weights or Jacobians overflow; names the measurement.
        SingularSystemError
            A is rank deficient.
        """
        S, hessian = system.H_blocks, self.factorization.hessian
        if damping is not None:
            S = S.copy()
            hessian.damp(S, damping)
        try:
            self.factorization.factorize(S)
        except EvaluationError as error:
            raise system.overflow() from error
        if damping is None:
            self.factorization.refuse_free(system)
        return self.factorization

    def solve(self, system: LinearSystem, damping: Array | None = None) -> LinearSolution:
        t0 = perf_counter()
        with np.errstate(over="ignore", invalid="ignore"):  # an overflow is refused by name
            _, gradient = system.H_blocks, system.gradient
        t1 = perf_counter()
        self.factorize(system, damping)
        t2 = perf_counter()
        dx = self.factorization.solve(gradient)
        if not np.isfinite(dx.sum()):
            raise SingularSystemError("the solution of the normal equations is not finite")
        return LinearSolution(dx, {"assemble": t1 - t0, "factorize": t2 - t1, "solve": perf_counter() - t2})

    def again(self, system: LinearSystem) -> LinearSolution | None:
        started = perf_counter()
        if (np.square(system.column_norms) < FADED * self.factorization.diagonal).any():
            return None
        dx = self.factorization.solve(system.gradient)
        return LinearSolution(dx, {"solve": perf_counter() - started})

    def columns(self, system: LinearSystem, B: sp.csr_array) -> Array:
        return self.factorization.solve((system.A.T @ B).toarray())


class NormalEquations(LinearSolver):
    """A solver by factorization of A'A.

    Parameters
    ----------
    memory_limit : bytes a solve may take; more is refused beforehand. Half of the memory when omitted,
        `nls.linear.limits`.
    """

    per_number: ClassVar[float]  # bytes at the peak per number of R, measured: nls.linear.limits

    def __init__(self, memory_limit: float | None = None) -> None:
        self.memory_limit = checked_limit(memory_limit)

    @abstractmethod
    def analyze(self, pattern: Pattern) -> NormalAnalysis:
        """Ordering and symbolic factorization.

        Raises
        ------
        MissingSolverError
        ResourceLimitError
            R would take more than the limit.
        """

    def factorization(self, system: LinearSystem) -> Factorization:
        return self.analyze(system.pattern).factorize(system)


class SparseSolver(NormalEquations):
    """All of A'A by one decomposition, which subclasses name."""

    decomposition: ClassVar[type[Decomposition]]

    def analyze(self, pattern: Pattern) -> NormalAnalysis:
        return NormalAnalysis(self.name, self.prepared(pattern))

    def prepared(self, pattern: Pattern) -> Factorization:
        """The structure of A'A, to be factorized; errors as for `analyze`."""
        self.require()
        hessian = pattern.hessian(self.decomposition.order)
        refuse_above(self.memory_limit, self.per_number, hessian, self.name)
        return Factorization(hessian, self.decomposition(hessian))
