r"""Conjugate gradients on the current normal equations, preconditioned with an old factorization.

    H dx = g,   H = A'A + diag(damping),   g = A'b        at the current linearization
    M = L L'    an earlier H, factorized by CHOLMOD

    |H dx - g|_M <= tol |g|_M,    |r|_M^2 = r' M^-1 r     what a step is accepted at

The first linearization is factorized, as `Cholesky` does. Each later one is solved by conjugate gradients, which are
given as many steps as cost a factorization; where these will not do, H is factorized anew and takes the place of M. So
dx always solves the equations of the current linearization: M decides how fast, never what. r'M^-1 r is at hand in
every step; the r of the recursion and the true one differed by at most 1e-9 |g|_M in the steps accepted on the data
sets measured.

**Free directions.** The pivots of a factorization show that H is singular; conjugate gradients do not, because A'b has
no part along a v with A v = 0. So a second right side, h, is solved for beside g in the same passes over L and H:

    h = A_0'eta + diag(sqrt(damping_0)) xi,    eta, xi normal, fixed seed;    E[h h'] = M

Its part along any direction v, v'M v = 1, is a normal number of deviation 1, and along a free one no step lowers it.
A step dx is accepted when all of h has fallen below `SURE`. The Lanczos process that comes with it must show no
direction in which H is below `SOFT` times M. Otherwise H is factorized and judged by its pivots like everywhere.
Guarantee: a first linearization is judged as by `Cholesky`; later, a direction that has become free is overlooked with
a probability below `SURE`.

Source: M. Hestenes, E. Stiefel, "Methods of conjugate gradients for solving linear systems", 1952; Y. Saad, Iterative
Methods for Sparse Linear Systems, 2003, sections 6.7.3 (Lanczos coefficients) and 9.2.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index
from models.listing import several
from nls.linear.base import LinearSolution
from nls.linear.cholesky import Cholesky
from nls.linear.conjugate import SURE, checked_settings, conjugate
from nls.linear.factorization import Factorization
from nls.linear.normal import NormalAnalysis
from nls.sparse.pattern import Pattern
from nls.sparse.threads import single_thread
from nls.system import LinearSystem

__all__ = ["CholeskyPCG", "KeptFactorization"]

SOFT = 1e-3  # part of M that H keeps in every direction; below, its own pivots have to speak
TRIED = 1  # steps before their rate is believed: a poor M shows in the first one, which costs a fifth of H = L L'


class KeptFactorization(Factorization):
    """A factorization that may be older than the system solved last. Asked for itself, it is made new first.

    Attributes
    ----------
    factorizations, steps : so far.
    """

    factorizations = steps = 0
    _newer: Array | None = None  # the flat blocks of the current H, where the factorization is older
    _h: Array | None = None  # None: there is no factorization to start from

    def factorize(self, S: Array) -> Factorization:
        self._newer = self._h = None  # one that fails leaves nothing behind
        super().factorize(S)
        self.factorizations += 1
        return self

    def keep(self, system: LinearSystem, damping: Array | None) -> None:
        """The factorization just made is good: h for the check of what is solved with it later."""
        rng = np.random.default_rng(0)
        h = LinearSystem(system.pattern, system.blocks, rng.normal(size=system.pattern.m)).gradient
        if damping is not None:
            h = h + np.sqrt(damping) * rng.normal(size=len(h))
        self._h = h[self.hessian.permutation]

    @property
    def exists(self) -> bool:
        """Whether there is a factorization of a regular H, old or new."""
        return self._h is not None

    @property
    def current(self) -> bool:
        """Whether the factorization is of the H solved last."""
        return self.exists and self._newer is None

    def iterate(self, S: Array, g: Array, tol: float, max_steps: int) -> Array | None:
        """H^-1 g (n,), columns in the order of A, by conjugate gradients; None where a factorization has to be made.

        Parameters
        ----------
        S : flat blocks of H.
        g : (n,) right side.
        tol, max_steps : as in `CholeskyPCG`.
        """
        assert self._h is not None
        H, permutation = self.hessian.matrix(S), self.hessian.permutation
        diagonal = H.data[H.indptr[:-1]]
        if not (np.isfinite(diagonal).all() and (diagonal > 0).all() and np.isfinite(g.sum())):
            return None
        with single_thread():
            x, steps = self._conjugate(H, diagonal, g[permutation], self._h, tol, max_steps)
        self.steps += steps
        if x is None:
            return None
        self._newer = S
        dx = np.empty_like(x)
        dx[permutation] = x
        return dx

    def _conjugate(
        self, H: sp.csc_matrix, diagonal: Array, g: Array, h: Array, tol: float, max_steps: int
    ) -> tuple[Array | None, int]:
        """The solution, or None, and the steps taken. H is a lower triangle, all is in elimination order."""
        upper = H.T
        solution = conjugate(
            lambda P: np.stack([H @ p + upper @ p - diagonal * p for p in P]),
            lambda R: self.decomposition.solve(R.T).T,
            np.stack([g, h]),
            lambda first: np.array([tol**2 * first[0], SURE**2]),
            max_steps,
            TRIED,
        )
        solved = solution.converged and _softest(solution.coefficients[1]) > SOFT
        return solution.x[0] if solved else None, solution.steps

    def solve(self, g: Array) -> Array:
        self._renew()
        return super().solve(g)

    def lower(self) -> tuple[sp.csc_array, Index]:
        self._renew()
        return super().lower()

    def _renew(self) -> None:
        if self._newer is not None:
            self.factorize(self._newer)


def _softest(lanczos: list[tuple[float, float]]) -> float:
    """The least eigenvalue of M^-1 H seen from h: of the tridiagonal matrix of the coefficients (alpha, beta)."""
    if not lanczos:
        return np.inf
    alpha, beta = np.array(lanczos).T
    T = np.diag(1 / alpha + np.append(0.0, beta[1:] / alpha[:-1]))
    off = np.sqrt(beta[1:]) / alpha[:-1]
    T += np.diag(off, 1) + np.diag(off, -1)
    return float(np.linalg.eigvalsh(T)[0])


class CholeskyPCG(Cholesky):
    """Conjugate gradients on the current A'A, preconditioned with the last factorization that CHOLMOD made.

    Slower than `Cholesky` on every data set measured, by a tenth to a half: the reference page has the
    table. Factorizations are saved where many iterations change little, but the steps cost as much. `Marginals`
    factorizes A'A where it is asked, and gauge ``free`` in every iteration: they take nothing from an old one.

    Parameters
    ----------
    tol : of a step, |H dx - g|_M <= tol |g|_M with M the factorized matrix; above 0 and below 1.
    max_steps : of conjugate gradients in a solve. A step with its two right sides costs a fourth to a tenth of a
        factorization, hence 6. The ratios are 4.8 manhattan, 5.4 city10000, 6.6 sphere2500, 9.0 torus3D, 3.7
        parking-garage, 9.4 for 100,000 poses. A count and not a clock: the same input gives the same bits on a busy
        machine.
    memory_limit : as in `Cholesky`.

    Raises
    ------
    OptionError
        An option that is not possible.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.linear.pcg import CholeskyPCG
    >>> world = sim.manhattan(np.random.default_rng(1), n_poses=200)
    >>> world.graph.fix(world.graph.factors[0].keys[0][0])
    >>> solver, system = CholeskyPCG(), world.graph.linearize(world.truth)
    >>> analysis = solver.analyze(system.pattern)
    >>> first, again = analysis.solve(system), analysis.solve(system)
    >>> analysis.description
    'cholesky-pcg, 1 factorization, 1 CG step'
    """

    name = "cholesky-pcg"

    def __init__(self, tol: float = 1e-8, max_steps: int = 6, memory_limit: float | None = None) -> None:
        super().__init__(memory_limit)
        self.tol, self.max_steps = checked_settings(tol, max_steps)

    def analyze(self, pattern: Pattern) -> KeptAnalysis:
        factorization = self.prepared(pattern)
        return KeptAnalysis(
            KeptFactorization(factorization.hessian, factorization.decomposition), self.tol, self.max_steps
        )


class KeptAnalysis(NormalAnalysis):
    """Conjugate gradients where the kept factorization is near enough, a new one where it is not.

    Parameters
    ----------
    factorization : the factorization.
    tol, max_steps : as in `CholeskyPCG`.
    """

    def __init__(self, factorization: KeptFactorization, tol: float, max_steps: int) -> None:
        super().__init__(CholeskyPCG.name, factorization)
        self._factorization, self._tol, self._max_steps = factorization, tol, max_steps

    def solve(self, system: LinearSystem, damping: Array | None = None) -> LinearSolution:
        seconds = {"assemble": 0.0, "factorize": 0.0, "solve": 0.0}
        if self._factorization.exists:
            dx = self._iterated(system, damping, seconds)
            if dx is not None:
                return LinearSolution(dx, seconds)
        solution = super().solve(system, damping)
        t0 = perf_counter()
        self._factorization.keep(system, damping)
        seconds["factorize"] += perf_counter() - t0
        return LinearSolution(
            solution.dx, {stage: seconds[stage] + duration for stage, duration in solution.seconds.items()}
        )

    def again(self, system: LinearSystem) -> LinearSolution | None:
        return super().again(system) if self._factorization.current else None

    @property
    def description(self) -> str:
        """Name, factorizations and steps of conjugate gradients since `analyze`, in words."""
        factorization = self._factorization
        factorizations = several(factorization.factorizations, "factorization")
        return f"{self.name}, {factorizations}, {several(factorization.steps, 'CG step')}"

    def _iterated(self, system: LinearSystem, damping: Array | None, seconds: dict[str, float]) -> Array | None:
        """The step by conjugate gradients, or None; the time it took is added to `seconds`."""
        t0 = perf_counter()
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused where it is factorized
            S, g = system.H_blocks, system.gradient
        if damping is not None:
            S = S.copy()
            self._factorization.hessian.damp(S, damping)
        t1 = perf_counter()
        dx = self._factorization.iterate(S, g, self._tol, self._max_steps)
        seconds["assemble"], seconds["solve"] = t1 - t0, perf_counter() - t1
        return dx
