"""Parts of a graph that no measurement joins: their relative position is the initial guess."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from models.advice import Advice
from nls.explanation.findings import Finding, FindingKind
from nls.gauge import component_labels, moving_variables

if TYPE_CHECKING:
    from nls.gauge import Gauge
    from nls.sparse.pattern import Pattern

__all__ = ["separate_parts"]


def separate_parts(pattern: Pattern, gauge: Gauge) -> list[Finding]:
    """Parts that nothing joins, where not all of them have a place of their own; the largest first.

    Parameters
    ----------
    pattern : the graph.
    gauge : what is held; a part that the gauge holds has no place of its own.
    """
    moved = moving_variables(pattern)
    names, first, sizes = np.unique(component_labels(pattern)[moved], return_index=True, return_counts=True)
    if len(names) < 2 or not (gauge.held & ~gauge.fixed).any():
        return []
    order = np.argsort(-sizes, kind="stable")
    keys = tuple(pattern.key(int(v)) for v in np.flatnonzero(moved)[first[order]])
    numbers = {"variables": tuple(sizes[order].tolist())}
    return [Finding(FindingKind.SEPARATE_PARTS, keys, numbers, (Advice("join"), Advice("split")))]
