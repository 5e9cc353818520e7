r"""Levenberg-Marquardt: Gauss-Newton steps, damped until they lower chi2.

    A, b = linearization at X
    dx   = argmin |A dx - b|^2 + lambda |D dx|^2
    gain = (chi2(X) - chi2(X retract dx)) / what the linear model promised
    if gain > 0:     X = X retract dx
    if gain > 3/4:   lambda = lambda / 10
    if gain < 1/4:   lambda = 3 lambda

D^2 is the diagonal of A'A, each entry the largest met so far, so that the damping does not depend on units and holds on
to an unknown that loses its influence; 1 for one that nothing reacts to, so that it is damped all the same. Sources:
D. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", 1963; J. More, "The
Levenberg-Marquardt algorithm: implementation and theory", 1978.

A small damped step proves nothing: damping makes every step small. Before the method says converged it solves once
more without damping, and the linear model must agree that chi2 cannot fall. Where that system is singular, something is
free: the result then says so in `Result.underconstrained`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.errors import OptionError
from models.options import is_number
from nls.linear.base import SingularSystemError
from nls.optimizers.base import Optimizer
from nls.optimizers.stop import Status
from nls.optimizers.undamped import Undamped, diagonal

if TYPE_CHECKING:
    from nls.optimizers.problem import Problem
    from nls.optimizers.watch import Watch
    from nls.system import LinearSystem
    from nls.values import Values

__all__ = ["LevenbergMarquardt"]

SUFFICIENT = 1e-4  # a step is taken when chi2 falls by this part of what the linear model promised
GOOD, POOR = 0.75, 0.25  # parts of it between which the damping stays
FAINT, HOPELESS = 1e-16, 1e16  # the least damping, and the one at which no step is left to try


@dataclass(frozen=True)
class LevenbergMarquardt(Optimizer):
    """The damped method: for starts far away, projections, residuals with kinks, and systems with free directions.

    Parameters
    ----------
    stop : thresholds; ``max_iterations`` counts the steps that were taken.
    callback : called with every `Iteration`; returning True stops.
    damping : lambda of the first step, relative to the diagonal of A'A.

    Raises
    ------
    OptionError
        A damping that is no number above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Factor
    >>> from models import R
    >>> from nls import FactorGraph, LevenbergMarquardt, Values, kinds
    >>> (p,) = kinds("p")
    >>> rosenbrock = lambda X: np.stack([10 * (X[:, 1] - X[:, 0] ** 2), 1 - X[:, 0]], axis=1)
    >>> graph = FactorGraph([Factor.from_function(rosenbrock, p[0], dim=2)])
    >>> result = graph.optimize(Values({p: (R(2), [-1.2, 1.0])}), LevenbergMarquardt())
    >>> result.converged, result.values[p[0]].round(6)
    (True, array([1., 1.]))
    """

    damping: float = 1e-3
    name = "levenberg-marquardt"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_number(self.damping) or not 0 < self.damping < HOPELESS:
            raise OptionError("damping", self.damping, f"a number above 0 and below {HOPELESS:g}")

    def iterate(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        damping, undamped, D2 = self.damping, Undamped(problem), np.zeros(problem.pattern.n)
        if not system.column_norms.any():
            undamped.step(system)  # nothing reacts to anything: refused, with the names of the unknowns
        while watch.status is None:
            if watch.flat(system, undamped):
                break
            D2 = np.maximum(D2, diagonal(system))
            try:
                dx = problem.solve(system, damping * D2)
            except SingularSystemError as error:
                trial, promised, led = None, math.inf, f"nowhere: {error}"
            else:
                promised = system.promised(dx)
                Y, trial, led = problem.attempt(X, dx)
            used, fall = damping, -math.inf if trial is None else system.chi2 - trial.chi2
            if fall > GOOD * promised:
                damping = max(damping / 10, FAINT)
            elif not fall >= POOR * promised:
                damping *= 3
            if trial is not None and fall > SUFFICIENT * promised:
                X, system = Y, trial
                watch.step(X, system, dx, promised, problem.lap(), used, undamped)
            else:
                watch.refuse(system, promised, led, undamped)
                if damping > HOPELESS and watch.status is None:
                    watch.stall(system, led)
        if watch.status is Status.CONVERGED:
            watch.free = undamped.free
