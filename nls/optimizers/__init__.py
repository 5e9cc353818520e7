"""Optimizers, one algorithm per file; each reads as its algorithm box."""

from collections.abc import Iterable

from factors.base import Factor
from nls.optimizers.automatic import Automatic
from nls.optimizers.base import Optimizer
from nls.optimizers.gauss_newton import GaussNewton
from nls.optimizers.problem import gauss_newton_step
from nls.optimizers.result import Attempt, Callback, Fit, Iteration, Result, Status
from nls.optimizers.step import Stop
from nls.optimizers.trust_region import Dogleg, LevenbergMarquardt

__all__ = [
    "OPTIMIZERS",
    "Attempt",
    "Automatic",
    "Dogleg",
    "Fit",
    "GaussNewton",
    "Iteration",
    "LevenbergMarquardt",
    "Optimizer",
    "Result",
    "Status",
    "Stop",
    "default_optimizer",
    "gauss_newton_step",
]


def default_optimizer(
    factors: Iterable[Factor], stop: Stop | None = None, callback: Callback | None = None
) -> Optimizer:
    """`Automatic`, or Levenberg-Marquardt where a factor says that undamped steps are known to fail.

    Without a limit of steps both may take 1000 in all.
    """
    stop = stop or Stop()
    if any(factor.damped for factor in factors):
        return LevenbergMarquardt(stop.patient, callback)
    return Automatic(stop, callback)


OPTIMIZERS: dict[str, type[Optimizer]] = {kind.name: kind for kind in (GaussNewton, LevenbergMarquardt, Dogleg)}
