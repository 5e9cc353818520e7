"""The shortest step of a free gauge, by any linear solver, with one variable of every component held."""

from __future__ import annotations

from time import perf_counter

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index
from nls.linear.base import Analysis, LinearSolution, LinearSolver
from nls.linear.factorization import SingularSystemError
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem


def gauge_columns(held: Pattern, free: Pattern) -> tuple[Index, Index]:
    """Columns of `free` that `held` leaves out, the gauge, and all others."""
    gauge = np.flatnonzero(np.repeat(held.held & ~free.held, np.where(free.held, 0, free.dims)))
    return gauge, np.setdiff1d(np.arange(free.n), gauge)


def free_directions(A: sp.csr_array, gauge: Index, complement: Index, unheld: Array) -> Array:
    """Orthonormal basis (n, k) of the free gauge, N = [-pinv(A_f) A_h; I], from ``unheld``, pinv(A_f) A_h.

    Raises
    ------
    SingularSystemError
        The held columns are no free directions: N changes a measurement.
    """
    N = np.zeros((A.shape[1], len(gauge)))
    N[complement], N[gauge] = -unheld, np.eye(len(gauge))
    lengths = np.sqrt(A.copy().power(2).sum(axis=0))  # of A itself it would sort indices that all linearizations share
    U = N / np.linalg.norm(lengths[:, None] * N, axis=0)  # of length 1 in sigmas, whatever the units
    if np.abs(A @ U).max(initial=0.0) > 1e-6:  # sigmas; public pose graphs have at most 1e-10
        raise SingularSystemError("the held variable is not a free direction of the measurements")
    return np.asarray(np.linalg.qr(N)[0])


class FreeGauge(LinearSolver):
    """A linear solver whose step is the shortest of all minimizers, found with one variable per component held.

    With A = [A_f A_h], the columns of N = [-pinv(A_f) A_h; I] change no measurement: they are the gauge. The step of
    the solver with the held columns left out, minus its part along N, is pinv(A) b, by sparse means. The factorization
    of the step serves N as well, N_f = -(A_f'A_f)^-1 A_f'A_h; a solver that keeps none is called once per column.

    Parameters
    ----------
    solver : the linear solver for the free columns.
    held : the pattern with the gauge held; the pattern given to `analyze` has all its columns.
    """

    def __init__(self, solver: LinearSolver, held: Pattern) -> None:
        self.solver, self.held = solver, held
        self.name, self.exact, self.shortest = solver.name, solver.exact, solver.shortest

    def analyze(self, pattern: Pattern) -> FreeAnalysis:
        return FreeAnalysis(self, self.solver.analyze(self.held), *gauge_columns(self.held, pattern))

    def left(self, system: LinearSystem) -> Array | None:
        return self.solver.left(system)

    def held_system(self, system: LinearSystem) -> LinearSystem:
        return LinearSystem(self.held, system.blocks, system.b)


class FreeAnalysis(Analysis):
    """The analysis of a pattern by `FreeGauge`.

    Parameters
    ----------
    solver, analysis : of the free gauge; of the columns that are not held.
    gauge, complement : columns that are the gauge, and all others.
    """

    def __init__(self, solver: FreeGauge, analysis: Analysis, gauge: Index, complement: Index) -> None:
        super().__init__(solver.name)
        self.solver, self.analysis, self.gauge, self.complement = solver, analysis, gauge, complement

    @property
    def description(self) -> str:
        return self.analysis.description

    def solve(self, system: LinearSystem, damping: Array | None = None) -> LinearSolution:
        held = self.solver.held_system(system)
        step = self.analysis.solve(held, None if damping is None else damping[self.complement])
        t0 = perf_counter()
        x = np.zeros(system.pattern.n)
        x[self.complement] = step.dx
        unheld = self.analysis.columns(held, system.A[:, self.gauge])
        Q = free_directions(system.A, self.gauge, self.complement, unheld)
        seconds = {**step.seconds, "solve": step.seconds.get("solve", 0.0) + perf_counter() - t0}
        return LinearSolution(x - Q @ (Q.T @ x), seconds)
