"""The linear solver taken where none is named, and what it factorizes: A'A, and matrices of blocks on a graph."""

import numpy as np

from models.algebra import Array, Index
from models.errors import OptionError
from nls.linear.base import LinearSolver, SparseSolver
from nls.linear.cholesky import Cholesky
from nls.linear.dense import DENSE_COLUMNS, Small
from nls.linear.factorization import Decomposition, Factorization
from nls.linear.lu import LU
from nls.sparse.hessian import Hessian
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem


def default_solver(n: int | None = None) -> SparseSolver:
    """The best linear solver installed, for n columns where that is known.

    It is CHOLMOD, or SuperLU without SuiteSparse. Few columns need neither.
    """
    if n is not None and n <= DENSE_COLUMNS:
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


class Laplacian:
    """Symmetric matrices of blocks (k, k) at V nodes and at P pairs of them; all sizes k have one elimination order.

    Parameters
    ----------
    u, v : (P,) the pairs, repeats allowed: their blocks add up.
    V : the number of nodes.
    pattern : of the factor graph, which keeps the elimination for others.
    """

    def __init__(self, u: Index, v: Index, V: int, pattern: Pattern) -> None:
        self._decomposition = best_decomposition(3 * V)  # at most 3 columns a node in a start
        self._elimination = pattern.elimination(u, v, V, self._decomposition.order)
        self._factorizations: dict[int, Factorization] = {}

    def factorized(self, on_diagonal: Array, off: Array) -> Factorization:
        """Factorization of the matrix of diagonal blocks (V, k, k) and blocks (u, v) (P, k, k); (v, u) are adjoint.

        All matrices of one k are real, or all complex. Raises SingularSystemError where one is not positive definite.
        """
        S, V, k = np.concatenate([on_diagonal, off]), len(on_diagonal), off.shape[-1]
        if np.iscomplexobj(S):  # a `Hessian` transposes these blocks
            np.conjugate(S[V:], out=S[V:], where=self._elimination.turned[:, None, None])
        if k not in self._factorizations:
            begin = np.arange(len(S)) * k * k
            hessian = Hessian(self._elimination, np.full(V, k), begin[:V], begin[V:])
            self._factorizations[k] = Factorization(hessian, self._decomposition(hessian, S.dtype.type))
        return self._factorizations[k].factorize(S.reshape(-1))
