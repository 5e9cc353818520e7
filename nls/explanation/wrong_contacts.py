"""Findings about the contacts of a mission that were rejected, and those of landmarks taken for one another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from models.advice import Advice
from models.listing import SOME
from nls.analysis.exchanged_contacts import exchanged_contacts
from nls.explanation.findings import Finding, FindingKind

if TYPE_CHECKING:
    from nls.graph import FactorGraph
    from nls.robust import Robustified

__all__ = ["wrong_contacts"]


def wrong_contacts(graph: FactorGraph, choice: Robustified) -> tuple[Finding, ...]:
    """All that were rejected, then the pairs of landmarks with exchanged contacts.

    Parameters
    ----------
    graph : with all contacts.
    choice : among them.
    """
    out = [weight == 0 for weight in choice.weights]
    where = {
        factor.describe(i): (k, i) for k, factor in enumerate(graph.factors) for i in np.flatnonzero(out[k]).tolist()
    }
    names = [rejection.factor for rejection in choice.rejected]
    worst = tuple(where[name] for name in names[:SOME] if name in where)
    inspect = (Advice("inspect", ("them",)), Advice("remove", ("them",)))
    findings = [Finding(FindingKind.MANY_OUTLIERS, (), {"factors": names}, inspect, worst)]
    for pair in exchanged_contacts(graph, choice.result.values, out):
        count = len(pair.places)
        numbers = {"sightings": count, "chi2": pair.standing, "chi2_otherwise": pair.chi2, "dof": 2 * count}
        advice = (Advice("exchange", (repr(pair.first), repr(pair.second))),)
        findings.append(Finding(FindingKind.SWAPPED, (pair.first, pair.second), numbers, advice, pair.places[:SOME]))
    return tuple(findings)
