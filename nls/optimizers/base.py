"""The interface of optimizers: settings, a loop of its own, and one way to end it that loses no estimate.

A `Watch` follows the steps and asks the stop rules (`nls.optimizers.stop`).
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from models.abstract import Abstract
from models.errors import EvaluationError, OptionError, SingularGeometryError
from nls.linear.factorization import SingularSystemError
from nls.linear.underconstrained import underconstrained
from nls.optimizers import stop
from nls.optimizers.problem import Problem
from nls.optimizers.result import Callback, Iteration, Status
from nls.optimizers.step import Record, Step, Stop
from nls.stages import announce, inside_stage
from nls.system import LinearSystem
from nls.values import Values


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
        self, settings: Stop, callback: Callback | None, values: Values, system: LinearSystem, seconds: dict[str, float]
    ) -> None:
        super().__init__(settings, values, system, seconds)
        self.callback, self.after_a_step = callback, stop.AFTER_A_STEP
        self.latest: Step | None = None
        self.halted = False
        announce(f"iteration 0, chi2 {system.chi2:.6g}")
        self.over(stop.LIMITS, Step(self, values, system, np.zeros(0)))

    def over(self, rules: Sequence[stop.Rule], step: Step) -> bool:
        """Whether the run is over by now; asks some rules about a step."""
        if verdict := stop.ask(rules, step):
            self.end(verdict.status, verdict.reason, verdict.rule)
        return self.status is not None

    def step(self, step: Step, seconds: dict[str, float], damping: float = 0.0, reused: bool = False) -> None:
        """A step was taken: record it, and ask the rules; the rest is for the record."""
        self.note(step, seconds, damping, reused)
        level = step.ending and step.fall >= 0 and step.longer and (step.undamped is None or not step.short)
        self.level_steps = self.level_steps + 1 if level else 0
        self.over(self.after_a_step, step)
        self.call_back()

    def note(self, step: Step, seconds: dict[str, float], damping: float = 0.0, reused: bool = False) -> None:
        """Record a step that was taken."""
        self.latest = step
        self.updates.append(step.dx)
        self.take(Iteration(0, step.chi2, step.update, step.sigmas, damping, seconds, reused), step.values)

    @property
    def last_update(self) -> str:
        """max |dx| of the last step, in words; empty where there was none."""
        return "" if self.latest is None else self.latest.largest

    def call_back(self) -> None:
        """Show the latest step to the callback, which may stop."""
        announce(f"iteration {self.step_count}, chi2 {self.history[-1].chi2:.6g}")
        self.halted = self.callback is not None and bool(self.callback(self.history[-1]))
        if self.halted and self.status is None:
            self.end(Status.STOPPED, f"after {self.step_count} iterations", "callback")

    def reopen(self) -> None:
        """Not over after all, unless the callback or a limit ends it here."""
        self.status, self.reason, self.rule = None, "", ""
        if self.halted:
            self.end(Status.STOPPED, f"after {self.step_count} iterations", "callback")
        elif self.latest is not None:
            self.over(stop.LIMITS, self.latest)


@dataclass(frozen=True)
class Optimizer(Abstract):
    """Settings of an optimizer; subclasses give `iterate`, their algorithm box.

    Parameters
    ----------
    stop : thresholds.
    callback : called with every `Iteration`; returning True stops.
    """

    stop: Stop = field(default_factory=Stop)
    callback: Callback | None = None
    name: ClassVar[str]

    def __post_init__(self) -> None:
        if not isinstance(self.stop, Stop):
            raise OptionError("stop", self.stop, "thresholds such as Stop(max_iterations=20)")
        if not (self.callback is None or callable(self.callback)):
            raise OptionError("callback", self.callback, "a function of an Iteration, or None")

    @abstractmethod
    def iterate(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        """Steps from X, linearized as `system`, until ``watch.status`` is set."""

    def run(self, problem: Problem, values: Values) -> Watch:
        """Iterate from the values until a rule ends it; Ctrl-C ends it too, with the best point so far.

        Inside a `nls.stages.stage` it is a part of something larger, and Ctrl-C ends that.

        Raises
        ------
        UnderconstrainedError
            An undamped step of a singular system; carries the best values so far.
        EvaluationError, SingularGeometryError
            The start itself cannot be evaluated, or a function of the user's raised an exception.
        """
        try:
            system = problem.linearize(values)
        except EvaluationError as error:
            error.iteration = 0
            raise
        watch = Watch(self.stop, self.callback, values, system, problem.lap())
        self.follow(problem, values, system, watch)
        return watch

    def follow(self, problem: Problem, X: Values, system: LinearSystem, watch: Watch) -> None:
        """`iterate`, and what goes wrong as a status; raises as `run` does."""
        watch.methods.append(self.name)
        try:
            self.iterate(problem, X, system, watch)
            if problem.solver.shortest:
                watch.free = problem.singular(watch.best)
            if watch.status is Status.CONVERGED and not problem.solver.exact:
                system = problem.linearize(watch.best)  # asked again: the linear solver may have left something
                step = Step(watch, watch.best, system, np.zeros(0), words=problem.analysis.description)
                watch.over(stop.AT_THE_END, step)
        except SingularSystemError as error:
            system = problem.solver.held_system(problem.latest)
            raise underconstrained(system, watch.best, error, problem.solver) from error
        except (EvaluationError, SingularGeometryError) as error:
            number = watch.step_count + 1
            if isinstance(error, EvaluationError):
                error.iteration = number
            if error.is_fault or (number == 1 and getattr(error, "where", "") == "A'A"):
                raise
            watch.end(Status.DIVERGED, f"the step of iteration {number} led where {error}", "evaluation")
        except KeyboardInterrupt:
            if inside_stage():
                raise
            watch.end(Status.INTERRUPTED, f"after {watch.step_count} iterations", "interrupt")
