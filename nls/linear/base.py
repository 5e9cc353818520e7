"""What a linear solver is: analyze the pattern once, solve every linearization, say when it cannot."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy.sparse as sp

from models.abstract import Abstract
from models.algebra import Array
from models.errors import MissingSolverError

if TYPE_CHECKING:
    from nls.assemble import Pattern
    from nls.system import LinearSystem

__all__ = [
    "INSTALL_SUITESPARSE",
    "NULL",
    "SINGULAR",
    "WEAK",
    "LinearSolution",
    "LinearSolver",
    "SingularSystemError",
    "UnsolvedSystemError",
]

SINGULAR = 1e-13
"""A pivot below this, relative to the diagonal entry it came from (so whatever the units), is rounding: 13 of the 16
digits of the column were cancelled by the columns before it, and the direction counts as free."""


WEAK, NULL = 1e-6, 1e-9
"""Where the smallest pivot, relative to its diagonal entry, is below WEAK, rounding may hide a free direction; it is
one when |A v| is below NULL for a vector v of length 1, the columns of A scaled to length 1."""


INSTALL_SUITESPARSE = "missing; apt-get install libsuitesparse-dev libopenblas0, then pip install leadline[cholmod]"


class SingularSystemError(np.linalg.LinAlgError):
    """The system has no unique solution; optimizers turn this into `UnderconstrainedError` with names."""


class UnsolvedSystemError(SingularSystemError):
    """An iteration did not reach its tolerance: too near to singular for it, or given too few steps."""


@dataclass(frozen=True)
class LinearSolution:
    """dx = argmin |A dx - b|, and the seconds spent on assembling, factorizing and solving."""

    dx: Array
    seconds: dict[str, float] = field(default_factory=dict)


class LinearSolver(Abstract):
    """Base of the linear solvers. Solvers hold settings only; `analyze` returns the state.

    Attributes
    ----------
    name : the name on the command line and in results.
    exact : whether its steps are the minimizer, up to rounding or a tolerance. One that says no gives no covariances,
        and its steps prove convergence only where the measurements do not pull otherwise.
    """

    name: ClassVar[str]
    exact: bool = True

    @classmethod
    def missing(cls) -> str | None:
        """What has to be installed before this solver runs; None when it can."""
        return None

    def require(self) -> None:
        """Refuse when a package is missing.

        Raises
        ------
        MissingSolverError
        """
        if (what := self.missing()) is not None:
            raise MissingSolverError(f"linear solver {self.name!r}: {what}")

    @abstractmethod
    def analyze(self, pattern: Pattern) -> Any:
        """What depends on the pattern alone: ordering, symbolic factorization. Once per graph."""

    @abstractmethod
    def solve(self, analyzed: Any, system: LinearSystem, damping: Array | None = None) -> LinearSolution:
        """The step dx = argmin |A dx - b|^2 + sum damping_k dx_k^2.

        Parameters
        ----------
        analyzed : what `analyze` returned.
        system : one linearization.
        damping : (n,) not negative, added to the diagonal of A'A; none for the Gauss-Newton step.

        Raises
        ------
        SingularSystemError
            A is rank deficient.
        """

    def again(self, analyzed: Any, system: LinearSystem) -> LinearSolution | None:
        """H^-1 A'b of this system, with H as the latest undamped `solve` factorized it.

        None where nothing is kept, or where that H is known to be of no use any more.

        Near an optimum, where H hardly changes, that is the Gauss-Newton step but for a few percent, for the price of
        two triangular solves.
        """
        return None

    def said(self, analyzed: Any) -> str:
        """The solver in the result, with what its state has to tell."""
        return self.name

    @staticmethod
    def damped(A: sp.csr_array, b: Array, damping: Array | None) -> tuple[sp.csr_array, Array]:
        """A and b with the damping as further rows: the same step for solvers that work on A itself."""
        if damping is None:
            return A, b
        rows = sp.diags_array(np.sqrt(damping))
        return sp.csr_array(sp.vstack([A, rows])), np.concatenate([b, np.zeros(len(damping))])

    def seen(self, system: LinearSystem) -> LinearSystem:
        """The system whose singularity `solve` reports: the one given, unless the solver holds something itself."""
        return system

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"
