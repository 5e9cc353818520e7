r"""Trust regions, Levenberg-Marquardt and dogleg: a step within a radius, tried, and the radius set by its gain.

**Levenberg-Marquardt**: Gauss-Newton steps, damped until they stay within a radius and lower chi2.

    A, b = linearization at X
    dx   = argmin |A dx - b|^2 + lambda |D dx|^2,  lambda the least one with |D dx| <= radius
    gain = (chi2(X) - chi2(X retract dx)) / fall of chi2 in the linear model
    if gain > 0:     X = X retract dx
    if gain > 3/4:   radius = max(radius, 2.5 |D dx|)
    if gain < 1/4:   radius = 0.4 |D dx|
    if gain <= 0:    radius = 0.99 |D x| at most

D^2 is the diagonal of A'A, each entry the largest met so far. So the damping does not depend on units, and an unknown
that loses its influence is held. A refused step bounds the next one by the size |D x| of the estimate.

The radius is met within `BAND`. 1 / |D dx| over lambda is nearly a line. The first trial takes it through 0 and the
step before, as Nielsen and Ceres do: lambda |D dx| / radius. Mostly that suffices, with one factorization a step. Where
it is too short, the undamped step comes next, then the secant. So lambda falls to 0 at once where it can, which a
fixed factor on lambda does not: that solves 51 of the 54 problems of NIST. Sources: D. Marquardt, "An algorithm for
least-squares estimation of nonlinear parameters", 1963; J. More, "The Levenberg-Marquardt algorithm: implementation and
theory", 1978; H. B. Nielsen, "Damping parameter in Marquardt's method", 1999.

A small damped step proves nothing: damping makes every step small. Before the method says converged the undamped step
must agree that chi2 cannot fall. Also chi2 must not curve downward along that step, as at a saddle. Where that system
is singular, something is free: the result then says so in `Result.underconstrained`.

**Powell's dogleg**: the Gauss-Newton step, shortened along a bent path where the linear model is not trusted.

    A, b = linearization at X
    gn   = argmin |A dx - b|                                             Gauss-Newton
    c    = alpha D^-2 A'b,  alpha = |D^-1 A'b|^2 / |A D^-2 A'b|^2        Cauchy: lowest point downhill
    dx   = gn                                    if |D gn| <= radius
           radius c / |D c|                      if |D c| >= radius
           c + beta (gn - c), |D dx| = radius    otherwise
    if chi2(X retract dx) < chi2(X):  X = X retract dx;  radius as in Levenberg-Marquardt

One factorization per linearization, however many steps are tried from it. gn is damped too faintly to matter, except
where the system is singular: there it holds the free directions still, and the result names them. Sources: M. Powell,
"A hybrid method for nonlinear equations", 1970; J. Nocedal, S. Wright, Numerical Optimization, 2006, section 4.1.
"""

import math
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from models.algebra import Array
from models.options import check_between
from nls.linear.factorization import SingularSystemError
from nls.optimizers import stop
from nls.optimizers.base import Optimizer, Watch
from nls.optimizers.problem import FAINT, HOPELESS, Problem, Undamped
from nls.optimizers.result import Status
from nls.optimizers.step import ROUNDING, Step
from nls.system import LinearSystem
from nls.values import Values


