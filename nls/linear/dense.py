"""Dense solvers by LAPACK: the default for few columns, and some to teach and to compare.

`Small` is Cholesky of A'A as one dense matrix by NumPy: no ordering, and nothing to import. Eleven edges from a file to
their optimum take three quarters of the processor time that CHOLMOD and SciPy's sparse matrices take, because importing
these takes longer than everything else. The others refuse a system larger than the memory allowed.
"""

from __future__ import annotations

from importlib import import_module
from time import perf_counter

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index, Mask
from models.errors import OptionError
from models.options import is_number
from nls.linear.base import Analysis, LinearSolution, LinearSolver, SparseSolver, with_damping
from nls.linear.factorization import ROUNDING, SINGULAR, Decomposition, SingularSystemError
from nls.linear.limits import checked_limit
from nls.sparse.fill import refuse_larger
from nls.sparse.hessian import Hessian
from nls.sparse.pattern import Pattern
from nls.sparse.threads import single_thread
from nls.system import LinearSystem

DENSE_COLUMNS = 150  # columns, up to which NumPy is as fast as CHOLMOD


class _Dense(LinearSolver):
    """A dense solver.

    Parameters
    ----------
    memory_limit : bytes a solve may take; more is refused beforehand. Half of the memory when omitted.
    """

    copies: float  # dense (m, n) arrays alive at once at the peak, as measured in benchmarks/results/pinv.md

    def __init__(self, memory_limit: float | None = None) -> None:
        self.memory_limit = checked_limit(memory_limit)

    def analyze(self, pattern: Pattern) -> DenseAnalysis:
        needed = 8.0 * self.copies * pattern.m * pattern.n
        words = f"linear solver {self.name!r}: a dense {pattern.m} x {pattern.n} system needs"
        refuse_larger(needed, self.memory_limit, "dense system", words, "use a sparse solver")
        return DenseAnalysis(self)

    def least_squares(self, A: Array, b: Array, owner: Index) -> Array:
        """argmin |A dx - b|; `owner` (n,) is the variable of each column."""
        raise NotImplementedError


class DenseAnalysis(Analysis):
    """Nothing is kept between solves.

    Parameters
    ----------
    solver : solves the dense system.
    """

    def __init__(self, solver: _Dense) -> None:
        super().__init__(solver.name)
        self.solver = solver

    def solve(self, system: LinearSystem, damping: Array | None = None) -> LinearSolution:
        import_module("scipy.linalg")  # its BLAS must be there before single_thread looks for it
        t0 = perf_counter()
        sparse, b = with_damping(system.A, system.b, damping)
        A = sparse.toarray()
        t1 = perf_counter()
        with single_thread():
            owner, _ = system.pattern.column_owner()
            dx = self.solver.least_squares(A, b, owner) if A.size else np.zeros(A.shape[1])
        return LinearSolution(dx, {"assemble": t1 - t0, "factorize": perf_counter() - t1})


def _scaled(A: Array) -> tuple[Array, Array]:
    """A with columns of length 1, and their lengths, so that rank does not depend on units."""
    lengths = np.linalg.norm(A, axis=0)
    if (lengths == 0).any() or A.shape[0] < A.shape[1]:
        raise SingularSystemError("A has a column of zeros, or fewer rows than columns")
    return A / lengths, lengths


class DenseQR(_Dense):
    """A = Q R by Householder reflections; R dx = Q'b. Works on A itself, whose condition is the root of A'A's."""

    name = "dense-qr"
    copies = 6.0

    def least_squares(self, A: Array, b: Array, owner: Index) -> Array:
        import scipy.linalg

        scaled, lengths = _scaled(A)
        Q, R = np.linalg.qr(scaled)
        if (np.abs(np.diag(R)) <= SINGULAR).any():
            raise SingularSystemError("a diagonal entry of R vanishes")
        return np.asarray(scipy.linalg.solve_triangular(R, Q.T @ b) / lengths)


class DenseCholesky(_Dense):
    """A'A = L L' as a dense matrix; two triangular solves."""

    name = "dense-cholesky"
    copies = 4.0

    def least_squares(self, A: Array, b: Array, owner: Index) -> Array:
        import scipy.linalg

        scaled, lengths = _scaled(A)
        try:
            L = np.linalg.cholesky(scaled.T @ scaled)
        except np.linalg.LinAlgError as error:
            raise SingularSystemError(str(error)) from error
        if (np.diag(L) ** 2 <= SINGULAR).any():
            raise SingularSystemError("a pivot of A'A vanishes")
        return np.asarray(scipy.linalg.cho_solve((L, True), scaled.T @ b) / lengths)


