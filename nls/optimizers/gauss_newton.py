r"""Gauss-Newton: linearize, solve, retract, until the update is small.

    A, b = linearization at X
    dx   = argmin |A dx - b|
    X    = X retract dx
    until |A dx| <= 1e-3 sqrt(min(chi2, max(dof, 1)))

|A dx| is the length of the update in sigmas (`nls.optimizers.stop`). There is no damping and no line search, and
nothing is kept from one iteration to the next. A step may raise chi2 on the way to a lower one (the Intel graph does,
and converges). The best point met is what is returned, and a rise is never called converged. Source: F. Dellaert, M.
Kaess, Factor Graphs for Robot Perception, 2017, section 2.5; the page on least squares in the documentation.
"""

from dataclasses import dataclass

from nls.optimizers.base import Optimizer, Watch
from nls.optimizers.problem import Problem
from nls.optimizers.step import Step
from nls.optimizers.stop import BEFORE_A_STEP
from nls.system import LinearSystem
from nls.values import Values


@dataclass(frozen=True)
class GaussNewton(Optimizer):
    """The undamped method, one linearization and one factorization an iteration.

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
            X, system = one_iteration(problem, X, system, watch)


def one_iteration(problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> tuple[Values, LinearSystem]:
    """The next point and its linearization; the same where no step is left to take."""
    dx = problem.solve(system)
    decrease = float(dx @ system.gradient)  # |A dx|^2
    if not watch.over(BEFORE_A_STEP, Step(watch, X, system, dx, decrease)):
        X = problem.retract(X, dx)
        system.forget()
        system = problem.linearize(X)
        watch.step(Step(watch, X, system, dx, decrease), problem.lap())
    return X, system