class TrustRegion(Optimizer):
    """A method whose steps stay within a radius; subclasses give `within`, their algorithm box."""

    @abstractmethod
    def within(
        self, undamped: Undamped, system: LinearSystem, D: Array, radius: float, damping: float, length: float
    ) -> tuple[Array, float]:
        """A step with |D dx| of about the radius, or the undamped one where that is shorter; and its damping.

        Parameters
        ----------
        undamped, system : what is linearized.
        D, radius : lengths of the columns of A, the largest met of each; the bound.
        damping, length : of the step before, taken or refused: its lambda and its |D dx|.
        """

    def first_damping(self, problem: Problem) -> float:
        """Lambda of the first step."""
        return FAINT

    def iterate(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        undamped = Undamped(problem, self.first_damping(problem))
        radius, damping, length = math.inf, 0.0, 0.0
        if not system.column_norms.any():
            problem.solve(system)  # nothing reacts to anything: refused, with the names of the unknowns
        while watch.status is None:
            D = watch.scale(system)
            dx, damping = self.within(undamped, system, D, radius, damping, length)
            length, promised = float(np.linalg.norm(D * dx)), system.promised(dx)
            if watch.over(stop.BEFORE_A_STEP, Step(watch, X, system, dx, promised, undamped=undamped)):
                break
            Y, trial, led = problem.attempt(X, dx)
            fall = -math.inf if trial is None else system.chi2 - trial.chi2
            if trial is not None and fall > max(1e-4 * promised, 0.0):  # it falls by a part of the promise
                if fall < 0.25 * promised:
                    radius = 0.4 * length
                elif fall > 0.75 * promised:
                    radius = max(radius, 2.5 * length)
                X, system = Y, trial
                watch.step(Step(watch, X, system, dx, promised, undamped=undamped), problem.lap(), damping)
            else:
                size = float(np.linalg.norm(D * problem.pattern.restrict(X.coordinates)))
                # a step as long as |D x| ends at 0
                radius = min(0.6 * radius, 0.4 * length, 0.99 * size or math.inf)
                step = Step(watch, X, system, dx, promised, fall=fall, undamped=undamped)
                watch.over(stop.AFTER_A_REFUSAL, step)
                # where no step is left to try, chi2 is looked at a tenth of |D x| along the undamped one
                if not 1e-16 * (size or length) <= radius < math.inf and watch.status is None:
                    gn = undamped.step(system, D)
                    _, chi2 = problem.glance(X, gn * (0.1 * (size or length) / float(np.linalg.norm(D * gn))))
                    step = Step(watch, X, system, np.zeros(0), fall=system.chi2 - chi2, words=led)
                    watch.over(stop.NO_STEP_LEFT, step)
        if watch.status is Status.CONVERGED:
            gn = undamped.step(system, watch.scale(system), strict=True)
            lower = _below_tangent(problem, X, system, gn, watch)
            if lower is None:
                watch.free = undamped.free
                return
            watch.reopen()
            if watch.status is None:
                Y, trial, dx = lower
                watch.step(Step(watch, Y, trial, dx, system.promised(dx), undamped=undamped), problem.lap())
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


# Parts of the radius between which |D dx| meets it. Below 0.6 the undamped step fits, by a radius grown by 2.5.
BAND = 0.6, 1.2


@dataclass(frozen=True)
class LevenbergMarquardt(TrustRegion):
    """The damped method: for starts far away, projections, residuals with kinks, and systems with free directions.

    Parameters
    ----------
    stop : thresholds; ``max_iterations`` counts the steps that were taken.
    callback : called with every `Iteration`; returning True stops.
    damping : least lambda of the first step, relative to the diagonal of A'A; a tenth of it for each step that
        follows. When omitted 1e-3 where a factor says that undamped steps fail (`Factor.damped`), otherwise none that
        matters: the Gauss-Newton step comes first.

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

    damping: float | None = None
    name = "levenberg-marquardt"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.damping is not None:
            check_between("damping", self.damping, 0, HOPELESS, f"a number above 0 and below {HOPELESS:g}")

    def first_damping(self, problem: Problem) -> float:
        if self.damping is not None:
            return self.damping
        return 1e-3 if any(batch.model.factor.damped for batch in problem.pattern.batches) else FAINT

    def within(
        self, undamped: Undamped, system: LinearSystem, D: Array, radius: float, damping: float, length: float
    ) -> tuple[Array, float]:
        bound = float(np.linalg.norm(system.gradient / D))  # |D dx| <= |D^-1 A'b| / lambda, which it approaches
        below, above, old, old_length = -1.0, max(bound / radius, 1e4 * undamped.damping), 0.0, 0.0
        trial = damping * length / radius if damping > undamped.damping else 0.0
        for _ in range(10):  # trials of lambda: then the step is tried whatever its length
            if not undamped.damping < trial < above:
                dx, damping = undamped.step(system, D), undamped.damping
            else:
                try:
                    dx, damping = undamped.problem.solve(system, trial * D**2), trial
                except SingularSystemError:
                    below, dx, damping = trial, undamped.step(system, D), undamped.damping
            length = float(np.linalg.norm(D * dx))
            if length <= BAND[1] * radius and (damping <= undamped.damping or length >= BAND[0] * radius):
                break
            below, above = (max(below, damping), above) if length > radius else (below, damping)
            if below < 0:
                trial = 0.0  # too short: the undamped step may be within the radius
            elif old_length:
                run, rise = damping - old, 1 / length - 1 / old_length
                trial = damping + (1 / radius - 1 / length) * run / rise if run * rise > 0 else math.nan
            else:
                trial = damping * length / radius if damping > FAINT else bound * (1 / radius - 1 / length)
            if not below < trial < above:
                trial = math.sqrt(max(below, 1e-10 * above) * above)
            if not below < trial < above:
                break
            old, old_length = damping, length
        return dx, damping


class Dogleg(TrustRegion):
    """A trust region whose trials cost no further factorization: for starts far away.

    Parameters
    ----------
    stop : thresholds; ``max_iterations`` counts the steps that were taken.
    callback : called with every `Iteration`; returning True stops.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Factor
    >>> from models import R
    >>> from nls import Dogleg, FactorGraph, Values, kinds
    >>> (p,) = kinds("p")
    >>> rosenbrock = lambda X: np.stack([10 * (X[:, 1] - X[:, 0] ** 2), 1 - X[:, 0]], axis=1)
    >>> graph = FactorGraph([Factor.from_function(rosenbrock, p[0], dim=2)])
    >>> result = graph.optimize(Values({p: (R(2), [-1.2, 1.0])}), Dogleg())
    >>> result.converged, result.values[p[0]].round(6)
    (True, array([1., 1.]))
    """

    name = "dogleg"

    def within(
        self, undamped: Undamped, system: LinearSystem, D: Array, radius: float, damping: float, length: float
    ) -> tuple[Array, float]:
        gn = undamped.step(system, D)
        if float(np.linalg.norm(D * gn)) <= radius:
            return gn, 0.0
        downhill = system.gradient / D**2
        alpha = float(system.gradient @ downhill) / float(np.square(system.times(downhill)).sum())
        c = alpha * downhill
        near = float(np.linalg.norm(D * c))
        if near >= radius:
            return c * (radius / near), 0.0
        p, q = D * c, D * (gn - c)  # |p + beta q|^2 = radius^2, the root between 0 and 1, without cancellation
        a, half, gap = float(q @ q), float(p @ q), radius**2 - float(p @ p)
        root = math.sqrt(half * half + a * gap)
        beta = gap / (half + root) if half > 0 else (root - half) / a
        return np.asarray(c + beta * (gn - c)), 0.0
