"""Thresholds, the record of a run, and a step: the subjects of the stop rules (`nls.optimizers.stop`)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, fields, replace
from functools import cached_property
from numbers import Integral, Real
from time import perf_counter

import numpy as np

from models.algebra import Array
from models.errors import OptionError
from nls.optimizers.problem import Undamped
from nls.optimizers.result import Attempt, Iteration, Status
from nls.system import LinearSystem
from nls.values import Values


@dataclass(frozen=True)
class Stop:
    """Thresholds and limits that end an optimization.

    The update is measured in sigmas: |A dx| is its length in units of its own uncertainty, and |A dx|^2 is what chi2
    falls by. dx is the undamped step. A threshold that is given is the one that stops: the others are off. Where chi2
    has no digits left an optimization ends in any case, see `nls.optimizers.stop`.

    Parameters
    ----------
    update_sigmas : converged when |A dx| <= update_sigmas sqrt(min(chi2, max(dof, 1))), and when the steps to come,
        continued as the geometric series of the last two, add up to no more than that either. 1e-3 where no threshold
        is given. Source: D. Bates, D. Watts, "A relative offset orthogonality convergence criterion for nonlinear least
        squares", Technometrics 23(2), 1981.
    update_tol : converged when max |dx| < update_tol (meters, radians).
    chi2_rtol : converged when |A dx|^2 <= chi2_rtol chi2, and the steps to come likewise.
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
    >>> Stop().sigmas(chi2=400.0, dof=100)
    0.01
    >>> Stop(chi2_rtol=1e-4).sigmas(chi2=400.0, dof=100)
    0.2
    >>> Stop(update_tol=1e-9).sigmas(chi2=400.0, dof=100)
    0.0
    """

    update_sigmas: float | None = None
    update_tol: float | None = None
    chi2_rtol: float | None = None
    max_iterations: int | None = None
    max_seconds: float = math.inf

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if value is None and f.name != "max_seconds":
                continue
            if not isinstance(value, Real) or value != value or value < 0:
                raise OptionError(f.name, value, "a number of at least 0")
            if value == math.inf and f.name in ("update_sigmas", "update_tol", "chi2_rtol"):
                raise OptionError(f.name, value, "a finite number: every step is below an infinite one")
        if not isinstance(self.max_iterations, Integral | None):
            raise OptionError("max_iterations", self.max_iterations, "a whole number")

    @property
    def patient(self) -> Stop:
        """Thresholds as they are; with the limit of all steps of the default where none is given."""
        return self if self.max_iterations is not None else replace(self, max_iterations=1000)  # in all

    def sigmas(self, chi2: float, dof: int) -> float:
        """The largest |A dx| of a step that ends it; 0 where only `update_tol` does."""
        return max(self.share * math.sqrt(min(chi2, max(dof, 1))), math.sqrt((self.chi2_rtol or 0.0) * chi2))

    @property
    def share(self) -> float:
        """The `update_sigmas` in force: 1e-3 where no threshold is given."""
        given = self.update_sigmas, self.update_tol, self.chi2_rtol
        return 1e-3 if given == (None, None, None) else self.update_sigmas or 0.0


class Record:
    """The run so far.

    Parameters
    ----------
    stop : thresholds and limits.
    values, system, seconds : the start.

    Attributes
    ----------
    limit, began, dof : steps at most; when it began; measurements minus unknowns.
    chi2_initial, start : of the start; its coordinates.
    best, lowest, since_best : values of lowest chi2 so far, that chi2, and steps since then.
    history : one `Iteration` per step of the present method, the point it began from first.
    methods, attempts, earlier : names so far; those that failed, and their records.
    status, reason, rule : None and empty until it is over.
    level_steps : steps in a row that ran along a plateau.
    updates : dx of the last three steps.
    free : a damped method or the shortest step ended on this singular system; None when nothing is free, or nobody
        looked.
    """

    def __init__(self, stop: Stop, values: Values, system: LinearSystem, seconds: dict[str, float]) -> None:
        self.stop, self.began, self.dof = stop, perf_counter(), system.pattern.measured_rows - system.pattern.n
        # pose graphs that converge take up to 15, a slow public one of 50 poses 145
        self.limit = 100 if stop.max_iterations is None else stop.max_iterations
        self.methods, self.attempts, self.earlier = list[str](), list[Attempt](), list[Iteration]()
        self.history = [Iteration(0, system.chi2, seconds=seconds)]
        self.best, self.lowest, self.chi2_initial = values, system.chi2, system.chi2
        self.start = values.coordinates
        self.status: Status | None = None
        self.reason = self.rule = ""
        self.free: LinearSystem | None = None
        self._begin()

    def _begin(self) -> None:
        """Nothing is known but the best point."""
        self.since_best = self.level_steps = 0
        self.updates = deque[Array](maxlen=3)
        self._longest: Array | float = 0.0  # column of A of each unknown

    @property
    def step_count(self) -> int:
        """Steps so far."""
        return self.history[-1].number

    @property
    def records(self) -> list[Iteration]:
        """The history of all methods."""
        return self.earlier + self.history[bool(self.earlier) :]

    def resume(self) -> None:
        """Another method continues from the best point; it knows nothing of the one before."""
        assert self.status is not None
        self.attempts.append(Attempt(self.methods[-1], self.status, self.reason, self.step_count))
        self.earlier, self.history = self.records, [Iteration(self.step_count, self.lowest)]
        self.status, self.reason, self.rule = None, "", ""
        self._begin()

    def end(self, status: Status, reason: str, rule: str = "") -> None:
        """End the run."""
        self.status, self.reason, self.rule = status, reason, rule

    def scaled(self, system: LinearSystem) -> Array:
        """Lengths of the columns of A (n,), the largest met of each."""
        self._longest = np.maximum(self._longest, system.column_norms)
        return self._longest

    def scale(self, system: LinearSystem) -> Array:
        """Lengths of the columns of A as in `scaled`, and 1 where no measurement has reacted."""
        longest = self.scaled(system)
        return np.where(longest > 0, longest, 1.0)

    def take(self, new: Iteration, values: Values) -> None:
        """Record a step, and whether it led to the best point; its number follows from the record."""
        self.history.append(new._replace(number=self.step_count + 1))
        self.since_best += 1
        if new.chi2 < self.lowest:
            self.best, self.lowest, self.since_best = values, new.chi2, 0


SHORTER = 0.99  # an estimate that arrives takes steps that get shorter; on a plateau they do not
# Of the estimate, |D x|: an undamped step longer than that has not arrived, however little chi2 falls.
SHORT_OF_ESTIMATE = 0.01
ROUNDING = 1e-9  # relative difference of chi2 that is no difference
ROUNDING_OF_ERROR = 1e-15  # relative rounding of an error: of the numbers whose difference it is


class Step:
    """A step that was taken, one that was refused, or the one about to be taken.

    Parameters
    ----------
    watch : the optimization so far; its last record is the point before the step.
    values, system : where the step led; where it was refused or is still to be taken, the point it starts from.
    dx, promised : the step, and the fall of the linear model's chi2.
    chi2 : where the step led; that of the system when omitted.
    fall : of chi2; from the record before to chi2 when omitted.
    undamped : for methods that shorten their steps: a short one proves nothing, this has to agree.
    words : for the verdict: where a trial step led, or which linear solver ran.

    Attributes
    ----------
    sigmas : |A dx|, where dx is the undamped step; else the root of what is promised.
    shorter, longer : max|dx| is below that of the step before; it is not. For the first step neither.
    still : max|dx| < update_tol.
    """

    def __init__(
        self,
        watch: Record,
        values: Values,
        system: LinearSystem,
        dx: Array,
        promised: float = 0.0,
        chi2: float | None = None,
        fall: float | None = None,
        undamped: Undamped | None = None,
        words: str = "",
    ) -> None:
        self.watch, self.values, self.system, self.dx, self.promised = watch, values, system, dx, promised
        self.chi2, self.undamped, self.words = system.chi2 if chi2 is None else chi2, undamped, words
        self.sigmas = math.sqrt(max(promised, 0.0))
        self.old = watch.history[-1]
        self.update = float(np.abs(dx).max(initial=0.0))
        self.fall = self.old.chi2 - self.chi2 if fall is None else fall
        self.shorter = self.update < SHORTER * self.old.update
        self.longer = self.update >= SHORTER * self.old.update
        self.still = self.update < (watch.stop.update_tol or 0.0)

    @cached_property
    def tolerance(self) -> float:
        """The largest |A dx| that ends it."""
        return self.watch.stop.sigmas(self.old.chi2, self.watch.dof)

    @cached_property
    def largest(self) -> str:
        """max |dx| with its unit, component and variable."""
        key, component = self.system.column(int(np.argmax(np.abs(self.dx))))
        manifold = self.values.stack(key.kind).manifold
        unit = manifold.units[manifold.components.index(component)]
        return f"{self.update:.1e} {unit} ({component} of {key})".replace("  ", " ")

    @property
    def sigmas_to_come(self) -> float:
        """Sum of |A dx| of the steps to come, as a geometric series of the last two; 0 where these do not shrink."""
        s, before = self.sigmas, self.old.sigmas
        return s * s / (before - s) if s < before else 0.0

    @property
    def ending(self) -> bool:
        """Whether |A dx|, and all steps that follow as a geometric series of the last two, are within the tolerance."""
        s = self.sigmas
        return s <= self.tolerance and s < self.old.sigmas and self.sigmas_to_come <= self.tolerance

    @cached_property
    def invisible(self) -> bool:
        """Whether the promise is within the rounding of chi2."""
        return self.rounds(self.promised)

    def rounds(self, change: float) -> bool:
        """Whether rounding may change chi2 by as much: b is a difference of numbers as large as |A_k| |x_k|.

        Where the fit is perfect b is rounding alone, of numbers as large as |W z|.
        """
        system = self.system
        b, x = math.sqrt(system.chi2), np.abs(self._coordinates)
        error = ROUNDING_OF_ERROR * max(b, float((system.column_norms * x).max(initial=0.0)))
        return change <= max((2 * b + error) * error, (ROUNDING_OF_ERROR * system.pattern.largest_measurement) ** 2)

    @cached_property
    def short(self) -> bool:
        """Whether dx is short beside the estimate, or the start: a minimum is near, and no plateau that goes on."""
        return self._short(self.dx)

    @cached_property
    def _full(self) -> Array:
        """The step without damping; dx where it has none."""
        if self.undamped is None:
            return self.dx
        return self.undamped.step(self.system, self.watch.scale(self.system), strict=True)

    @property
    def free(self) -> bool:
        """Whether the undamped system is singular: along what is free any length of a step is as good."""
        return self.undamped is not None and self._full.size > 0 and self.undamped.free is not None

    @property
    def near(self) -> bool:
        """Whether the undamped step is short as well; where something is free, its length says nothing."""
        if self.free:
            return self.agreed
        update = float(np.abs(self._full).max(initial=0.0))
        # an undamped step of a damped method may lead 10 times as far
        return (self.undamped is None or update <= 10 * (self.watch.stop.update_tol or 0.0)) and self._short(self._full)

    @cached_property
    def agreed(self) -> bool:
        """Whether the undamped step promises no fall worth it and leads nowhere else."""
        if self.undamped is not None:
            promised = float(self._full @ self.system.gradient)
            if promised > self.tolerance**2 and not self.rounds(promised):
                return False
        return self.free or self._short(self._full)

    @property
    def leaves(self) -> bool:
        """Whether dx is long, and not along something free."""
        return not self.short and not self.free

    @cached_property
    def _coordinates(self) -> Array:
        return self.system.pattern.restrict(self.values.coordinates)

    def _short(self, dx: Array) -> bool:
        D, start = self.watch.scale(self.system), self.system.pattern.restrict(self.watch.start)
        length, *sizes = (float(v.dot(v)) for v in (D * dx, D * start, D * self._coordinates))
        return length <= SHORT_OF_ESTIMATE**2 * max(sizes)
