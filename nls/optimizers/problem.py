"""The problem of an optimizer: a pattern, a linear solver, and the clock that says where the time went."""

from __future__ import annotations

import math
from collections.abc import Callable
from time import perf_counter
from typing import TypeVar

from models.algebra import Array
from models.errors import EvaluationError, SingularGeometryError
from nls.linear.base import LinearSolution, LinearSolver
from nls.linear.default import chosen_solver
from nls.linear.singular import SingularSystemError
from nls.linear.underconstrained import underconstrained
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values

__all__ = ["Problem", "gauss_newton_step"]

U = TypeVar("U")


class Problem:
    """A graph made ready: linearize, solve, retract, each timed.

    Attributes
    ----------
    latest : the system solved last.
    """

    latest: LinearSystem

    def __init__(self, pattern: Pattern, solver: LinearSolver) -> None:
        self.pattern, self.solver = pattern, solver
        self.timings: dict[str, float] = {}
        self._lap: dict[str, float] = {}
        start = perf_counter()
        self.analysis = solver.analyze(pattern)
        self._add("analyze", perf_counter() - start)
        self._lap.clear()

    def linearize(self, values: Values) -> LinearSystem:
        return self._timed("linearize", lambda: LinearSystem.at(self.pattern, values))

    def solve(self, system: LinearSystem, damping: Array | None = None) -> Array:
        self.latest = system
        return self._counted(self.analysis.solve(system, damping))

    def solve_again(self, system: LinearSystem) -> Array | None:
        """The step by the factorization of the latest solve; None where the linear solver keeps none."""
        self.latest = system
        solution = self.analysis.again(system)
        return None if solution is None else self._counted(solution)

    def singular(self, values: Values) -> LinearSystem | None:
        """The system at the values, where the shortest step leaves something of it alone; None where it does not."""
        system = self.solver.held_system(self.linearize(values))
        left = self.solver.left(system) if system.pattern.n else None
        return None if left is None or not left.shape[1] else system

    def retract(self, values: Values, dx: Array) -> Values:
        return self._timed("retract", lambda: values.retract(self.pattern.expand(dx)))

    def attempt(self, values: Values, dx: Array) -> tuple[Values, LinearSystem | None, str]:
        """Where a trial step leads: values, their linearization or None where there is none, and that in words.

        Raises
        ------
        EvaluationError
            A function of the user's raised an exception: a fault to see, not a place to avoid.
        """
        moved, system, led = self._reached(values, dx, self.linearize)
        return moved, system, led if system is None else f"to chi2 {system.chi2:.9g}"

    def glance(self, values: Values, dx: Array) -> tuple[Values, float]:
        """Where a trial step leads, and chi2 there, infinite where it cannot be evaluated; errors as for `attempt`."""
        evaluate = self.pattern.chi2
        moved, chi2, _ = self._reached(values, dx, lambda trial: self._timed("linearize", lambda: evaluate(trial)))
        return moved, math.inf if chi2 is None else chi2

    def _reached(self, values: Values, dx: Array, evaluate: Callable[[Values], U]) -> tuple[Values, U | None, str]:
        """Values moved and evaluated; as they were, None and the reason where that cannot be done."""
        try:
            moved = self.retract(values, dx)
            return moved, evaluate(moved), ""
        except (EvaluationError, SingularGeometryError) as error:
            if error.is_fault:
                raise
            return values, None, f"where {error}"

    def lap(self) -> dict[str, float]:
        """Seconds by part since the last call."""
        lap, self._lap = self._lap, {}
        return lap

    def _timed(self, stage: str, work: Callable[[], U]) -> U:
        start = perf_counter()
        done = work()
        self._add(stage, perf_counter() - start)
        return done

    def _counted(self, solution: LinearSolution) -> Array:
        for stage, seconds in solution.seconds.items():
            self._add(stage, seconds)
        return solution.dx

    def _add(self, stage: str, seconds: float) -> None:
        self.timings[stage] = self.timings.get(stage, 0.0) + seconds
        self._lap[stage] = self._lap.get(stage, 0.0) + seconds


def gauss_newton_step(system: LinearSystem, linear_solver: LinearSolver | None = None) -> Array:
    """The step dx = argmin |A dx - b|, (n,).

    Parameters
    ----------
    system : one linearization, ``graph.linearize(values)``.
    linear_solver : of `nls.linear`; the best one installed when omitted.

    Raises
    ------
    UnderconstrainedError
        Something is free: there is no unique step.
    EvaluationError
        Squares of weights or Jacobians overflow.

    Examples
    --------
    >>> from factors import Isotropic, Prior
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, gauss_newton_step, kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Prior(x[0], [1, 2, 0], Isotropic(0.1))])
    >>> gauss_newton_step(graph.linearize(Values({x: (SE2, [0, 0, 0])}))).round(6)
    array([1., 2., 0.])
    """
    solver = chosen_solver(linear_solver, system.pattern.n)
    try:
        return solver.analyze(system.pattern).solve(system).dx
    except SingularSystemError as error:
        raise underconstrained(solver.held_system(system), cause=error, solver=solver) from error
