r"""Gauss-Newton: linearize, solve, retract, stop; alone, or with dogleg after it.

    A, b = linearization at X
    dx   = argmin |A dx - b|
    X    = X retract dx

No damping and no line search: a step may raise chi2 on the way to a lower one (the Intel graph does, and converges).
The best point met is what is returned, and a rise is never called converged. Source: F. Dellaert, M. Kaess, Factor
Graphs for Robot Perception, 2017, section 2.5; the page on least squares in the documentation.

Near the optimum A'A hardly changes. There a step may be taken with the factorization of the step before,

    dx = (L L')^-1 A'b        with the present gradient A'b and the last factorization L

Factorizing A'A is most of an iteration (66 of 85 ms on sphere2500). Such a step is forgotten where A'A has changed, or
where it leads nowhere. The last step is not linearized. The page on optimizers in the documentation has the bounds.

**The optimizer of those who name none**: Gauss-Newton, and dogleg from its best point where that fails.

    run Gauss-Newton, with the last factorization reused near the optimum
    if it diverges, cycles, rises or finds no lower point:   run dogleg from the lowest point
    if it has not arrived after 100 steps, no limit given:   the same, up to 1000 steps in all

Of the two damped methods dogleg is the one with the shorter way from such a point: one factorization an iteration. Who
names a method gets that method alone. The limits of a `Stop` are those of both together.
"""

from dataclasses import dataclass

from models.errors import UnderconstrainedError
from nls.optimizers import stop
from nls.optimizers.base import Optimizer, Watch
from nls.optimizers.problem import Problem
from nls.optimizers.result import Status
from nls.optimizers.step import ROUNDING, SHORTER, Step
from nls.optimizers.stop import ask, relative_decrease
from nls.optimizers.trust_region import Dogleg
from nls.system import LinearSystem
from nls.values import Values


@dataclass(frozen=True)
class GaussNewton(Optimizer):
    """The undamped method, one factorization an iteration.

    Parameters
    ----------
    stop : thresholds.
    callback : called with every `Iteration`; returning True stops.
    reuse : try the last steps, which gain little, with the factorization of the step before.

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


def reused(problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> tuple[Values, LinearSystem] | None:
    """Where the step of the kept factorization leads, and the system there; None where it is not to be taken."""
    dx = problem.solve_again(system) if _nearly(watch) else None
    if dx is None:
        return None
    promised, downhill = system.promised(dx), float(dx @ system.gradient)  # equal, had A'A not changed
    last = promised <= watch.tol.chi2_rtol * system.chi2
    # The change of A'A along the step is 0.0001 to 0.1 where pose graphs arrive, 0.8 to 0.95 on a plateau without end.
    changed = abs(promised - downhill) >= (0.5 if last else 0.1) * downhill
    if changed or not _small(promised, watch):
        return None
    if last:
        Y, chi2 = problem.glance(X, dx)
        return (Y, system) if _ends(Step(watch, Y, system, dx, promised, chi2), problem, watch) else None
    Y, trial, _ = problem.attempt(X, dx)
    if trial is None:
        return None
    watch.step(Y, trial, dx, promised, problem.lap(), reused=True)
    return Y, trial


def _nearly(watch: Watch) -> bool:
    """Whether little is left to gain, if the next step gets shorter as the latest did; chi2 falls by its square.

    After a first step that gained little there is less to gain: it began near the optimum.
    """
    if len(watch.history) < 3:
        return len(watch.history) == 2 and _small(watch.fall, watch)
    before, update = watch.history[-2].update, watch.history[-1].update
    return update < SHORTER * before and _small(watch.fall * (update / before) ** 2 / 10, watch)


def _small(fall: float, watch: Watch) -> bool:
    """Whether a fall of chi2 is hardly more than what counts as none."""
    # ten times chi2_rtol is not worth a factorization
    return 0 <= fall <= 10 * watch.tol.chi2_rtol * watch.history[-1].chi2


def _ends(step: Step, problem: Problem, watch: Watch) -> bool:
    """Take a step that ends the optimization; it is forgotten where it does not. Its system is the one before it."""
    # ten times the fall: the last step is then taken in the ordinary way
    missed = step.promised > 10 * max(step.fall, ROUNDING * step.chi2) and not step.invisible
    verdict = None if missed else ask((relative_decrease,), step)
    if verdict is None:
        return False
    watch.note(step, problem.lap(), reused=True)
    watch.end(verdict.status, verdict.reason, verdict.rule)
    watch.call_back()
    return True


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
