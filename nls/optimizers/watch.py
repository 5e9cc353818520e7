"""The memory of one optimization: its history and its best point. The stop rules are in `nls.optimizers.stop`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from nls.optimizers import refusal, stop
from nls.optimizers.result import Attempt, Iteration
from nls.optimizers.step import Step
from nls.optimizers.thresholds import Status, Stop

if TYPE_CHECKING:
    from models.algebra import Array
    from nls.optimizers.undamped import Undamped
    from nls.system import LinearSystem
    from nls.values import Values

__all__ = ["Watch"]


class Watch:
    """Follows an optimizer step by step, and asks the stop stop.

    Parameters
    ----------
    settings : thresholds and limits.
    callback : called with every `Iteration`; returning True stops.
    values, system, seconds : the start.
    after_a_step : rules asked after every step that is taken.

    Attributes
    ----------
    best, lowest, since_best : values of lowest chi2 so far, that chi2, and steps since then.
    history : one `Iteration` per step of the present method, the point it began from first.
    methods, attempts, earlier : names so far; those that failed, and their records.
    status, reason, rule : None and empty until it is over.
    tol : the thresholds in force.
    fall, level_steps : of the last step; steps in a row that ran along a plateau.
    latest : the last step that was taken.
    free : a damped method ended on this singular system; None when nothing is free, or nobody looked.
    """

    def __init__(
        self,
        settings: Stop,
        callback: Callable[[Iteration], bool | None] | None,
        values: Values,
        system: LinearSystem,
        seconds: dict[str, float],
        after_a_step: Sequence[stop.Rule] = stop.AFTER_A_STEP,
    ) -> None:
        self.stop, self.callback, self.tol, self.began = settings, callback, settings.in_force, perf_counter()
        self.after_a_step = after_a_step
        self.methods, self.attempts, self.earlier = list[str](), list[Attempt](), list[Iteration]()
        self.history = [Iteration(0, system.chi2, seconds=seconds)]
        self.start = self.best = values
        self.lowest, self.since_best = system.chi2, 0
        self.fall, self.level_steps = math.inf, 0
        self.status: Status | None = None
        self.reason = self.rule = ""
        self.latest: Step | None = None
        self.free: LinearSystem | None = None
        self._longest: Array | float = 0.0  # column of A of each unknown
        self._ask(stop.LIMITS, Step(self, values, system, np.zeros(0)))

    @property
    def taken(self) -> int:
        """Steps so far."""
        return self.history[-1].number

    @property
    def last_update(self) -> str:
        """max |dx| of the last step, in words; empty where there was none."""
        return "" if self.latest is None else self.latest.largest

    @property
    def records(self) -> list[Iteration]:
        """The history of all methods."""
        return self.earlier + self.history[bool(self.earlier) :]

    def resume(self) -> None:
        """Another method continues from the best point; it knows nothing of the one before."""
        assert self.status is not None
        self.attempts.append(Attempt(self.methods[-1], self.status, self.reason, self.taken))
        self.earlier, self.history = self.records, [Iteration(self.taken, self.lowest)]
        self.after_a_step, self.start, self._longest = stop.AFTER_A_STEP, self.best, 0.0
        self.since_best, self.fall, self.level_steps = 0, math.inf, 0
        self.status, self.reason, self.rule = None, "", ""

    def end(self, status: Status, reason: str, rule: str = "") -> None:
        """It is over."""
        self.status, self.reason, self.rule = status, reason, rule

    def scaled(self, system: LinearSystem) -> Array:
        """Lengths of the columns of A (n,), the largest met of each."""
        self._longest = np.maximum(self._longest, system.column_norms)
        return self._longest

    def scale(self, system: LinearSystem) -> Array:
        """The same, and 1 where none has reacted."""
        longest = self.scaled(system)
        return np.where(longest > 0, longest, 1.0)

    def flat(self, values: Values, system: LinearSystem, dx: Array) -> bool:
        """Whether it is over at the current point, without the step dx."""
        step = Step(self, values, system, dx)
        self.history[-1] = replace(self.history[-1], gradient=step.slope)
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
        """A step was taken: record it, and ask the stop.

        Parameters
        ----------
        values, system : where it led, and the linearization there.
        dx, promised : the step, and the fall of the linear model's chi2.
        seconds, damping, reused : for the record.
        undamped : for methods that shorten their steps.
        """
        step = Step(self, values, system, dx, promised, undamped=undamped)
        self.take(step, seconds, damping, reused)
        level = step.ending and step.longer and (undamped is None or not step.short)
        self.level_steps, self.fall = self.level_steps + 1 if level else 0, step.fall
        self._ask(self.after_a_step, step)
        self.call_back()

    def take(self, step: Step, seconds: dict[str, float], damping: float = 0.0, reused: bool = False) -> None:
        """Record a step, and whether it led to the best point."""
        number, self.latest = self.taken + 1, step
        self.history.append(Iteration(number, step.chi2, step.update, damping=damping, seconds=seconds, reused=reused))
        self.since_best += 1
        if step.chi2 < self.lowest:
            self.best, self.lowest, self.since_best = step.values, step.chi2, 0

    def call_back(self) -> None:
        """Show the latest step to the callback, which may stop."""
        if self.callback is not None and self.callback(self.history[-1]) and self.status is None:
            self.end(Status.STOPPED, f"after {self.taken} iterations", "callback")

    def refuse(
        self, values: Values, system: LinearSystem, dx: Array, promised: float, fall: float, undamped: Undamped
    ) -> None:
        """A trial step from the current point was not taken."""
        self._ask(refusal.AFTER_A_REFUSAL, Step(self, values, system, dx, promised, fall=fall, undamped=undamped))

    def stall(self, values: Values, system: LinearSystem, chi2: float, led: str) -> None:
        """No shorter step from the current point is left to try.

        Parameters
        ----------
        values, system : the current point.
        chi2 : some way along the undamped step.
        led : where the last step led.
        """
        fall = system.chi2 - chi2
        self._ask(refusal.NO_STEP_LEFT, Step(self, values, system, np.zeros(0), fall=fall, words=led))

    def doubt(self, system: LinearSystem, solver: str) -> None:
        """It has converged by the steps of a solver that is not exact: ask again at the best point."""
        self._ask(stop.AT_THE_END, Step(self, self.best, system, np.zeros(0), words=solver))

    def _ask(self, asked: Sequence[stop.Rule], step: Step) -> bool:
        if verdict := stop.ask(asked, step):
            self.end(verdict.status, verdict.reason, verdict.rule)
        return self.status is not None
