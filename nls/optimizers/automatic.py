r"""The optimizer of those who name none: Gauss-Newton with fewer factorizations, and dogleg where that fails.

    run Gauss-Newton, with the last factorization reused near the optimum
    if it diverges, cycles, rises or turns back:             run dogleg from the lowest point
    if it has not arrived after 100 steps, no limit given:   the same, up to 1000 steps in all

Near the optimum A'A hardly changes. There a step may be taken with the factorization of the step before,

    dx = (L L')^-1 A'b        with the present gradient A'b and the last factorization L

Factorizing A'A is most of an iteration (66 of 85 ms on sphere2500). Such a step is forgotten where A'A has changed, or
where it leads nowhere. Where it is the last one chi2 is evaluated there, and no Jacobian. The page on optimizers in the
documentation has the bounds.

Of the two damped methods dogleg is the one with the shorter way from a failure: one factorization an iteration. Who
names a method gets that method alone. The limits of a `Stop` are those of both together.
"""

from itertools import pairwise

import numpy as np

from models.errors import UnderconstrainedError
from nls.optimizers import stop
from nls.optimizers.base import Optimizer, Watch
from nls.optimizers.gauss_newton import GaussNewton, one_iteration
from nls.optimizers.problem import Problem
from nls.optimizers.result import Status
from nls.optimizers.step import Step
from nls.optimizers.trust_region import Dogleg
from nls.system import LinearSystem
from nls.values import Values


class Reusing(GaussNewton):
    """Gauss-Newton that first tries the factorization of the step before, where little is left to gain."""

    def iterate(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        while watch.status is None:
            X, system = reused(problem, X, system, watch) or one_iteration(problem, X, system, watch)


def reused(problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> tuple[Values, LinearSystem] | None:
    """Where the step of the kept factorization leads, and the system there; None where it is not to be taken."""
    tolerance = watch.stop.sigmas(system.chi2, watch.dof)
    dx = problem.solve_again(system) if _nearly(watch, tolerance) else None
    if dx is None:
        return None
    promised, downhill = system.promised(dx), float(dx @ system.gradient)  # equal, had A'A not changed
    last = promised <= tolerance**2
    # The change of A'A along the step is 0.0001 to 0.1 where pose graphs arrive, 0.8 to 0.95 on a plateau without end.
    changed = abs(promised - downhill) >= (0.5 if last else 0.1) * downhill
    if changed or promised > (3 * tolerance) ** 2:  # three times is not worth a factorization
        return None
    if last:  # no Jacobian is needed there; forgotten where it does not end the optimization
        Y, chi2 = problem.glance(X, dx)
        step = Step(watch, Y, system, dx, promised, chi2=chi2)
        if stop.update_sigmas(step) is None:
            return None
    else:
        Y, trial, _ = problem.attempt(X, dx)
        if trial is None:
            return None
        step, system = Step(watch, Y, trial, dx, promised), trial
    watch.step(step, problem.lap(), reused=True)
    return Y, system


def _nearly(watch: Watch, tolerance: float) -> bool:
    """Whether |A dx| of the next step is hardly more than its threshold, if it gets shorter as the latest did.

    After a first step that was short there is less to gain: it began near the optimum.
    """
    s, update = watch.history[-1].sigmas, watch.history[-1].update
    rate = update / watch.history[-2].update if len(watch.history) > 2 else 1.0
    return s * min(rate, 1.0) <= 10 * tolerance  # ten times is not worth a factorization


FAILED = (Status.DIVERGED, Status.CYCLING, Status.STALLED, Status.MAX_ITERATIONS)


def chi2_rises(step: Step) -> stop.Verdict | None:
    """chi2 >= 1e4 chi2 of the start after two steps in a row, and not by rounding."""
    begin = step.watch.history[0].chi2
    # a long drive with 20 closures rises once to 4e6 times the start, not twice in a row
    rises = min(step.chi2, step.old.chi2) >= 1e4 * begin and not step.rounds(step.chi2 - begin)
    return stop.grown(step) if rises else None


def turns_back(step: Step) -> stop.Verdict | None:
    """|A (dx + dx_before)| <= 0.2 |A dx|, twice in a row, and chi2 > 0.99 of the lowest: a jump between two points."""
    updates = step.watch.updates
    if len(updates) < 3 or step.sigmas < 0.8 * step.old.sigmas or step.invisible:  # the cheapest first
        return None
    if step.chi2 < 0.99 * min(record.chi2 for record in step.watch.history[:-1]) or any(
        np.linalg.norm(step.system.times(a + b)) > 0.2 * step.sigmas for a, b in pairwise(updates)
    ):
        return None
    reason = f"three steps of {step.sigmas:.2g} sigmas undo each other; max|dx| {step.largest}"
    return stop.Verdict(Status.CYCLING, reason)


def no_new_best(step: Step) -> stop.Verdict | None:
    """No new best for 10 steps."""
    watch = step.watch
    if watch.since_best < 10 or step.invisible:  # pose graphs that converge take up to 4
        return None
    reason = f"no lower chi2 for {watch.since_best} steps; the lowest is {watch.lowest:.6g}, the last {step.chi2:.6g}"
    return stop.Verdict(Status.CYCLING, reason)


class Automatic(Optimizer):
    """Gauss-Newton, with reuse, and dogleg where that fails or does not arrive.

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
        watch.after_a_step = (*stop.OUTCOMES, chi2_rises, turns_back, no_new_best, *stop.LIMITS)
        refusal = None
        try:
            Reusing(self.stop, self.callback).follow(problem, X, system, watch)
        except UnderconstrainedError as error:
            if not watch.step_count:
                raise
            watch.end(Status.DIVERGED, f"the linear system of iteration {watch.step_count + 1} is singular", "singular")
            refusal = error
        if watch.status in FAILED and not watch.halted:
            watch.limit = self.stop.patient.max_iterations or 0
            if watch.step_count < watch.limit:
                watch.resume()
                watch.after_a_step = stop.AFTER_A_STEP
                Dogleg(self.stop, self.callback).follow(problem, watch.best, problem.linearize(watch.best), watch)
        if refusal and not (watch.status is Status.CONVERGED and watch.free is None):
            refusal.values = watch.best
            raise refusal
