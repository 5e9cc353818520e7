"""A step as the stop rules see it: its numbers, and the judgments that several rules share."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from models.algebra import Array
from nls.optimizers.record import Record
from nls.optimizers.undamped import Undamped
from nls.system import LinearSystem
from nls.values import Values

SHORTER = 0.99  # an estimate that arrives takes steps that get shorter; on a plateau they do not
SHORT = 0.01  # of the estimate, |D x|: an undamped step longer than that has not arrived, however little chi2 falls
FARTHER = 10  # times update_tol: how far the undamped step may still lead when a damped one is shorter than that
MISSED = 10  # a step that promised so many times the fall it brought has not converged, it has missed
UNDAMPED = 10  # times chi2_rtol: the fall that the undamped step may still promise when a damped one brings less
ROUNDING = 1e-9  # relative difference of chi2 that is no difference
EPS = 1e-15  # relative rounding of an error: of the numbers whose difference it is


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
        self.old, self.old_fall, self.tol = watch.history[-1], watch.fall, watch.tol
        self.update = float(np.abs(dx).max(initial=0.0))
        self.fall = self.old.chi2 - self.chi2 if fall is None else fall

    @cached_property
    def largest(self) -> str:
        """max |dx| with its unit, component and variable."""
        key, component = self.system.column(int(np.argmax(np.abs(self.dx))))
        manifold = self.values.stack(key.kind).manifold
        unit = manifold.units[manifold.components.index(component)]
        return f"{self.update:.1e} {unit} ({component} of {key})".replace("  ", " ")

    @property
    def shorter(self) -> bool:
        """Whether max|dx| is below that of the step before; False for the first one."""
        return self.update < SHORTER * self.old.update

    @property
    def longer(self) -> bool:
        """Whether it is not; False for the first one, too."""
        return self.update >= SHORTER * self.old.update

    @property
    def still(self) -> bool:
        """max|dx| < update_tol."""
        return self.update < self.tol.update_tol

    @property
    def little(self) -> float:
        """The fall of chi2 that counts as none."""
        return self.tol.chi2_rtol * self.old.chi2

    @cached_property
    def missed(self) -> bool:
        """Whether an undamped step promised a much larger fall than it brought."""
        much = self.undamped is None and self.promised > MISSED * max(self.fall, self.little)
        return much and not self.invisible

    @cached_property
    def ending(self) -> bool:
        """Whether this fall, and all that follow it as a geometric series, are no more than little."""
        level = 0 <= self.fall <= self.little and not self.missed
        return level and (
            self.fall <= ROUNDING * self.chi2 or self.fall <= self.little * ((self.old_fall - self.fall) / self.fall)
        )

    @cached_property
    def slope(self) -> float:
        """The scaled gradient of the system."""
        return self.system.scaled_gradient

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
        error = EPS * max(b, float((system.column_norms * x).max(initial=0.0)))
        return change <= max((2 * b + error) * error, (EPS * system.pattern.largest_measurement) ** 2)

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
        return (self.undamped is None or update <= FARTHER * self.tol.update_tol) and self._short(self._full)

    @property
    def agreed(self) -> bool:
        """Whether the undamped step promises no fall worth it and leads nowhere else."""
        if self.undamped is not None:
            promised = float(self._full @ self.system.gradient)
            if promised > UNDAMPED * self.tol.chi2_rtol * self.system.chi2 and not self.rounds(promised):
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
        D = self.watch.scale(self.system)
        length, start = np.linalg.norm(D * dx), D * self.system.pattern.restrict(self.watch.start)
        return bool(length <= SHORT * np.linalg.norm(start) or length <= SHORT * np.linalg.norm(D * self._coordinates))
