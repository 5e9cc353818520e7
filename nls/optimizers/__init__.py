"""Optimizers, one algorithm per file; each reads as its algorithm box."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from nls.optimizers.base import Optimizer
from nls.optimizers.dogleg import Dogleg
from nls.optimizers.gauss_newton import GaussNewton
from nls.optimizers.levenberg_marquardt import LevenbergMarquardt
from nls.optimizers.problem import gauss_newton_step
from nls.optimizers.result import Iteration, Result
from nls.optimizers.stop import Status, Stop

if TYPE_CHECKING:
    from factors.base import Factor

__all__ = [
    "OPTIMIZERS",
    "Dogleg",
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


def default_optimizer(factors: Iterable[Factor]) -> type[Optimizer]:
    """Gauss-Newton, or Levenberg-Marquardt where a factor says that undamped steps are known to fail."""
    return LevenbergMarquardt if any(factor.damped for factor in factors) else GaussNewton


OPTIMIZERS: dict[str, type[Optimizer]] = {
    optimizer.name: optimizer for optimizer in (GaussNewton, LevenbergMarquardt, Dogleg)
}
