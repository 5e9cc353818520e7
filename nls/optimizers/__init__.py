"""Optimizers, one algorithm per file; each reads as its algorithm box."""

from nls.optimizers.base import Optimizer
from nls.optimizers.dogleg import Dogleg
from nls.optimizers.gauss_newton import GaussNewton
from nls.optimizers.levenberg_marquardt import LevenbergMarquardt
from nls.optimizers.result import Iteration, Result
from nls.optimizers.stop import Status, Stop

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
]

OPTIMIZERS: dict[str, type[Optimizer]] = {
    optimizer.name: optimizer for optimizer in (GaussNewton, LevenbergMarquardt, Dogleg)
}
