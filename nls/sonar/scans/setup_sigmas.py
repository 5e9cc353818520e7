"""chi2 over degrees of freedom of steps and of closures: sigmas that are too large or too small."""

from __future__ import annotations

from dataclasses import dataclass

from factors.base import Factor
from factors.keys import kinds
from models.errors import GraphError
from nls.analysis.freedom import freedom
from nls.analysis.leave_one_out import checks
from nls.gauge import choose_gauge, fixed_variables
from nls.graph import FactorGraph
from nls.sonar.scans.closing import Closing

__all__ = ["Fit", "fits"]

BOUNDS = (0.25, 4.0)  # of chi2 / dof: sigmas that are twice or half as large as they should be
LEAST = 20.0  # degrees of freedom: with 20 of them, 0.25 is one case in 3,000
x = kinds("x")[0]


@dataclass(frozen=True)
class Fit:
    """How well measurements of a kind fit.

    Attributes
    ----------
    name : steps or closures.
    chi2, dof : of them; degrees of freedom without what they have spent on the unknowns.
    """

    name: str
    chi2: float
    dof: float

    @property
    def scale(self) -> float:
        """On the stated sigmas, with which chi2 would be as expected."""
        return float((self.chi2 / self.dof) ** 0.5)

    @property
    def too_large(self) -> bool:
        """Whether the stated sigmas are more than twice too large."""
        return self.dof >= LEAST and self.chi2 < BOUNDS[0] * self.dof

    @property
    def too_small(self) -> bool:
        """Whether the stated sigmas are less than half of what they should be."""
        return self.dof >= LEAST and self.chi2 > BOUNDS[1] * self.dof


def fits(graph: FactorGraph, closing: Closing) -> tuple[Fit, ...]:
    """chi2 of the steps and of the kept closures.

    Parameters
    ----------
    graph : without closures, as `close` took it.
    closing : of it.

    Raises
    ------
    GraphError
        Sigmas that differ too much for a covariance.
    """
    values = closing.values
    pattern = closing.graph.pattern(values)
    pattern = pattern.holding(choose_gauge("first", pattern, values, fixed_variables(closing.graph.fixed, values)).held)
    checked = freedom(pattern, values).checked
    if checked is None:
        raise GraphError(
            "check_setup: sigmas of the graph differ too much for a covariance; look for far too small ones"
        )
    parts: dict[str, list[tuple[float, float]]] = {"steps": [], "closures": []}
    tests = checks(checked, len(pattern.batches))
    for number, (batch, test, e) in enumerate(zip(pattern.batches, tests, checked.e, strict=True)):
        name = "closures" if number >= len(graph.factors) else "steps" if _is_step(batch.model.factor) else ""
        if name:
            parts[name].append((float((e**2).sum()), float(test.dof.sum())))
    return tuple(Fit(name, *map(sum, zip(*rows, strict=True))) for name, rows in parts.items() if rows)


def _is_step(factor: Factor) -> bool:
    """Whether it joins keyframes."""
    return [keys.kind for keys in factor.keys].count(x.name) == 2