class Pinv(_Dense):
    r"""dx = pinv(A) b by the singular value decomposition: of all minimizers, the shortest. Never singular.

    .. math:: A D^{-1} = U S V^T, \quad dx = (I - Q Q^T) D^{-1} V_r S_r^{-1} U_r^T b

    D has the lengths of the columns of A, so units do not decide what is free: r are the singular values above `rtol`.
    Q is an orthonormal basis of the other directions, D^-1 V. Along these dx has no part, which makes it the shortest:
    |dx| in meters and radians, as with the gauge ``free``. `Result.underconstrained` names them.

    Parameters
    ----------
    rtol : singular values of A D^-1 below this, relative to the largest, count as zero; 1e-13, where QR refuses. With a
        larger one chi2 is the lowest that the directions which count allow.
    memory_limit : bytes a solve may take; more is refused beforehand. Half of the memory when omitted.
    """

    name = "pinv"
    shortest = True
    copies = 7.0

    def __init__(self, rtol: float = SINGULAR, memory_limit: float | None = None) -> None:
        super().__init__(memory_limit)
        if not is_number(rtol) or not 0 <= rtol < 1:
            raise OptionError("rtol", rtol, "a number of at least 0 and below 1")
        self.rtol: float = float(rtol)

    def least_squares(self, A: Array, b: Array, owner: Index) -> Array:
        U, s, V, kept = self._decomposed(A, owner)
        dx = V[:, kept] @ ((U.T @ b)[kept] / s[kept])
        Q = np.linalg.qr(V[:, ~kept])[0]
        return np.asarray(dx - Q @ (Q.T @ dx))

    def left(self, system: LinearSystem) -> Array:
        *_, V, kept = self._decomposed(system.A.toarray(), system.pattern.column_owner()[0])
        return V[:, ~kept]

    def _decomposed(self, A: Array, owner: Index) -> tuple[Array, Array, Array, Mask]:
        """U, S and D^-1 V, columns (n,) each, and which singular values do not count as zero."""
        lengths, longest = np.linalg.norm(A, axis=0), np.zeros(owner.max() + 1)
        np.maximum.at(longest, owner, lengths)  # a column of rounding errors stays short beside the others
        lengths = np.where(lengths > ROUNDING * longest[owner], lengths, longest[owner])
        lengths[lengths == 0] = 1.0
        U, s, Vt = np.linalg.svd(np.pad(A / lengths, ((0, max(0, A.shape[1] - len(A))), (0, 0))), full_matrices=False)
        return U[: len(A)], s, Vt.T / lengths[:, None], s > self.rtol * s[0]


class Lapack(Decomposition):
    """H = L L' by LAPACK, in the given order; L^-1 is kept."""

    @staticmethod
    def order(u: Index, v: Index, V: int) -> Index:
        return np.arange(V)

    def __init__(self, hessian: Hessian, dtype: type = float) -> None:
        self._hessian = hessian
        self._H: Array = np.zeros((hessian.n, hessian.n), dtype=dtype)
        self._lower = hessian.indices, np.arange(hessian.n).repeat(np.diff(hessian.indptr))

    def factorize(self, S: Array) -> Array:
        self._H[self._lower] = self._hessian.data(S)
        try:
            with single_thread():
                self._L = np.linalg.cholesky(self._H)  # of the lower triangle
                self._inverse = np.linalg.inv(self._L)
        except np.linalg.LinAlgError as error:
            raise SingularSystemError(str(error)) from error
        return np.asarray(np.square(np.diagonal(self._L).real))

    def solve(self, g: Array) -> Array:
        with single_thread():
            return np.asarray(self._inverse.conj().T @ (self._inverse @ g))

    def lower(self) -> tuple[sp.csc_array, Index]:
        return sp.csc_array(self._L), np.arange(self._hessian.n)


class Small(SparseSolver):
    """A'A = L L' as a dense matrix."""

    name = "dense-cholesky"
    decomposition = Lapack
    per_number = 32.0
