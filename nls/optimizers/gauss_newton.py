r"""Gauss-Newton: linearize, solve, retract, stop.

    A, b = linearization at X
    dx   = argmin |A dx - b|
    X    = X retract dx

The last steps, which gain little or only confirm that chi2 falls no more, are tried with the factorization of the one
before: near the optimum A'A hardly changes, and factorizing it is most of an iteration (66 of 85 ms on sphere2500).
Such a step is forgotten where A'A turns out to have changed, or where it leads nowhere.

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

# Change of A'A along the step since it was factorized, beyond which a step, and the last one, is not taken. It is
# 0.0001 to 0.1 where pose graphs arrive, 0.8 to 0.95 from step to step on a plateau that falls for ever.
CHANGED, LAST = 0.1, 0.5


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
            if watch.nearly and (there := self._kept(problem, X, system, watch)) is not None:
                X, system = there
                continue
            dx = problem.solve(system)
            if watch.flat(X, system, dx):
                break
            X, promised = problem.retract(X, dx), float(dx @ system.gradient)
            system = problem.linearize(X)
            watch.step(X, system, dx, promised, problem.lap())

    def _kept(
        self, problem: Problem, X: Values, system: LinearSystem, watch: Watch
    ) -> tuple[Values, LinearSystem] | None:
        """Where the step of the kept factorization leads, and the system there; None where it is not to be taken.

        What proves to be the last step needs no other system.
        """
        dx = problem.solve_again(system)
        if dx is None:
            return None
        promised, downhill = system.promised(dx), float(dx @ system.gradient)  # equal, had A'A not changed
        last = promised <= watch.stop.chi2_rtol * system.chi2
        if not (abs(promised - downhill) < (LAST if last else CHANGED) * downhill and watch.small(promised)):
            return None
        if last:
            Y, chi2 = problem.glance(X, dx)
            return (Y, system) if watch.last(Y, system, chi2, dx, promised, problem.lap()) else None
        Y, there, _ = problem.attempt(X, dx)
        if there is None:
            return None
        watch.step(Y, there, dx, promised, problem.lap())
        return Y, there
