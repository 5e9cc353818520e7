"""Optimizers, one algorithm per file; each reads as its algorithm box."""

from nls.optimizers.gauss_newton import GaussNewton
from nls.optimizers.result import Iteration, Result
from nls.optimizers.stop import Status, Stop

__all__ = ["GaussNewton", "Iteration", "Result", "Status", "Stop"]
