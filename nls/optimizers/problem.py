"""The problem of an optimizer: a pattern, a linear solver, and the clock that says where the time went.

`Undamped` has the step of methods that shorten it: faintly damped, and without any damping for a verdict.
"""

import math
from collections.abc import Callable
from time import perf_counter
from typing import TypeVar

import numpy as np

from models.algebra import Array
from models.errors import EvaluationError, OptionError, SingularGeometryError
from nls.linear.base import LinearSolution, LinearSolver
from nls.linear.default import chosen_solver
from nls.linear.factorization import NULL, SingularSystemError
from nls.linear.null_space import weakest
from nls.linear.underconstrained import underconstrained
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values

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
        self.latest, start = system, perf_counter()
        try:
            return self._counted(self.analysis.solve(system, damping))
        except KeyboardInterrupt:
            self._add("factorize", perf_counter() - start)  # nearly all of it
            raise

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
    OptionError
        Not a linearization.

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
    if not isinstance(system, LinearSystem):
        raise OptionError("system", system, "a LinearSystem, graph.linearize(values)")
    solver = chosen_solver(linear_solver, system.pattern.n)
    try:
        return solver.analyze(system.pattern).solve(system).dx
    except SingularSystemError as error:
        raise underconstrained(solver.held_system(system), cause=error, solver=solver) from error


FAINT = 1e-14  # lambda that changes no step within its digits; 100 times as much, and again, where it does not suffice
HOPELESS = 1e16  # lambda at which no step is left to try


class Undamped:
    """Solves a linearization with the faintest damping, once, or with none.

    Parameters
    ----------
    problem : what is optimized.
    damping : lambda of the first system; a tenth of it for each that follows, down to `FAINT`.

    Attributes
    ----------
    free : the system solved last without damping, when A has a null direction; None when it has none.
    damping : lambda of the latest system.
    """

    def __init__(self, problem: Problem, damping: float = FAINT) -> None:
        self.problem, self.damping, self._least = problem, 10 * damping, FAINT
        self.free: LinearSystem | None = None
        self._solved: dict[bool, tuple[LinearSystem, Array]] = {}

    def step(self, system: LinearSystem, D: Array, strict: bool = False) -> Array:
        """dx = argmin |A dx - b|^2 + lambda |D dx|^2 with the least lambda that works; computed once per system.

        Parameters
        ----------
        system, D : the linearization; lengths of the columns of A, which damping is measured by.
        strict : with lambda = 0 where there is such a step. Otherwise that is not tried: it would double the
            factorizations of a graph that is free throughout.

        Raises
        ------
        SingularSystemError
            None works.
        """
        if self._solved.get(strict, (None,))[0] is not system:
            self._solved[strict] = system, self._exact(system, D) if strict else self._faint(system, D)
        return self._solved[strict][1]

    def _exact(self, system: LinearSystem, D: Array) -> Array:
        """The step without damping; where A'A is singular, the faint one, or by A itself where that promises more."""
        try:
            dx, self.free = self.problem.solve(system), None
            return dx
        except SingularSystemError:
            dx, self.free = self._faint(system, D), system
        # A'A squares the condition of A: a direction that A sees with 1e-8 of a column is lost in it. Of up to 300
        # unknowns the weakest directions of A are looked at, and followed where they promise a relative decrease of
        # chi2 above 0.02. A bundle has dozens of them, and little to gain.
        if len(dx) > 300 or self.problem.solver.held_system(system) is not system:
            return dx
        s, N = weakest(system)
        if not (s <= NULL).any():
            self.free = None
        N = N[:, s > 1e-10]
        A_N, residual = system.A @ N, system.b - system.times(dx)
        lengths = np.linalg.norm(A_N, axis=0)
        farther = np.asarray(dx + (N / lengths) @ np.linalg.lstsq(A_N / lengths, residual)[0])
        return farther if system.promised(farther) - system.promised(dx) > 0.02 * system.chi2 else dx

    def _faint(self, system: LinearSystem, D: Array) -> Array:
        self.damping = max(self.damping / 10, self._least)
        while True:
            try:
                return self.problem.solve(system, self.damping * D**2)
            except SingularSystemError:
                self.damping *= 100
                self._least = min(self.damping, 1e-8)  # a larger one no system that follows keeps
                if self.damping > HOPELESS:
                    raise
