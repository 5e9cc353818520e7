r"""Gauss-Newton: linearize, solve, retract, stop.

    A, b = linearization at X
    dx   = argmin |A dx - b|
    X    = X retract dx

No damping and no line search: a step may raise chi2 on the way to a lower one (the Intel graph does, and converges).
The best point met is what is returned, and a rise is never called converged.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from models.errors import EvaluationError
from nls.diagnose import underconstrained
from nls.linear.base import SingularSystemError
from nls.optimizers.result import Iteration
from nls.optimizers.stop import Status, Stop

if TYPE_CHECKING:
    from nls.optimizers.problem import Problem
    from nls.values import Values

__all__ = ["GaussNewton"]

BOUND = 1e12  # growth of chi2 over the start, or a step in meters or radians, that no problem of ours comes back from
PATIENCE = 10  # steps without a new best before a return to an earlier chi2 counts as a cycle


@dataclass(frozen=True)
class GaussNewton:
    """The undamped method.

    Parameters
    ----------
    stop : thresholds.
    callback : called with every `Iteration`; returning True stops.
    """

    stop: Stop = field(default_factory=Stop)
    callback: Callable[[Iteration], bool | None] | None = None
    name = "gauss-newton"

    def run(self, problem: Problem, values: Values) -> tuple[Values, Status, str, list[Iteration]]:
        """Iterate from the values; returns the best values, the status, its sentence and the history.

        Raises
        ------
        UnderconstrainedError
            A singular system; carries the best values so far.
        EvaluationError
            The start itself cannot be evaluated.
        """
        stop, began = self.stop, perf_counter()
        X = best = values
        system = problem.linearize(X)
        history = [Iteration(0, system.chi2, seconds=problem.lap())]
        lowest = system.chi2
        since_best = 0
        try:
            while True:
                old = history[-1]
                if old.number >= stop.max_iterations:
                    return best, Status.MAX_ITERATIONS, f"after {old.number} iterations", history
                if perf_counter() - began > stop.max_seconds:
                    return best, Status.MAX_TIME, f"after {perf_counter() - began:.1f} s", history
                dx = problem.solve(system)
                if system.scaled_gradient <= stop.gradient_tol or system.chi2 == 0.0:
                    return best, *_settled(f"scaled gradient {system.scaled_gradient:.1e}", old, lowest), history
                update = float(np.abs(dx).max(initial=0.0))
                if not update < BOUND:
                    return best, Status.DIVERGED, f"the update of iteration {old.number + 1} is {update:.3g}", history
                X = problem.retract(X, dx)
                last = update < stop.update_tol
                chi2 = problem.chi2(X) if last else (system := problem.linearize(X)).chi2
                new = Iteration(old.number + 1, chi2, update, seconds=problem.lap())
                history.append(new)
                since_best += 1
                if chi2 < lowest:
                    best, lowest, since_best = X, chi2, 0
                if self.callback is not None and self.callback(new):
                    return best, Status.STOPPED, f"after {new.number} iterations", history
                if last:
                    return best, *_settled(f"max|dx| = {update:.1e} < {stop.update_tol:g}", new, lowest), history
                if not chi2 < BOUND * max(history[0].chi2, 1.0):
                    return best, Status.DIVERGED, f"chi2 is {chi2:.3g} after {history[0].chi2:.3g}", history
                if 0 <= old.chi2 - chi2 <= stop.chi2_rtol * old.chi2:
                    fall = (old.chi2 - chi2) / old.chi2
                    return (
                        best,
                        *_settled(f"chi2 fell by {fall:.1e} of itself <= {stop.chi2_rtol:g}", new, lowest),
                        history,
                    )
                if since_best >= PATIENCE and any(abs(chi2 - h.chi2) <= 1e-6 * chi2 for h in history[-PATIENCE:-1]):
                    return best, Status.CYCLING, f"chi2 {chi2:.6g} was met before; the lowest is {lowest:.6g}", history
        except SingularSystemError as error:
            raise underconstrained(problem.pattern, system, best) from error
        except KeyboardInterrupt:
            return best, Status.INTERRUPTED, f"after {len(history) - 1} iterations", history
        except EvaluationError as error:
            return best, Status.DIVERGED, f"iteration {len(history)}: {error}", history


def _settled(rule: str, last: Iteration, lowest: float) -> tuple[Status, str]:
    """CONVERGED where the last point is the best one up to rounding; settling above it is not."""
    if last.chi2 <= lowest + 1e-9 * abs(lowest) + 1e-300:
        return Status.CONVERGED, rule
    return Status.STALLED, f"{rule}, but at chi2 {last.chi2:.6g}, above the {lowest:.6g} met before, which is returned"
