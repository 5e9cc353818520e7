"""chi2 over degrees of freedom of steps, of drifts and of closures: sigmas that are too large or too small.

Drifts tell most. Steps and closures leave little of their own once drifts have followed them. With all sigmas of dead
reckoning doubled or halved, drifts of a harbor have 0.36 and 3.3 (1.0 as stated). Steps have 0.31 and 0.42 (0.47).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.base import Factor
from factors.keys import kinds
from models.errors import GraphError
from nls.analysis.freedom import freedom
from nls.analysis.leave_one_out import checks
from nls.gauge import choose_gauge, fixed_variables
from nls.graph import FactorGraph
from nls.missions.scans.closing import Closing, shares

__all__ = ["Fit", "fits"]

LIMITS = {"steps": 2.0, "drifts": 1.5, "closures": 2.0}  # times that sigmas may be too large or too small
LEAST = 40.0  # degrees of freedom: with 40 of them, either limit is one case in 1,000 or less
x, d = kinds("x", "d")


@dataclass(frozen=True)
class Fit:
    """How well measurements of a kind fit.

    Attributes
    ----------
    name : steps, drifts or closures.
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
        """Whether the stated sigmas are too large by more than is allowed for.

        Never of steps: their yaw and the compass heading are one number, so small residuals of steps say nothing.
        """
        return self.name != "steps" and self.dof >= LEAST and self.scale < 1 / LIMITS[self.name]

    @property
    def too_small(self) -> bool:
        """Whether the stated sigmas are too small by more than is allowed for."""
        return self.dof >= LEAST and self.scale > LIMITS[self.name]


def fits(graph: FactorGraph, closing: Closing) -> tuple[Fit, ...]:
    """chi2 of the steps, of the drifts of stretches, if any, and of the kept closures by their own covariances.

    Parameters
    ----------
    graph : without closures, as `close` took it.
    closing : of it.

    Raises
    ------
    GraphError
        Sigmas that differ too much for a covariance.
    """
    if not closing.matches.kept.any():
        return ()  # dead reckoning agrees with itself
    values = closing.values
    pattern = closing.graph.pattern(values)
    pattern = pattern.holding(choose_gauge("first", pattern, values, fixed_variables(closing.graph.fixed, values)).held)
    checked = freedom(pattern, values).checked
    if checked is None:
        raise GraphError(
            "check_setup: sigmas of the graph differ too much for a covariance; look for far too small ones"
        )
    parts: dict[str, list[tuple[float, float]]] = {"steps": [], "drifts": [], "closures": []}
    tests = checks(checked, len(pattern.batches))
    for batch, test, e in zip(pattern.batches[: len(graph.factors)], tests, checked.e, strict=False):
        if name := _name(batch.model.factor):
            parts[name].append((float((e**2).sum()), float(test.dof.sum())))
    kept = closing.matches.kept  # in the last factor
    own = np.square(checked.e[-1]).sum(axis=1) * shares(closing.matches.i[kept], closing.matches.j[kept])
    parts["closures"].append((float(own.sum()), float(tests[-1].dof.sum())))
    return tuple(Fit(name, *map(sum, zip(*rows, strict=True))) for name, rows in parts.items() if rows)


def _name(factor: Factor) -> str:
    """Steps join keyframes x, drifts of stretches d have their mean; other measurements have no name."""
    joined = [keys.kind for keys in factor.keys]
    return "steps" if joined.count(x.name) == 2 else "drifts" if d.name in joined else ""
