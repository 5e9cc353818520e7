"""What an optimizer works on: a pattern, a linear solver, and the clock that says where the time went."""

from __future__ import annotations

import math
from time import perf_counter
from typing import Any

from models.algebra import Array
from models.errors import EvaluationError, SingularGeometryError
from nls.assemble import Pattern
from nls.linear.base import LinearSolver
from nls.system import LinearSystem
from nls.values import Values

__all__ = ["Problem"]


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
        self.state: Any = solver.analyze(pattern)
        self._add("analyze", perf_counter() - start)
        self._lap.clear()

    def linearize(self, values: Values) -> LinearSystem:
        start = perf_counter()
        system = self.pattern.linearize(values)
        self._add("linearize", perf_counter() - start)
        return system

    def solve(self, system: LinearSystem, damping: Array | None = None) -> Array:
        self.latest = system
        solution = self.solver.solve(self.state, system, damping)
        for part, seconds in solution.seconds.items():
            self._add(part, seconds)
        return solution.dx

    def solve_again(self, system: LinearSystem) -> Array | None:
        """The step by the factorization of the latest solve; None where the linear solver keeps none."""
        solution = self.solver.again(self.state, system)
        if solution is None:
            return None
        for part, seconds in solution.seconds.items():
            self._add(part, seconds)
        return solution.dx

    def retract(self, values: Values, dx: Array) -> Values:
        start = perf_counter()
        moved = values.retract(self.pattern.expand(dx))
        self._add("retract", perf_counter() - start)
        return moved

    def attempt(self, values: Values, dx: Array) -> tuple[Values, LinearSystem | None, str]:
        """Where a trial step leads: values, their linearization or None where there is none, and that in words.

        Raises
        ------
        EvaluationError
            A function of the user's raised an exception: a fault to see, not a place to avoid.
        """
        try:
            moved = self.retract(values, dx)
            system = self.linearize(moved)
        except (EvaluationError, SingularGeometryError) as error:
            if isinstance(error, EvaluationError) and error.__cause__ is not None:
                raise
            return values, None, f"where {error}"
        return moved, system, f"to chi2 {system.chi2:.9g}"

    def glance(self, values: Values, dx: Array) -> tuple[Values, float]:
        """Where a trial step leads, and chi2 there, infinite where it cannot be evaluated; errors as for `attempt`."""
        try:
            moved = self.retract(values, dx)
            start = perf_counter()
            chi2 = self.pattern.chi2(moved)
            self._add("linearize", perf_counter() - start)
        except (EvaluationError, SingularGeometryError) as error:
            if isinstance(error, EvaluationError) and error.__cause__ is not None:
                raise
            return values, math.inf
        return moved, chi2

    def lap(self) -> dict[str, float]:
        """Seconds by part since the last call."""
        lap, self._lap = self._lap, {}
        return lap

    def _add(self, part: str, seconds: float) -> None:
        self.timings[part] = self.timings.get(part, 0.0) + seconds
        self._lap[part] = self._lap.get(part, 0.0) + seconds
