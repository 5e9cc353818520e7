"""What a page is about: a graph, its start, what came out, and what is known of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from models.errors import UnderconstrainedError
from nls.gauge import choose_gauge, fixed_variables
from nls.system import LinearSystem

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from nls.certificate import Certificate
    from nls.covariance import Marginals
    from nls.explanation import Explanation
    from nls.graph import FactorGraph
    from nls.optimizers import Result
    from nls.robust.graduated import Rejected
    from nls.values import Values


@dataclass(frozen=True)
class ReportData:
    """Everything the sections take from; the arguments of `nls.plot.report`, and the values they are about."""

    graph: FactorGraph
    start: Values
    outcome: Result | UnderconstrainedError
    explanation: Explanation
    init: str = ""
    marginals: Marginals | None = None
    certificate: Certificate | None = None
    rejected: Sequence[Rejected] = ()
    doubts: Sequence[object] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    pictures: Mapping[str, Figure] = field(default_factory=dict)
    figures: Mapping[str, str] = field(default_factory=dict)
    shell: bool = False

    @property
    def result(self) -> Result | None:
        """Of the optimization; None where it could not be done."""
        return None if isinstance(self.outcome, UnderconstrainedError) else self.outcome

    @property
    def values(self) -> Values:
        """The optimum, or how far one came."""
        values: Values | None = self.outcome.values
        return self.start if values is None else values

    @property
    def size(self) -> int:
        """Variables and measurements, for what a picture of all costs."""
        return len(self.values) + len(self.graph)

    @cached_property
    def system(self) -> LinearSystem:
        """A and b at the values, one variable of every part held that nothing holds."""
        values = self.values
        decided = choose_gauge("first", self.graph.pattern(values), values, fixed_variables(self.graph.fixed, values))
        return LinearSystem.at(decided.pattern.holding(decided.held), values)

    @cached_property
    def covariances(self) -> Marginals | UnderconstrainedError | None:
        """Covariances as given or of the optimum; None where there is none, the error where something is free."""
        from nls.covariance import Marginals

        if self.marginals is not None or self.result is None or not self.result.converged:
            return self.marginals
        try:
            return Marginals(self.graph, self.values)
        except UnderconstrainedError as error:
            return error
