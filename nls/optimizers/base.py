"""The interface of optimizers: settings, a loop of its own, and one way to end it that loses no estimate."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

from models.abstract import Abstract
from models.errors import EvaluationError, OptionError, SingularGeometryError
from nls.linear.singular import SingularSystemError
from nls.linear.underconstrained import underconstrained
from nls.optimizers.problem import Problem
from nls.optimizers.result import Callback
from nls.optimizers.thresholds import Status, Stop
from nls.optimizers.watch import Watch
from nls.system import LinearSystem
from nls.values import Values

__all__ = ["Optimizer"]


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
                watch.doubt(problem.linearize(watch.best), problem.analysis.description)
        except SingularSystemError as error:
            system = problem.solver.held_system(problem.latest)
            raise underconstrained(system, watch.best, error, problem.solver) from error
        except (EvaluationError, SingularGeometryError) as error:
            step = watch.step_count + 1
            if isinstance(error, EvaluationError):
                error.iteration = step
            if error.is_fault or (step == 1 and getattr(error, "where", "") == "A'A"):
                raise
            watch.end(Status.DIVERGED, f"the step of iteration {step} led where {error}", "evaluation")
        except KeyboardInterrupt:
            watch.end(Status.INTERRUPTED, f"after {watch.step_count} iterations", "interrupt")
