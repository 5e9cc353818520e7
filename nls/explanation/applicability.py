"""Remedies for a graph besides a new start: a certificate, graduated non-convexity; only where they work."""

from __future__ import annotations

from typing import TYPE_CHECKING

from models.errors import GraphError

if TYPE_CHECKING:
    from nls.graph import FactorGraph
    from nls.values import Values

__all__ = ["certifies", "graduates"]


def certifies(graph: FactorGraph, values: Values) -> bool:
    """Whether `nls.certify` takes this graph."""
    from nls.certificate.problem import certifiable

    try:
        certifiable(graph, values)
    except GraphError:
        return False
    return True


def graduates(graph: FactorGraph, values: Values) -> bool:
    """Whether `nls.gnc` finds loop closures to doubt in this graph, and odometry to judge them by."""
    from nls.robust.loop_graph import loop_graph

    try:
        return len(loop_graph(graph, values).closures) > 0
    except GraphError:
        return False
