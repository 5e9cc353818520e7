r"""Gauss-Newton: linearize, solve, retract, stop.

    A, b = linearization at X
    dx   = argmin |A dx - b|
    X    = X retract dx

The last step, which only confirms that chi2 falls no more, is first tried with the factorization of the one before:
near the optimum A'A hardly changes, and factorizing it is most of an iteration (66 of 85 ms on sphere2500, 5 of 7
factorizations of three steps in all). It is taken when chi2 proves it to be the last, and forgotten otherwise.

No damping and no line search: a step may raise chi2 on the way to a lower one (the Intel graph does, and converges).
The best point met is what is returned, and a rise is never called converged. Source: F. Dellaert, M. Kaess, Factor
Graphs for Robot Perception, 2017, section 2.5; the page on least squares in the documentation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from nls.optimizers.base import Optimizer

if TYPE_CHECKING:
    from nls.optimizers.problem import Problem
    from nls.optimizers.watch import Watch
    from nls.system import LinearSystem
    from nls.values import Values

__all__ = ["GaussNewton"]

CHANGED = 0.02  # of |A dx|^2; beyond, A'A is no longer what was factorized (pose graphs 0.005, a plateau 0.1 to 0.9)


@dataclass(frozen=True)
class GaussNewton(Optimizer):
    """The undamped method.

    Parameters
    ----------
    stop : thresholds.
    callback : called with every `Iteration`; returning True stops.

    Examples
    --------
    >>> from factors import Isotropic, Prior
    >>> from models import SE2
    >>> from nls import FactorGraph, GaussNewton, Kind, Stop, Values
    >>> x = Kind("x")
    >>> graph = FactorGraph([Prior(x[0], [1, 2, 3], Isotropic(0.1))])
    >>> one_step = GaussNewton(Stop(max_iterations=1))
    >>> graph.optimize(Values({x: (SE2, [0, 0, 0])}), one_step).status.name
    'MAX_ITERATIONS'
    """

    name = "gauss-newton"

    def iterate(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        while watch.status is None:
            if watch.nearly and self._last(problem, X, system, watch):
                break
            dx = problem.solve(system)
            if watch.flat(system):
                break
            X, promised = problem.retract(X, dx), float(dx @ system.gradient)
            system = problem.linearize(X)
            watch.step(X, system, dx, promised, problem.lap())

    def _last(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> bool:
        """Whether the step of the kept factorization is the last one."""
        dx = problem.solve_again(system)
        if dx is None:
            return False
        downhill = float(dx @ system.gradient)  # |A dx|^2, had A'A not changed
        promised = system.promised(dx)
        if not abs(promised - downhill) < CHANGED * downhill or promised > watch.stop.chi2_rtol * system.chi2:
            return False
        Y = problem.retract(X, dx)
        return watch.last(Y, problem.chi2(Y), dx, promised, problem.lap())
