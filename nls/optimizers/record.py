"""The memory of one optimization: its history, its best point, and how it ended."""

from __future__ import annotations

import math
from time import perf_counter

import numpy as np

from models.algebra import Array
from nls.optimizers.result import Attempt, Iteration
from nls.optimizers.thresholds import MOST_STEPS, Status, Stop
from nls.system import LinearSystem
from nls.values import Values


class Record:
    """What happened so far.

    Parameters
    ----------
    settings : thresholds and limits.
    values, chi2, seconds : the start.

    Attributes
    ----------
    stop, tol, limit, began : the settings; the thresholds in force; steps at most; when it began.
    best, lowest, since_best : values of lowest chi2 so far, that chi2, and steps since then.
    history : one `Iteration` per step of the present method, the point it began from first.
    methods, attempts, earlier : names so far; those that failed, and their records.
    start : coordinates of the point the present method began from.
    status, reason, rule : None and empty until it is over.
    fall, level_steps : of the last step; steps in a row that ran along a plateau.
    free : a damped method or the shortest step ended on this singular system; None when nothing is free, or nobody
        looked.
    """

    def __init__(self, settings: Stop, values: Values, chi2: float, seconds: dict[str, float]) -> None:
        self.stop, self.tol, self.began = settings, settings.in_force, perf_counter()
        self.limit = MOST_STEPS if settings.max_iterations is None else settings.max_iterations
        self.methods, self.attempts, self.earlier = list[str](), list[Attempt](), list[Iteration]()
        self.history = [Iteration(0, chi2, seconds=seconds)]
        self.best, self.lowest = values, chi2
        self.status: Status | None = None
        self.reason = self.rule = ""
        self.free: LinearSystem | None = None
        self._begin()

    def _begin(self) -> None:
        """Nothing is known but the best point."""
        self.start, self.since_best, self.fall, self.level_steps = self.best.coordinates, 0, math.inf, 0
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

    def take(self, new: Iteration, values: Values) -> None:
        """Record a step, and whether it led to the best point; its number follows from the record."""
        self.history.append(new._replace(number=self.step_count + 1))
        self.since_best += 1
        if new.chi2 < self.lowest:
            self.best, self.lowest, self.since_best = values, new.chi2, 0
