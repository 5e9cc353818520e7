"""The optimizer of those who name none: Gauss-Newton, and dogleg from its best point where that fails.

    run Gauss-Newton, with the last factorization reused near the optimum
    if it diverges, cycles, rises or finds no lower point:   run dogleg from the lowest point
    if it has not arrived after 100 steps, no limit given:   the same, up to 1000 steps in all

Of the two damped methods dogleg is the one with the shorter way from such a point: one factorization an iteration. Who
names a method gets that method alone. The limits of a `Stop` are those of both together.
"""

from __future__ import annotations

from models.errors import UnderconstrainedError
from nls.optimizers import stop
from nls.optimizers.base import Optimizer, Watch
from nls.optimizers.gauss_newton import GaussNewton
from nls.optimizers.problem import Problem
from nls.optimizers.result import Status
from nls.optimizers.step import Step
from nls.optimizers.trust_region import Dogleg
from nls.system import LinearSystem
from nls.values import Values

FAILED = (Status.DIVERGED, Status.CYCLING, Status.STALLED, Status.MAX_ITERATIONS)


def chi2_rises(step: Step) -> stop.Verdict | None:
    """chi2 >= 1e4 chi2 of the start after two steps in a row, and not by rounding."""
    begin = step.watch.history[0].chi2
    # a long drive with 20 closures rises once to 4e6 times the start, not twice in a row
    rises = min(step.chi2, step.old.chi2) >= 1e4 * begin and not step.rounds(step.chi2 - begin)
    return stop.grown(step) if rises else None


def no_new_best(step: Step) -> stop.Verdict | None:
    """No new best for 10 steps."""
    watch = step.watch
    if watch.since_best < 10 or step.invisible:  # pose graphs that converge take up to 4
        return None
    reason = f"no lower chi2 for {watch.since_best} steps; the lowest is {watch.lowest:.6g}, the last {step.chi2:.6g}"
    return stop.Verdict(Status.CYCLING, reason)


class Automatic(Optimizer):
    """Gauss-Newton, and dogleg where that fails or does not arrive.

    Parameters
    ----------
    stop : thresholds, and limits of both methods together.
    callback : called with every `Iteration`; returning True stops.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Factor
    >>> from models import R
    >>> from nls import FactorGraph, Values, kinds
    >>> (p,) = kinds("p")
    >>> graph = FactorGraph([Factor.from_function(lambda X: np.arctan(X), p[0], dim=1)])
    >>> result = graph.optimize(Values({p: (R(1), [2.0])}))
    >>> result.method, result.converged
    ('gauss-newton, then dogleg', True)
    """

    name = "auto"

    def follow(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        self.iterate(problem, X, system, watch)  # its methods are followed one by one

    def iterate(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        watch.after_a_step = (*stop.OUTCOMES, chi2_rises, no_new_best, *stop.LIMITS)
        refusal = None
        try:
            GaussNewton(self.stop, self.callback, reuse=True).follow(problem, X, system, watch)
        except UnderconstrainedError as error:
            if not watch.step_count:
                raise
            watch.end(Status.DIVERGED, f"the linear system of iteration {watch.step_count + 1} is singular", "singular")
            refusal = error
        watch.limit = self.stop.patient.max_iterations or 0
        if watch.status in FAILED and watch.step_count < watch.limit and not watch.halted:
            watch.resume()
            watch.after_a_step = stop.AFTER_A_STEP
            Dogleg(self.stop, self.callback).follow(problem, watch.best, problem.linearize(watch.best), watch)
        if refusal and not (watch.status is Status.CONVERGED and watch.free is None):
            refusal.values = watch.best
            raise refusal
