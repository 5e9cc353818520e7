r"""Gauss-Newton: linearize, solve, retract, stop.

    A, b = linearization at X
    dx   = argmin |A dx - b|
    X    = X retract dx

No damping and no line search: a step may raise chi2 on the way to a lower one (the Intel graph does, and converges).
The best point met is what is returned, and a rise is never called converged. Source: F. Dellaert, M. Kaess, Factor
Graphs for Robot Perception, 2017, section 2.5; the page on least squares in the documentation.
"""

from __future__ import annotations

from dataclasses import dataclass

from nls.optimizers.base import Optimizer
from nls.optimizers.problem import Problem
from nls.optimizers.reuse import reused
from nls.optimizers.watch import Watch
from nls.system import LinearSystem
from nls.values import Values

__all__ = ["GaussNewton"]


@dataclass(frozen=True)
class GaussNewton(Optimizer):
    """The undamped method, one factorization an iteration.

    Parameters
    ----------
    stop : thresholds.
    callback : called with every `Iteration`; returning True stops.
    reuse : try the last steps, which gain little, with the factorization of the step before (`nls.optimizers.reuse`).

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

    reuse: bool = False
    name = "gauss-newton"

    def iterate(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        while watch.status is None:
            if self.reuse and (end := reused(problem, X, system, watch)):
                X, system = end
                continue
            dx = problem.solve(system)
            if watch.flat(X, system, dx):
                break
            X, promised = problem.retract(X, dx), float(dx @ system.gradient)
            system.forget()
            system = problem.linearize(X)
            watch.step(X, system, dx, promised, problem.lap())
