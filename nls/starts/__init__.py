"""Start values: poses composed along edges, or all at once by chordal relaxation; points where the poses saw them."""

from __future__ import annotations

import warnings
from collections.abc import Callable

from models import SE2, SE3
from models.errors import GraphWarning, OptionError
from nls.graph import FactorGraph
from nls.posegraph import pose_graphs, says_poses
from nls.sparse.threads import single_thread
from nls.stages import stage
from nls.starts.candidates import Candidates
from nls.starts.chordal import chordal
from nls.starts.dead_reckoning import chain, dead_reckoning, spanning_tree, walks
from nls.starts.elevation import first_sighting, search_elevation
from nls.starts.incremental import incremental, sees_points
from nls.starts.landmarks import locate_points
from nls.starts.rig import rig
from nls.values import Values, refuse_other

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
    """Poses chained from relative ones, then from `XYH`; points where they saw them; sonar contacts along their arcs.

    A track in which the two take turns it does not chain; `incremental` does.
    """
    refuse_other("odometry", graph, values)
    poses = dead_reckoning(graph, chain(graph, values))
    return search_elevation(graph, locate_points(graph, poses))


STARTS: dict[str, Callable[[FactorGraph, Values], Values]] = {
    "file": lambda graph, values: values,
    "odometry": odometry,
    "spanning-tree": lambda graph, values: locate_points(graph, spanning_tree(graph, values)),
    "chordal": lambda graph, values: locate_points(graph, chordal(graph, values)),
    "incremental": incremental,
}
# chi2 per measured row above which the odometry chain and `incremental` are tried; noise gives 1, starts that
# Gauss-Newton converges from seldom over 10
NEAR, FAR = 10.0, 100.0


@single_thread()
def initialize(graph: FactorGraph, values: Values, method: str = "auto") -> tuple[Values, str, dict[str, float]]:
    """Start values by name.

    Parameters
    ----------
    graph, values : the graph and what the file, or the user, gave.
    method : ``file`` keeps the values; ``odometry``, ``spanning-tree`` and ``chordal`` move the poses, and the points
        to where these poses saw them; ``odometry`` reckons from `XYH` and `ZPR` as well as from relative poses. It puts
        a point an imaging sonar saw at the elevation that fits all its contacts best (`search_elevation`).
        ``incremental`` solves the graph as it grows. ``auto`` takes the start of lowest chi2 among the file's own and
        chordal. Above 100 per measured row it tries ``incremental``, which costs several solves. The graph must have
        measurements between poses and points, or both kinds of odometry. Above 10 it tries the odometry chain. The
        starts are compared by their results if the best has more than 10 per degree of freedom, and the graph has other
        measurements than relative poses. That takes up to 20 steps of the dogleg from each, the lowest first, until
        noise explains chi2 (at most 2 per degree of freedom). If no start leads there, it tries ``incremental``, too.
        Under robust kernels one wrong fix among many hardly raises chi2, and the file's start may lie on it. So the
        odometry chain is tried whatever chi2 is, and the results are compared until no measurement is ignored. A start
        that does not exist or cannot be evaluated is left out, with a `GraphWarning`. The file's own start, often
        a placeholder, is left out without one.

    Returns
    -------
    values : the start; after a comparison the place where the best steps led.
    name : the method it came from; after a comparison with its steps, such as ``chordal + 20 steps``.
    chi2 : chi2 of every start that was tried, and of the places where the steps led.

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
    refuse_other("initialize", graph, values)
    if method not in ("auto", *STARTS):
        raise OptionError("init", method, "one of auto, " + ", ".join(STARTS))
    pattern = graph.pattern(values)
    pattern.refuse_extreme()
    if method != "auto":
        with stage(f"init {method}"):
            start = STARTS[method](graph, values)
            return start, method, {method: graph.chi2(start)}
    groups, candidates = {poses.group for poses in pose_graphs(graph, values)}, Candidates(graph, values)
    limits = {"file": 0.0}  # and the chi2 per row above which a start is worth its cost
    limits |= {"chordal": 0.0} if SE2 in groups or SE3 in groups else {}
    steps = groups or walks(graph)
    grows = bool(steps and (sees_points(graph, values) or (groups and walks(graph))))
    limits |= {"incremental": FAR} if grows else {}
    relative = all(says_poses(factor) for factor in graph.factors)  # chordal relaxation uses all of these
    robust = not relative and any(factor.kernel is not None for factor in graph.factors)
    limits |= {"odometry": 0.0 if robust else NEAR} if steps else {}
    for candidate, limit in limits.items():
        if not (limit and candidates.name) or candidates.misfit() >= limit * candidates.rows:
            candidates.add(candidate, values, STARTS[candidate])
    if not candidates.chi2:
        raise candidates.refused.popitem()[1]
    poor = candidates.poor()
    if not relative and len(limits) > 1 and (poor or robust):
        candidates.compare(robust)
        if poor and grows and not candidates.explained() and not candidates.knows("incremental"):
            candidates.add("incremental", values, incremental)
            candidates.compare(robust)
    for candidate in [c for c in candidates.refused if c != "file"]:
        message = f"start {candidate!r} was left out: {candidates.refused[candidate]}"
        warnings.warn(message, GraphWarning, stacklevel=3)  # 2: single_thread
    return candidates.best, candidates.name, candidates.chi2
