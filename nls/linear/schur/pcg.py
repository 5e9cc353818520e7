r"""Landmarks first, and the graph of poses by conjugate gradients: for bundle problems too large to be factorized.

    S = H_pp - H_pl H_ll^-1 H_lp = H_pp - Y'Y,    Y_lp = X_l H_lp,   X_l'X_l = H_ll^-1      as in `nls.linear.schur`
    S dx_p = g_p - H_pl H_ll^-1 g_l
    M = the diagonal blocks of S

S is never formed: a step of conjugate gradients multiplies by H_pp, Y and Y', whose numbers are as many as those of H.
Only the diagonal blocks of S are, and factorized. They know how much of every pose its landmarks take for themselves,
which those of H_pp do not.

    |S dx_p - g_S|_M <= tol |g_S|_M,    |r|_M^2 = r'M^-1 r     what a step is accepted at

**Free directions.** A pivot of H_ll or M that vanishes is refused as everywhere. But what is free in common, a gauge or
a scale, leaves them alone, and A'b has no part along it. So an undamped system is solved for a second right side first,

    h = L xi,   M = L L',   xi normal, fixed seed;    E[h h'] = M

whose part along any direction v, v'M v = 1, is a normal number of deviation 1. It is solved when all of h has fallen
below `SURE`. Along a free direction no step lowers it: x grows that way, up to 1e16 times what it is elsewhere, until
rounding ends that. So x is the direction to be judged, in the end and where r'M^-1 r has grown by `GROWN`. A itself
tells whether it is free. A direction is overlooked with a probability below `SURE`.

Source: S. Agarwal, N. Snavely, S. Seitz, R. Szeliski, "Bundle adjustment in the large", ECCV 2010, section 4 (implicit
Schur complement and its block-Jacobi preconditioner); J. Mandel, "On block diagonal and Schur complement
preconditioning", 1990.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from models.algebra import Array
from models.options import check_between, check_whole
from nls.linear.base import LinearSolver, NormalAnalysis
from nls.linear.factorization import SINGULAR, Factorization, SingularSystemError, UnsolvedSystemError
from nls.linear.schur.complement import Complement
from nls.linear.schur.solver import SchurDecomposition, independent, together, twins
from nls.sparse.pattern import Pattern
from nls.sparse.threads import single_thread
from nls.system import LinearSystem

SURE = 0.01  # of the deviation of a random right side along any direction: what is left of it where it is solved

Look = Callable[[float, Array], None]


class Iterated(NamedTuple):
    """Where conjugate gradients led.

    Attributes
    ----------
    x : (n,) the solution.
    steps : taken.
    converged : whether it has reached its goal.
    flat : (n,) the direction p it ended with where p'H p was not above 0; None where it did not end so.
    """

    x: Array
    steps: int
    converged: bool
    flat: Array | None = None


def conjugate(
    times: Callable[[Array], Array],
    preconditioned: Callable[[Array], Array],
    r: Array,
    goal: Callable[[float], float],
    max_steps: int,
    look: Look | None = None,
) -> Iterated:
    """Solve H x = r in passes over H and its preconditioner M.

        z = M^-1 r,   p = z + beta p,   alpha = r'z / p'H p,   x = x + alpha p,   r = r - alpha H p

    In every step r'M^-1 r = r'z is known; it is over when that has fallen to its goal. Source: M. Hestenes, E. Stiefel,
    "Methods of conjugate gradients for solving linear systems", 1952; Y. Saad, Iterative Methods for Sparse Linear
    Systems, 2003, section 9.2.

    Parameters
    ----------
    times, preconditioned : H and M^-1 times an array (n,).
    r : (n,) right side.
    goal : from r'M^-1 r at the start, at which r'M^-1 r it is there.
    max_steps : not more.
    look : called in every step with r'M^-1 r and x (n,); may raise.

    Examples
    --------
    >>> import numpy as np
    >>> H = np.array([[4.0, 1.0], [1.0, 3.0]])
    >>> found = conjugate(lambda p: H @ p, lambda r: r, np.array([1.0, 2.0]), lambda first: 1e-20 * first, 9)
    >>> found.steps, found.converged, (H @ found.x).round(6).tolist()
    (2, True, [1.0, 2.0])
    """
    x, p, rz, least = np.zeros_like(r), np.zeros_like(r), 1.0, 0.0
    for step in range(max_steps + 1):
        z = preconditioned(r)
        before, rz = rz, np.einsum("n,n->", r, z)
        if step == 0:
            least = goal(rz)
        if rz <= least:  # what is not a number is not there
            return Iterated(x, step, True)
        if step == max_steps:
            return Iterated(x, step, False)
        if look is not None:
            look(rz, x)
        p = z + (rz / before if step else 0.0) * p
        Hp = times(p)
        curvature = np.einsum("n,n->", p, Hp)
        if not curvature > 0:
            return Iterated(x, step + 1, False, p)
        alpha = rz / curvature
        x += alpha * p
        r = r - alpha * Hp
    raise AssertionError


GROWN = 1e4  # times r'M^-1 r at the start, and then times what it was when A was asked last: a free direction, perhaps


class PCGDecomposition(SchurDecomposition):
    """H whose first columns are eliminated block by block; the others are solved for by conjugate gradients.

    Parameters
    ----------
    complement : the diagonal blocks of S, their structure.
    tol, max_steps : as in `PCG`.

    Attributes
    ----------
    steps : of conjugate gradients so far.
    """

    def __init__(self, complement: Complement, tol: float, max_steps: int) -> None:
        super().__init__(complement, exact=True)
        self._tol, self._max_steps, self.steps = tol, max_steps, 0

    def _reduced(self, g: Array) -> Array:
        if g.ndim == 2:
            return np.stack([self._reduced(column) for column in g.T], axis=1)
        solution = self._conjugate(g, lambda first: self._tol**2 * first)
        self._require(solution)
        return solution.x

    def refuse_free(self, free: Callable[[Array], bool]) -> None:
        """Look for a free direction of S.

        Parameters
        ----------
        free : whether a step (n,) of all unknowns, in the order of the `Hessian`, changes no measurement.

        Raises
        ------
        SingularSystemError
        """
        L, order = self._decomposition.lower()
        h, next_look = np.empty(len(order)), 0.0
        h[order] = L @ np.random.default_rng(0).normal(size=len(order))

        def look(rz: float, x: Array) -> None:
            nonlocal next_look
            if rz > next_look:
                judge(x)
                next_look = GROWN * rz

        def judge(x_p: Array) -> None:
            if free(self._followed(x_p)):
                raise SingularSystemError("conjugate gradients met a direction that no measurement determines")

        solution = self._conjugate(h, lambda _: SURE**2, look)
        for x_p in (solution.x, solution.flat):
            if x_p is not None:
                judge(x_p)
        self._require(solution, ", while looking for free directions")

    def _followed(self, x_p: Array) -> Array:
        """[-H_ll^-1 H_lp x_p; x_p]: where the least chi2 is for a step x_p of what is not eliminated."""
        n = self._complement.n
        x = np.concatenate([np.zeros(n), x_p])
        x[:n] = -self._blockwise([X.mT for X in self._roots], self._L.T @ x)
        return x

    def _conjugate(self, g: Array, goal: Callable[[float], float], look: Look | None = None) -> Iterated:
        n, transposed, upper = self._complement.n, self._L.T, self._H_pp.T
        diagonal = self._H_pp.diagonal()
        padded = np.zeros(n + len(g))

        def times(p: Array) -> Array:
            padded[n:] = p
            return np.asarray(self._H_pp @ p + upper @ p - diagonal * p - (self._L @ (transposed @ padded))[n:])

        with single_thread():
            solution = conjugate(times, self._decomposition.solve, g, goal, self._max_steps, look)
        self.steps += solution.steps
        return solution

    def _require(self, solution: Iterated, context: str = "") -> None:
        if solution.flat is not None:
            raise UnsolvedSystemError(
                f"conjugate gradients met a direction whose curvature is lost in rounding in step "
                f"{solution.steps}{context}; take linear solver 'schur' or 'cholesky'"
            )
        if not solution.converged:
            raise UnsolvedSystemError(
                f"conjugate gradients did not reach tol = {self._tol:g} in {solution.steps} steps{context}; allow more "
                "with max_steps, or take linear solver 'schur' or 'cholesky'"
            )


class PCGFactorization(Factorization):
    """H, whose free directions conjugate gradients have to look for."""

    decomposition: PCGDecomposition

    def refuse_free(self, system: LinearSystem) -> None:
        super().refuse_free(system)
        order, norms = self.hessian.permutation, system.column_norms

        def free(x: Array) -> bool:
            dx = np.empty_like(x)
            dx[order] = x
            return bool(np.square(system.times(dx)).sum() < SINGULAR * np.square(norms * dx).sum())

        self.decomposition.refuse_free(free)


class PCGAnalysis(NormalAnalysis):
    """H, its first columns eliminated block by block, and conjugate gradients for the others.

    Parameters
    ----------
    factorization : of H.
    eliminated : which variables, in words.
    """

    factorization: PCGFactorization

    def __init__(self, factorization: PCGFactorization, eliminated: str) -> None:
        super().__init__(PCG.name, factorization)
        self._eliminated = eliminated

    @property
    def description(self) -> str:
        """Name, what is eliminated, and the steps of conjugate gradients since `analyze`, in words."""
        steps = self.factorization.decomposition.steps
        return f"{self.name}, {self._eliminated}, {steps:,} CG step{'' if steps == 1 else 's'}"

    def again(self, system: LinearSystem) -> None:
        return None  # H was not factorized


class PCG(LinearSolver):
    """A'A dx = A'b by conjugate gradients on the Schur complement of the landmarks, preconditioned with its diagonal.

    For the largest bundle problems: memory is that of A'A. The variables that are eliminated are those of `Schur`.

    Parameters
    ----------
    tol : of a step, |S dx - g| <= tol |g| in the norm of the preconditioner; above 0 and below 1. Above 1e-6 the solver
        counts as inexact. Its steps are good for Levenberg-Marquardt far from the optimum, convergence is doubted where
        the measurements still pull, and there are no covariances.
    max_steps : of conjugate gradients in a solve. One that does not reach `tol` is no step: Levenberg-Marquardt damps
        more, an undamped method ends with the error.

    Raises
    ------
    OptionError
        An option that is not possible.

    Notes
    -----
    Every undamped solve looks for free directions first, which takes about half as many steps again. `Marginals` takes
    the best factorization installed, as for every solver that keeps none.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Between, Isotropic, Landmark, Prior
    >>> from models import R, SE2
    >>> from nls import PCG, FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([Prior(x[0], [0, 0, 0], Isotropic(1)), Between(x[0], x[1], [1, 0, 0], Isotropic(0.1))])
    >>> seen = graph.add(Landmark(x[[0, 1, 0, 1]], l[[0, 0, 1, 1]], [[2, 1], [1, 1], [3, 1], [2, 1]], Isotropic(0.1)))
    >>> start = Values({x: (SE2, np.zeros((2, 3))), l: (R(2), np.zeros((2, 2)))})
    >>> result = graph.optimize(start, linear_solver=PCG())
    >>> result.linear_solver.split(", ")[:2], result.values[l].round(6).tolist()
    (['pcg', 'l eliminated: 4 of 10 columns'], [[2.0, 1.0], [3.0, 1.0]])
    """

    name = "pcg"

    def __init__(self, tol: float = 1e-10, max_steps: int = 2000) -> None:
        self.tol = check_between("tol", tol, 0, 1, "a number above 0 and below 1")
        self.max_steps = check_whole("max_steps", max_steps, 1, "a whole number above 0")
        self.exact = self.tol <= 1e-6  # a larger tolerance is an inexact solver

    def analyze(self, pattern: Pattern) -> PCGAnalysis:
        blocks = pattern.blocks
        gone, eliminated = independent(pattern, blocks)
        first, group = np.flatnonzero(gone), twins(pattern, blocks, gone)
        survivors = together(np.flatnonzero(~gone), group)
        order = np.concatenate([first[np.argsort(blocks.dims[first], kind="stable")], survivors])
        hessian = pattern.hessian(order)
        complement = Complement(hessian, len(first), group[survivors], diagonal=True)
        decomposition = PCGDecomposition(complement, self.tol, self.max_steps)
        return PCGAnalysis(PCGFactorization(hessian, decomposition), eliminated)

    def __repr__(self) -> str:
        return f"PCG(tol={self.tol:g}, max_steps={self.max_steps})"
