"""The interface of linear solvers: analyze the pattern once, solve every linearization, say when it cannot.

`NormalEquations` are the solvers of A'A dx = A'b by a sparse factorization of H = A'A.
"""

from __future__ import annotations

from abc import abstractmethod
from time import perf_counter
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import sparse as sp

from models.abstract import Abstract
from models.algebra import Array
from models.errors import EvaluationError, MissingSolverError
from nls.linear.factorization import Decomposition, Factorization, SingularSystemError
from nls.linear.limits import checked_limit, refuse_above
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem

INSTALL_SUITESPARSE = (
    'missing; pip install "leadline[cholmod]", which needs SuiteSparse: apt-get install libsuitesparse-dev '
    "libopenblas0, dnf install suitesparse-devel, or brew install suite-sparse; CHOLMOD alone: conda install -c "
    'conda-forge "scikit-sparse<0.5"'
)


class LinearSolution(NamedTuple):
    """dx = argmin |A dx - b|, and the seconds spent on assembling, factorizing and solving."""

    dx: Array
    seconds: dict[str, float]


class Analysis(Abstract):
    """The analysis of a pattern, which solves every linearization of it.

    Parameters
    ----------
    name : of the solver.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    @abstractmethod
    def solve(self, system: LinearSystem, damping: Array | None = None) -> LinearSolution:
        """The step dx = argmin |A dx - b|^2 + sum damping_k dx_k^2.

        Parameters
        ----------
        system : one linearization.
        damping : (n,) not negative, added to the diagonal of A'A; none for the Gauss-Newton step.

        Raises
        ------
        SingularSystemError
            A is rank deficient.
        """

    def again(self, system: LinearSystem) -> LinearSolution | None:
        """H^-1 A'b of this system, with H as the latest undamped `solve` factorized it.

        None where nothing is kept, or where that H is known to be of no use any more.

        Near an optimum, where H hardly changes, that is the Gauss-Newton step but for a few percent, for the price of
        two triangular solves.
        """
        return None

    def columns(self, system: LinearSystem, B: sp.csr_array) -> Array:
        """pinv(A) B for B (m, k), after `solve` of this system."""
        sides = [LinearSystem(system.pattern, system.blocks, b) for b in B.toarray().T]
        return np.stack([self.solve(side).dx for side in sides], axis=1)

    @property
    def description(self) -> str:
        """The solver in the result, with what there is to tell."""
        return self.name


class LinearSolver(Abstract):
    """Base of the linear solvers. Solvers hold settings only; `analyze` returns what they know of a pattern.

    Attributes
    ----------
    name : the name on the command line and in results.
    exact : whether its steps are the minimizer, up to rounding or a tolerance. One that says no gives no covariances,
        and its steps prove convergence only where the measurements do not pull otherwise.
    shortest : whether it takes the shortest step where something is free, instead of refusing.
    """

    name: str
    exact: bool = True
    shortest: bool = False

    @classmethod
    def missing(cls) -> str | None:
        """Package that this solver needs; None when it can."""
        return None

    def require(self) -> None:
        """Refuse when a package is missing.

        Raises
        ------
        MissingSolverError
        """
        if (problem := self.missing()) is not None:
            raise MissingSolverError(f"linear solver {self.name!r}: {problem}")

    @abstractmethod
    def analyze(self, pattern: Pattern) -> Analysis:
        """Everything that depends on the pattern alone: ordering, symbolic factorization. Once per graph."""

    def factorization(self, system: LinearSystem) -> Factorization | None:
        """A'A of a linearization, factorized; None of a solver that does not factorize it."""
        return None

    def left(self, system: LinearSystem) -> Array | None:
        """Directions (n, k) along which a `shortest` step leaves the unknowns alone; None of a solver that refuses."""
        return None

    def held_system(self, system: LinearSystem) -> LinearSystem:
        """The system whose singularity `solve` reports: the one given, unless the solver holds something itself."""
        return system

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"


def with_damping(A: sp.csr_array, b: Array, damping: Array | None) -> tuple[sp.csr_array, Array]:
    """A and b with the damping as further rows: the same step for solvers that work on A itself."""
    if damping is None:
        return A, b
    rows = sp.diags_array(np.sqrt(damping))
    return sp.csr_array(sp.vstack([A, rows])), np.concatenate([b, np.zeros(len(damping))])


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
        # an unknown that less than half is known about wants a step that the old H is too stiff for
        if (np.square(system.column_norms) < 0.5 * self.factorization.diagonal).any():
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
