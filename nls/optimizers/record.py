"""The memory of one optimization: its history, its best point, and how it ended."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from nls.optimizers.result import Attempt, Iteration

if TYPE_CHECKING:
    from models.algebra import Array
    from nls.optimizers.step import Step
    from nls.optimizers.thresholds import Status
    from nls.system import LinearSystem
    from nls.values import Values

__all__ = ["Record"]


class Record:
    """What happened so far.

    Parameters
    ----------
    values, chi2, seconds : the start.

    Attributes
    ----------
    best, lowest, since_best : values of lowest chi2 so far, that chi2, and steps since then.
    history : one `Iteration` per step of the present method, the point it began from first.
    methods, attempts, earlier : names so far; those that failed, and their records.
    status, reason, rule : None and empty until it is over.
    fall, level_steps : of the last step; steps in a row that ran along a plateau.
    latest : the last step that was taken.
    free : a damped method ended on this singular system; None when nothing is free, or nobody looked.
    """

    def __init__(self, values: Values, chi2: float, seconds: dict[str, float]) -> None:
        self.methods, self.attempts, self.earlier = list[str](), list[Attempt](), list[Iteration]()
        self.history = [Iteration(0, chi2, seconds=seconds)]
        self.best, self.lowest = values, chi2
        self.status: Status | None = None
        self.reason = self.rule = ""
        self.latest: Step | None = None
        self.free: LinearSystem | None = None
        self._begin()

    def _begin(self) -> None:
        """Nothing is known but the best point."""
        self.start, self.since_best, self.fall, self.level_steps = self.best, 0, math.inf, 0
        self._longest: Array | float = 0.0  # column of A of each unknown

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
        self.status, self.reason, self.rule = None, "", ""
        self._begin()

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

    def take(self, step: Step, seconds: dict[str, float], damping: float = 0.0, reused: bool = False) -> None:
        """Record a step, and whether it led to the best point."""
        number, self.latest = self.taken + 1, step
        self.history.append(Iteration(number, step.chi2, step.update, damping=damping, seconds=seconds, reused=reused))
        self.since_best += 1
        if step.chi2 < self.lowest:
            self.best, self.lowest, self.since_best = step.values, step.chi2, 0
