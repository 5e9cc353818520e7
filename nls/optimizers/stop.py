"""When an optimization stops, and the sentence it says then."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import Enum
from numbers import Integral, Real

from models.errors import OptionError

__all__ = ["Status", "Stop"]


class Status(Enum):
    """Why an optimization ended; the value is the sentence shown. Only CONVERGED is success."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "the iteration limit was reached before it converged"
    MAX_TIME = "the time limit was reached before it converged"
    STALLED = "no further step lowers chi2 although its gradient is not small"
    CYCLING = "chi2 goes up and down without falling"
    DIVERGED = "chi2 or the update grew beyond bounds or is not finite"
    STOPPED = "stopped by the callback"
    INTERRUPTED = "interrupted by the user"


@dataclass(frozen=True)
class Stop:
    """Thresholds that end an optimization; each is documented by its inequality.

    Parameters
    ----------
    update_tol : converged when max |dx| < update_tol (meters, radians).
    chi2_rtol : converged when an accepted step lowers chi2 by no more than chi2_rtol * chi2, promised to lower it by no
        more than ten times that, and was shorter than the one before; and when the falls, continued as the geometric
        series of the last two, add up to no more than chi2_rtol * chi2 either. Gauss-Newton tries the step that
        confirms it with the factorization of the one before, see the page on optimizers.
    gradient_tol : converged when the largest cosine between b and a column of A is below it.
    max_iterations : at most so many steps.
    max_seconds : no further step after so many seconds.

    Raises
    ------
    OptionError
        A threshold that is negative or not a number.
    """

    update_tol: float = 1e-6
    chi2_rtol: float = 1e-6
    gradient_tol: float = 1e-10
    max_iterations: int = 100
    max_seconds: float = math.inf

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not isinstance(value, Real) or value != value or value < 0:
                raise OptionError(f.name, value, "a number of at least 0")
        if not isinstance(self.max_iterations, Integral):
            raise OptionError("max_iterations", self.max_iterations, "a whole number")
