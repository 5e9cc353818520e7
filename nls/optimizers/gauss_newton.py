r"""Gauss-Newton: linearize, solve, retract, stop.

    A, b = linearization at X
    dx   = argmin |A dx - b|
    X    = X retract dx

No damping and no line search: a step may raise chi2 on the way to a lower one (the Intel graph does, and converges).
The best point met is what is returned, and a rise is never called converged. Source: F. Dellaert, M. Kaess, Factor
Graphs for Robot Perception, 2017, section 2.5; the page on least squares in the documentation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from models.errors import EvaluationError, SingularGeometryError
from nls.diagnose import underconstrained
from nls.linear.base import SingularSystemError
from nls.optimizers.result import Iteration
from nls.optimizers.stop import Status, Stop
from nls.optimizers.watch import Watch

if TYPE_CHECKING:
    from nls.optimizers.problem import Problem
    from nls.values import Values

__all__ = ["GaussNewton"]


@dataclass(frozen=True)
class GaussNewton:
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

    stop: Stop = field(default_factory=Stop)
    callback: Callable[[Iteration], bool | None] | None = None
    name = "gauss-newton"

    def run(self, problem: Problem, values: Values) -> Watch:
        """Iterate from the values until a rule ends it.

        Raises
        ------
        UnderconstrainedError
            A singular system; carries the best values so far.
        EvaluationError, SingularGeometryError
            The start itself cannot be evaluated, or a function of the user's raised an exception.
        """
        X, system = values, problem.linearize(values)
        watch = Watch(self.stop, self.callback, X, system.chi2, problem.lap())
        try:
            while watch.status is None:
                dx = problem.solve(system)
                if watch.flat(system):
                    break
                X, promised = problem.retract(X, dx), float(dx @ system.gradient)
                system = problem.linearize(X)
                watch.step(X, system.chi2, dx, promised, problem.lap())
        except SingularSystemError as error:
            raise underconstrained(problem.solver.seen(system), watch.best) from error
        except (EvaluationError, SingularGeometryError) as error:
            at_start = len(watch.history) == 1 and getattr(error, "where", "") == "A'A"
            if error.__cause__ is not None or at_start:  # a fault to see, not a place the step should have avoided
                raise
            watch.end(Status.DIVERGED, f"the step of iteration {len(watch.history)} led where {error}")
        except KeyboardInterrupt:
            watch.end(Status.INTERRUPTED, f"after {len(watch.history) - 1} iterations")
        return watch
