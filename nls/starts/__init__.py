"""Start values: poses composed along edges, or all at once by chordal relaxation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from models import SE2, SE3
from models.errors import EvaluationError, LeadlineError, OptionError, UnderconstrainedError
from nls.graph import FactorGraph
from nls.starts.chain import chain, spanning_tree
from nls.starts.chordal import chordal
from nls.starts.edges import pose_edges
from nls.values import Values

__all__ = ["STARTS", "chain", "chordal", "initialize", "spanning_tree"]

STARTS: dict[str, Callable[[FactorGraph, Values], Values]] = {
    "file": lambda graph, values: values,
    "odometry": chain,
    "spanning-tree": spanning_tree,
    "chordal": chordal,
}


def initialize(graph: FactorGraph, values: Values, method: str = "auto") -> tuple[Values, str, dict[str, float]]:
    """Start values by name.

    Parameters
    ----------
    graph, values : the graph and what the file, or the user, gave.
    method : ``file`` keeps the values; ``odometry``, ``spanning-tree``, ``chordal``; ``auto`` takes the start of lowest
        chi2 among the file's own, the odometry chain and chordal.

    Returns
    -------
    values : the start.
    name : the method it came from.
    chi2 : chi2 of every start that was tried.

    Raises
    ------
    OptionError
        No such method.
    EvaluationError, UnderconstrainedError
        The chosen start, or every start that ``auto`` tries, cannot be evaluated or does not exist.

    Examples
    --------
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Between(x[0], x[1], [1, 0, 0], Isotropic(1))])
    >>> values, name, chi2 = initialize(graph, Values({x: (SE2, SE2.identity(2))}))
    >>> name, chi2["file"]
    ('odometry', 1.0)
    """
    if method != "auto":
        if method not in STARTS:
            raise OptionError("init", method, "one of auto, " + ", ".join(STARTS))
        start = STARTS[method](graph, values)
        return start, method, {method: graph.chi2(start)}
    chi2: dict[str, float] = {}
    best, name = values, ""
    refused: LeadlineError | None = None
    relaxable = any(edges.group in (SE2, SE3) for edges in pose_edges(graph, values))
    for candidate in ("file", "odometry", "chordal") if relaxable else ("file", "odometry"):
        try:
            start = STARTS[candidate](graph, values)
            chi2[candidate] = graph.chi2(start)
        except (UnderconstrainedError, EvaluationError) as error:  # no start of this graph: not listed
            refused = error
            continue
        if chi2[candidate] < chi2.get(name, np.inf):
            best, name = start, candidate
    if refused is not None and not chi2:
        raise refused
    return best, name, chi2
