"""The interface of linear solvers: analyze the pattern once, solve every linearization, say when it cannot."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

import numpy as np
from scipy import sparse as sp

from models.abstract import Abstract
from models.algebra import Array
from models.errors import MissingSolverError
from nls.linear.factorization import Factorization
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem

__all__ = ["Analysis", "LinearSolution", "LinearSolver"]

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
