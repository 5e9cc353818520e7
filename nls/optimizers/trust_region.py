"""The loop that Levenberg-Marquardt and dogleg share: a step within a radius, tried, and the radius set by its gain."""

from __future__ import annotations

import math
from abc import abstractmethod

import numpy as np

from models.algebra import Array
from nls.optimizers.base import Optimizer, Watch
from nls.optimizers.problem import FAINT, Problem, Undamped
from nls.optimizers.result import Status
from nls.optimizers.step import ROUNDING, Step
from nls.system import LinearSystem
from nls.values import Values


class TrustRegion(Optimizer):
    """A method whose steps stay within a radius; subclasses give `within`, their algorithm box."""

    @abstractmethod
    def within(
        self, undamped: Undamped, system: LinearSystem, D: Array, radius: float, damping: float
    ) -> tuple[Array, float]:
        """A step with |D dx| of about the radius, or the undamped one where that is shorter; and its damping.

        Parameters
        ----------
        undamped, system : what is linearized.
        D, radius : lengths of the columns of A, the largest met of each; the bound.
        damping : of the step before.
        """

    def first_damping(self, kinked: bool) -> float:
        """Lambda of the first step; kinked: a factor says that undamped steps fail (`Factor.damped`)."""
        return FAINT

    def iterate(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        kinked = any(batch.model.factor.damped for batch in problem.pattern.batches)
        # Gain above which the radius grows, and below which it shrinks; the radius then, times |D dx|. Over a kink no
        # step gains what the linear model promises: success alone decides.
        good, poor, grown, shrunk = (0.1, 0.1, 10.0, 0.5) if kinked else (0.75, 0.25, 2.5, 0.4)
        radius, damping, undamped = math.inf, 0.0, Undamped(problem, self.first_damping(kinked))
        if not system.column_norms.any():
            problem.solve(system)  # nothing reacts to anything: refused, with the names of the unknowns
        while watch.status is None:
            D = watch.scale(system)
            gn = undamped.step(system, D)
            if watch.flat(X, system, gn):
                break
            dx, damping = self.within(undamped, system, D, radius, damping)
            length, promised = float(np.linalg.norm(D * dx)), system.promised(dx)
            Y, trial, led = problem.attempt(X, dx)
            fall = -math.inf if trial is None else system.chi2 - trial.chi2
            if trial is not None and fall > max(1e-4 * promised, 0.0):  # it falls by a part of the promise
                if fall < poor * promised:
                    radius = shrunk * length
                elif fall > good * promised:
                    radius = max(radius, grown * length)
                X, system = Y, trial
                watch.step(X, system, dx, promised, problem.lap(), damping, undamped)
            else:
                size = float(np.linalg.norm(D * problem.pattern.restrict(X.coordinates)))
                # a step as long as |D x| ends at 0
                radius = min(0.6 * radius, shrunk * length, 0.99 * size or math.inf)
                watch.refuse(X, system, dx, promised, fall, undamped)
                # where no step is left to try, chi2 is looked at a tenth of |D x| along the undamped one
                if not 1e-16 * (size or length) <= radius < math.inf and watch.status is None:
                    _, chi2 = problem.glance(X, gn * (0.1 * (size or length) / float(np.linalg.norm(D * gn))))
                    watch.stall(X, system, chi2, led)
        if watch.status is Status.CONVERGED:
            gn = undamped.step(system, watch.scale(system), strict=True)
            lower = _below_tangent(problem, X, system, gn, watch)
            if lower is None:
                watch.free = undamped.free
                return
            watch.reopen()
            if watch.status is None:
                Y, trial, dx = lower
                watch.step(Y, trial, dx, system.promised(dx), problem.lap(), 0.0, undamped)
                self.iterate(problem, Y, trial, watch)


def _below_tangent(
    problem: Problem, X: Values, system: LinearSystem, gn: Array, watch: Watch
) -> tuple[Values, LinearSystem, Array] | None:
    """A point near a stationary one where chi2 is below its tangent, hence no minimum; with the step that leads there.

    The linear model cannot see that: |A dx - b|^2 never curves downward. Undamped steps grow along such a direction, so
    chi2 is looked at only where they no longer shorten.
    """
    # a step half as long as the last one: steps still shorten, this is no way off a saddle
    if system.chi2 == 0 or not gn.any() or np.abs(gn).max() < 0.5 * watch.history[-1].update:
        return None
    D = watch.scale(system)
    length = float(np.linalg.norm(D * gn))
    size = float(np.linalg.norm(D * problem.pattern.restrict(X.coordinates))) or length
    dx = gn * (1e-3 * size / length)  # chi2 is compared with its tangent so far along the undamped step
    _, chi2 = problem.glance(X, dx)
    below = system.chi2 - 2 * float(dx @ system.gradient) - chi2
    if below <= ROUNDING * system.chi2 or Step(watch, X, system, dx).rounds(below):
        return None
    Y, trial, _ = problem.attempt(X, dx)
    return None if trial is None else (Y, trial, dx)
