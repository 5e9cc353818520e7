"""Start values: poses composed along edges, or all at once by chordal relaxation; points where the poses saw them."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from models import SE2, SE3
from models.errors import (
    EvaluationError,
    GraphWarning,
    LeadlineError,
    OptionError,
    SingularGeometryError,
    UnderconstrainedError,
)
from nls.graph import FactorGraph
from nls.sparse.pattern import measured_rows
from nls.sparse.threads import single_thread
from nls.stages import stage
from nls.starts.chain import chain, spanning_tree
from nls.starts.chordal import chordal
from nls.starts.dead_reckoning import dead_reckoning, walks
from nls.starts.edges import pose_batches
from nls.starts.elevation import first_sighting, search_elevation
from nls.starts.incremental import incremental, sees_points
from nls.starts.landmarks import locate_points
from nls.starts.rig import rig
from nls.values import Values

__all__ = [
    "STARTS",
    "chain",
    "chordal",
    "dead_reckoning",
    "first_sighting",
    "incremental",
    "initialize",
    "locate_points",
    "rig",
    "search_elevation",
    "spanning_tree",
]


def odometry(graph: FactorGraph, values: Values) -> Values:
    """Poses chained from `Between`, then from `XYH`, points where they saw them, contacts of a sonar along their arcs.

    A track in which the two take turns it does not chain; `incremental` does.
    """
    poses = dead_reckoning(graph, chain(graph, values))
    return search_elevation(graph, locate_points(graph, poses))


STARTS: dict[str, Callable[[FactorGraph, Values], Values]] = {
    "file": lambda graph, values: values,
    "odometry": odometry,
    "spanning-tree": lambda graph, values: locate_points(graph, spanning_tree(graph, values)),
    "chordal": lambda graph, values: locate_points(graph, chordal(graph, values)),
    "incremental": incremental,
}
NEAR, POOR = 10.0, 100.0  # chi2 per measured row; noise gives 1, starts Gauss-Newton converges from seldom over 10


@single_thread()
def initialize(graph: FactorGraph, values: Values, method: str = "auto") -> tuple[Values, str, dict[str, float]]:
    """Start values by name.

    Parameters
    ----------
    graph, values : the graph and what the file, or the user, gave.
    method : ``file`` keeps the values; ``odometry``, ``spanning-tree`` and ``chordal`` move the poses, and the points
        to where these poses saw them; ``odometry`` reckons from `XYH` and `ZPR` as well as from `Between`, and puts a
        point an imaging sonar saw at the elevation that fits all its contacts best (`search_elevation`);
        ``incremental`` solves the graph as it grows. ``auto`` takes the start of lowest chi2 among the file's own and
        chordal; above 100 per measured row it tries ``incremental``, which costs several solves, where the graph has
        measurements between poses and points, or both kinds of odometry, and above 10 the odometry chain. A start that
        does not exist or cannot be evaluated is left out, with a `GraphWarning` unless it is the file's own, where
        placeholders are usual.

    Returns
    -------
    values : the start.
    name : the method it came from.
    chi2 : chi2 of every start that was tried.

    Raises
    ------
    OptionError
        No such method.
    GraphError
        A measurement or a weight whose square is no number.
    EvaluationError, SingularGeometryError, UnderconstrainedError
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
    ('chordal', 1.0)
    """
    if method not in ("auto", *STARTS):
        raise OptionError("init", method, "one of auto, " + ", ".join(STARTS))
    pattern = graph.pattern(values)
    pattern.refuse_extreme()
    if method != "auto":
        with stage(f"init {method}"):
            start = STARTS[method](graph, values)
            return start, method, {method: graph.chi2(start)}
    chi2: dict[str, float] = {}
    best, name = values, ""
    refused: dict[str, LeadlineError] = {}
    groups, rows = pose_batches(pattern), measured_rows(pattern)
    candidates = {"file": 0.0}  # and the chi2 per row above which it is worth trying
    candidates |= {"chordal": 0.0} if SE2 in groups or SE3 in groups else {}
    steps = groups or walks(graph)
    candidates |= {"incremental": POOR} if steps and (sees_points(graph, values) or (groups and walks(graph))) else {}
    candidates |= {"odometry": NEAR} if steps else {}
    for candidate, limit in candidates.items():
        if name and limit and _plain(graph, best) < limit * rows:
            continue
        try:
            with stage(f"init {candidate}"):
                start = STARTS[candidate](graph, values)
                chi2[candidate] = graph.chi2(start)
        except (UnderconstrainedError, EvaluationError, SingularGeometryError) as error:
            refused[candidate] = error
            continue
        if chi2[candidate] < chi2.get(name, np.inf):
            best, name = start, candidate
    if not chi2:
        raise refused.popitem()[1]
    for candidate in [c for c in refused if c != "file"]:
        message = f"start {candidate!r} was left out: {refused[candidate]}"
        warnings.warn(message, GraphWarning, stacklevel=3)  # 2: single_thread
    return best, name, chi2


def _plain(graph: FactorGraph, values: Values) -> float:
    """chi2 without robust kernels, under which every start looks near."""
    return sum(float(factor.chi2(values).sum()) for factor in graph.factors)
