"""Thresholds and limits that end an optimization, and its status."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from enum import Enum
from numbers import Integral, Real
from typing import NamedTuple

from models.errors import OptionError

__all__ = ["Status", "Stop", "Thresholds"]

MOST_STEPS = 100  # of a method; pose graphs that converge take up to 15, a slow public one of 50 poses 145
MOST_STEPS_IN_ALL = 1000  # of the default, where no limit is given


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


class Thresholds(NamedTuple):
    """The thresholds in force; 0 for a rule that is off. These are the ones of a `Stop` to which none is given."""

    update_tol: float = 1e-6
    chi2_rtol: float = 1e-6
    gradient_tol: float = 1e-10


@dataclass(frozen=True)
class Stop:
    """Thresholds and limits that end an optimization; each threshold is documented by its inequality.

    A threshold that is given is the one that stops: the other two are off. Where none is given, all three are in force,
    with the numbers below. An optimization that has reached the last digits of chi2 ends in any case, see
    `nls.optimizers.stop`.

    Parameters
    ----------
    update_tol : converged when max |dx| < update_tol (meters, radians); 1e-6.
    chi2_rtol : converged when four things hold. A step lowers chi2 by no more than chi2_rtol * chi2. The promised
        decrease was at most ten times that. The step was shorter than the one before. The falls, continued as the
        geometric series of the last two, add up to no more than chi2_rtol * chi2 either. 1e-6.
    gradient_tol : converged when the largest cosine between b and a column of A is not above it; 1e-10.
    max_iterations : at most so many steps. When omitted 100; and 1000 in all where no method is named either: the
        default then goes on, damped, from the lowest point of the first 100 (`Automatic`).
    max_seconds : no further step after so many seconds.

    Raises
    ------
    OptionError
        A threshold that is negative or not a number.

    Examples
    --------
    >>> from nls import Stop
    >>> Stop(update_tol=1e-12).in_force
    Thresholds(update_tol=1e-12, chi2_rtol=0.0, gradient_tol=0.0)
    >>> Stop(max_iterations=20).in_force
    Thresholds(update_tol=1e-06, chi2_rtol=1e-06, gradient_tol=1e-10)
    """

    update_tol: float | None = None
    chi2_rtol: float | None = None
    gradient_tol: float | None = None
    max_iterations: int | None = None
    max_seconds: float = math.inf

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if value is None and f.name != "max_seconds":
                continue
            if not isinstance(value, Real) or value != value or value < 0:
                raise OptionError(f.name, value, "a number of at least 0")
            if value == math.inf and f.name in Thresholds._fields:
                raise OptionError(f.name, value, "a finite number: every step is below an infinite one")
        if not isinstance(self.max_iterations, Integral | None):
            raise OptionError("max_iterations", self.max_iterations, "a whole number")

    @property
    def patient(self) -> Stop:
        """As it is; with the limit of all steps of the default where none is given."""
        return self if self.max_iterations is not None else replace(self, max_iterations=MOST_STEPS_IN_ALL)

    @property
    def in_force(self) -> Thresholds:
        """Those given, the others off; all three where none is given."""
        tolerances = self.update_tol, self.chi2_rtol, self.gradient_tol
        if tolerances == (None, None, None):
            return Thresholds()
        return Thresholds(*(threshold or 0.0 for threshold in tolerances))
