"""The linear solver taken where none is named."""

from __future__ import annotations

from models.errors import OptionError
from nls.linear.base import LinearSolver
from nls.linear.cholesky import Cholesky
from nls.linear.dense import FEW, Small
from nls.linear.factorization import Decomposition, Factorization
from nls.linear.lu import LU
from nls.linear.normal import SparseSolver
from nls.system import LinearSystem

__all__ = ["best_decomposition", "chosen_solver", "default_solver", "factorize", "factorized_by"]


def default_solver(n: int | None = None) -> SparseSolver:
    """The best linear solver installed, for n columns where that is known.

    It is CHOLMOD, or SuperLU without SuiteSparse. Few columns need neither.
    """
    if n is not None and n <= FEW:
        return Small()
    return Cholesky() if Cholesky.missing() is None else LU()


def chosen_solver(linear_solver: LinearSolver | None, n: int) -> LinearSolver:
    """The linear solver, the default for n columns where it is None.

    Raises
    ------
    OptionError
        Something else than a linear solver.
    """
    if linear_solver is None:
        return default_solver(n)
    if not isinstance(linear_solver, LinearSolver):
        raise OptionError("linear_solver", linear_solver, "a linear solver such as nls.QR()")
    return linear_solver


def best_decomposition(n: int | None = None) -> type[Decomposition]:
    """The decomposition of positive definite matrices behind the default solver for n columns."""
    return default_solver(n).decomposition


def factorize(system: LinearSystem, linear_solver: LinearSolver | None = None) -> Factorization:
    """H = A'A of a linearization, factorized: H^-1 g, L, R = L', blocks of H^-1.

    Parameters
    ----------
    system : ``graph.linearize(values)``.
    linear_solver : `Cholesky`, `LU` or `Schur`; the best one installed when omitted, and for a solver that does not
        factorize A'A.

    Raises
    ------
    SingularSystemError
        Something is free.
    EvaluationError
        Squares of weights or Jacobians overflow.
    ResourceLimitError, MissingSolverError

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Between, Isotropic, Prior
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, factorize, kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Prior(x[0], [0, 0, 0], Isotropic(1.0)), Between(x[0], x[1], [1, 0, 0], Isotropic(0.1))])
    >>> system = graph.linearize(Values({x: (SE2, np.zeros((2, 3)))}))
    >>> H = factorize(system)
    >>> H.solve(system.gradient).round(6)
    array([0., 0., 0., 1., 0., 0.])
    >>> R, p = H.upper()
    >>> np.allclose((R.T @ R).toarray(), system.H.toarray()[p][:, p])
    True
    """
    return factorized_by(linear_solver, default_solver(), system)


def factorized_by(linear_solver: LinearSolver | None, default: SparseSolver, system: LinearSystem) -> Factorization:
    """The factorization of a solver, or of the default where there is no solver or it does not factorize A'A."""
    own = None if linear_solver is None else linear_solver.factorization(system)
    return default.factorization(system) if own is None else own
