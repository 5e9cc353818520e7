"""Starts to choose from, each with its chi2; poor ones are compared by what they lead to.

Far above the noise, chi2 of a start does not tell its valley. The lowest of several poor starts may lead to a poor
optimum. A few steps from each of them tell. They are steps of the dogleg, the damped method of one factorization a
step.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import cached_property

from models.errors import (
    EvaluationError,
    GraphWarning,
    LeadlineError,
    SingularGeometryError,
    UnderconstrainedError,
)
from nls.gauge import fixed_variables, touched_variables
from nls.graph import FactorGraph
from nls.optimizers import Dogleg, Status, Stop
from nls.stages import stage
from nls.values import Values

__all__ = ["AFTER_STEPS", "Candidates"]

STEPS = 20  # at most, from each start; simulated range-only missions need 5, the marine one with poor headings 10
AFTER_STEPS = f" + {STEPS} steps"  # end of the name of the place where they lead
POOR = 10.0  # chi2 per degree of freedom; chordal starts of public pose graphs without false closures have at most 9.6
EXPLAINED = 2.0  # chi2 per degree of freedom that needs no other explanation than noise
SAME = 1e-6  # relative: chi2 that differs by less is of the same poses, or of the same optimum
REFUSED = (UnderconstrainedError, EvaluationError, SingularGeometryError)


class Candidates:
    """Starts of a graph, and the best of them.

    Parameters
    ----------
    graph, values : the graph and what was given.

    Attributes
    ----------
    best, name : the start of lowest chi2, and its name; empty before there is one.
    chi2 : of every start, by name.
    refused : errors of those that do not exist or cannot be evaluated, by name.
    rows : measured ones.
    believes_all : whether steps led to the best, where robust kernels ignore nothing and noise explains chi2.
    """

    def __init__(self, graph: FactorGraph, values: Values) -> None:
        self.graph, self.best, self.name = graph, values, ""
        self.chi2: dict[str, float] = {}
        self.refused: dict[str, LeadlineError] = {}
        self._starts: dict[str, Values] = {}
        self._compared: list[float] = []  # chi2 of the starts from which steps were taken
        self.believes_all = False
        self.rows = graph.pattern(values).measured_rows

    @cached_property
    def dof(self) -> int:
        """Degrees of freedom: how many more rows there are than unknowns, a gauge not counted."""
        pattern = self.graph.pattern(self.best)
        unknown = touched_variables(pattern) & ~fixed_variables(self.graph.fixed, self.best)
        return self.rows - int(pattern.dims[unknown].sum())

    def add(self, name: str, values: Values, method: Callable[[FactorGraph, Values], Values]) -> None:
        """Compute a start."""
        try:
            with stage(f"init {name}"):
                start = method(self.graph, values)
                chi2 = self.graph.chi2(start)
        except REFUSED as error:
            self.refused[name] = error
            return
        self._starts[name] = start
        self._list(name, start, chi2, self.chi2.get(self.name, math.inf))

    def knows(self, name: str) -> bool:
        """Whether a start has been computed, or refused."""
        return name in self.chi2 or name in self.refused

    def misfit(self) -> float:
        """chi2 of the best without robust kernels, under which every start looks near."""
        if all(factor.kernel is None for factor in self.graph.factors):
            return self.chi2[self.name]
        return sum(float(factor.chi2(self.best).sum()) for factor in self.graph.factors)

    def poor(self) -> bool:
        """Whether the best start is far above the noise."""
        return self.dof > 0 and self.misfit() > POOR * self.dof

    def explained(self) -> bool:
        """Whether noise explains the best."""
        return self.misfit() <= EXPLAINED * self.dof

    def compare(self, robust: bool = False) -> None:
        """Take steps from the starts that have not been compared, the lowest first, until noise explains the best.

        With `robust` kernels until they believe every measurement there.
        """
        for name in sorted(self._starts, key=self.chi2.__getitem__):
            if self.believes_all if robust else self.explained():
                return
            chi2 = self.chi2[name]
            if not any(math.isclose(chi2, other, rel_tol=SAME) for other in self._compared):  # the same start
                self._compared.append(chi2)
                self.advance(name)

    def advance(self, name: str) -> None:
        """Take steps from a start; where they lead is a candidate, too. From where they cannot begin nothing is added.

        Raises
        ------
        KeyboardInterrupt
            The optimizer was interrupted.
        """
        try:
            with stage(f"init {name}{AFTER_STEPS}"), warnings.catch_warnings():
                warnings.simplefilter("ignore", GraphWarning)  # the optimization that follows gives them
                result = self.graph.optimize(self._starts[name], Dogleg(Stop(max_iterations=STEPS)))
        except REFUSED:
            return
        if result.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if result.chi2_final <= self.chi2[self.name]:
            self.believes_all = not result.doubt and not any(share.ignored for share in result.shares)
        self._list(name + AFTER_STEPS, result.values, result.chi2_final, (1 - SAME) * self.chi2[self.name])

    def _list(self, name: str, start: Values, chi2: float, limit: float) -> None:
        """Note a start; below the limit it is the best."""
        self.chi2[name] = chi2
        if chi2 < limit or not self.name:
            self.best, self.name = start, name
