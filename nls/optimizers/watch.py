"""The steps of an optimizer, and the stop rules that are asked then (`nls.optimizers.stop`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.algebra import Array
from nls.optimizers import stop
from nls.optimizers.record import Record
from nls.optimizers.result import Callback, Iteration
from nls.optimizers.step import Step
from nls.optimizers.thresholds import Status, Stop
from nls.optimizers.undamped import Undamped
from nls.system import LinearSystem
from nls.values import Values

__all__ = ["Watch"]


class Watch(Record):
    """Records an optimization, and asks the stop rules.

    Parameters
    ----------
    settings : thresholds and limits.
    callback : called with every `Iteration`; returning True stops.
    values, system, seconds : the start.

    Attributes
    ----------
    latest : the last step that was taken.
    halted : whether the callback stops it there.
    after_a_step : rules asked after every step that is taken.
    """

    def __init__(
        self,
        settings: Stop,
        callback: Callback | None,
        values: Values,
        system: LinearSystem,
        seconds: dict[str, float],
    ) -> None:
        super().__init__(settings, values, system.chi2, seconds)
        self.callback, self.after_a_step = callback, stop.AFTER_A_STEP
        self.latest: Step | None = None
        self.halted = False
        self._ask(stop.LIMITS, Step(self, values, system, np.zeros(0)))

    def flat(self, values: Values, system: LinearSystem, dx: Array) -> bool:
        """Whether it is over at the current point, without the step dx."""
        step = Step(self, values, system, dx)
        self.history[-1] = self.history[-1]._replace(gradient=step.slope)
        return self._ask(stop.BEFORE_A_STEP, step)

    def step(
        self,
        values: Values,
        system: LinearSystem,
        dx: Array,
        promised: float,
        seconds: dict[str, float],
        damping: float = 0.0,
        undamped: Undamped | None = None,
        reused: bool = False,
    ) -> None:
        """A step was taken: record it, and ask the rules.

        Parameters
        ----------
        values, system : where it led, and the linearization there.
        dx, promised : the step, and the fall of the linear model's chi2.
        seconds, damping, reused : for the record.
        undamped : for methods that shorten their steps.
        """
        step = Step(self, values, system, dx, promised, undamped=undamped)
        self.note(step, seconds, damping, reused)
        level = step.ending and step.longer and (undamped is None or not step.short)
        self.level_steps, self.fall = self.level_steps + 1 if level else 0, step.fall
        self._ask(self.after_a_step, step)
        self.call_back()

    def note(self, step: Step, seconds: dict[str, float], damping: float = 0.0, reused: bool = False) -> None:
        """Record a step that was taken."""
        self.latest = step
        self.take(Iteration(0, step.chi2, step.update, damping=damping, seconds=seconds, reused=reused), step.values)

    @property
    def last_update(self) -> str:
        """max |dx| of the last step, in words; empty where there was none."""
        return "" if self.latest is None else self.latest.largest

    def call_back(self) -> None:
        """Show the latest step to the callback, which may stop."""
        self.halted = self.callback is not None and bool(self.callback(self.history[-1]))
        if self.halted and self.status is None:
            self.end(Status.STOPPED, f"after {self.step_count} iterations", "callback")

    def reopen(self) -> None:
        """Not over after all, unless the callback or a limit ends it here."""
        self.status, self.reason, self.rule = None, "", ""
        if self.halted:
            self.end(Status.STOPPED, f"after {self.step_count} iterations", "callback")
        elif self.latest is not None:
            self._ask(stop.LIMITS, self.latest)

    def refuse(
        self, values: Values, system: LinearSystem, dx: Array, promised: float, fall: float, undamped: Undamped
    ) -> None:
        """A trial step from the current point was not taken."""
        self._ask(stop.AFTER_A_REFUSAL, Step(self, values, system, dx, promised, fall=fall, undamped=undamped))

    def stall(self, values: Values, system: LinearSystem, chi2: float, led: str) -> None:
        """No shorter step from the current point is left to try.

        Parameters
        ----------
        values, system : the current point.
        chi2 : some way along the undamped step.
        led : where the last step led.
        """
        fall = system.chi2 - chi2
        self._ask(stop.NO_STEP_LEFT, Step(self, values, system, np.zeros(0), fall=fall, words=led))

    def doubt(self, system: LinearSystem, solver: str) -> None:
        """It has converged by the steps of a solver that is not exact: ask again at the best point."""
        self._ask(stop.AT_THE_END, Step(self, self.best, system, np.zeros(0), words=solver))

    def _ask(self, rules: Sequence[stop.Rule], step: Step) -> bool:
        if verdict := stop.ask(rules, step):
            self.end(verdict.status, verdict.reason, verdict.rule)
        return self.status is not None
