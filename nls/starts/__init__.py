"""Start values: poses composed along edges, or all at once by chordal relaxation."""

from __future__ import annotations

from collections.abc import Callable

from models.errors import OptionError, UnderconstrainedError
from nls.graph import FactorGraph
from nls.starts.chain import chain, spanning_tree
from nls.starts.chordal import chordal
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
    best, name = values, "file"
    for candidate in ("file", "odometry", "chordal"):
        try:
            start = STARTS[candidate](graph, values)
        except UnderconstrainedError:  # a start that does not exist for this graph is no candidate, and is not listed
            continue
        chi2[candidate] = graph.chi2(start)
        if chi2[candidate] < chi2[name]:
            best, name = start, candidate
    return best, name, chi2
