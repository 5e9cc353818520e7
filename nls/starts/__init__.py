"""Start values: poses composed along edges, or all at once by chordal relaxation; points where the poses saw them.

Far above the noise, chi2 of a start does not tell its valley. The lowest of several poor starts may lead to a poor
optimum. A few steps from each of them tell. They are steps of the dogleg, the damped method of one factorization a
step.
"""

import math
import warnings
from collections.abc import Callable
from functools import cached_property

from models import SE2, SE3
from models.errors import (
    EvaluationError,
    GraphWarning,
    LeadlineError,
    OptionError,
    SingularGeometryError,
    UnderconstrainedError,
)
from nls.gauge import fixed_variables, touched_variables
from nls.graph import FactorGraph
from nls.optimizers import Dogleg, Stop
from nls.posegraph import pose_graphs, says_poses
from nls.sparse.threads import single_thread
from nls.stages import stage
from nls.starts.chordal import chordal
from nls.starts.dead_reckoning import chain, dead_reckoning, spanning_tree, walks
from nls.starts.incremental import incremental, seen_points
from nls.starts.landmarks import first_sighting, locate_points, search_elevation
from nls.starts.rig import rig
from nls.system import LinearSystem
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
    return search_elevation(graph, locate_points(graph, dead_reckoning(graph, chain(graph, values))))


STARTS: dict[str, Callable[[FactorGraph, Values], Values]] = {
    "file": lambda graph, values: values,
    "odometry": odometry,
    "spanning-tree": lambda graph, values: locate_points(graph, spanning_tree(graph, values)),
    "chordal": lambda graph, values: locate_points(graph, chordal(graph, values)),
    "incremental": incremental,
}
# chi2 per measured row, or degree of freedom, of a poor start: noise gives 1, chordal starts of public pose graphs
# without false closures and starts that Gauss-Newton converges from seldom over 10
POOR = 10.0
# At most, from each start; simulated range-only missions need 5, the marine one with poor headings 10.
COMPARED_STEPS = 20
SAME_CHI2 = 1e-6  # relative: chi2 that differs by less is of the same poses, or of the same optimum
REFUSED = (UnderconstrainedError, EvaluationError, SingularGeometryError)


@single_thread()
def initialize(graph: FactorGraph, values: Values, method: str = "auto") -> tuple[Values, str, dict[str, float]]:
    """Initial guess of all variables: the best of several methods, or the named one.

    Parameters
    ----------
    graph, values : the graph and what the file, or the user, gave.
    method : ``file`` keeps the values; ``odometry``, ``spanning-tree`` and ``chordal`` move the poses, and the points
        to where these poses saw them; ``odometry`` reckons from `XYH` and `ZPR` as well as from relative poses. It puts
        a point an imaging sonar saw at the elevation that fits all its contacts best (`search_elevation`).
        ``incremental`` solves the graph as it grows. ``auto`` takes the start of lowest chi2 among the stated one and
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
    stated = values if graph.fixed else values.stated  # fixed poses need theirs
    graph.pattern(stated).refuse_extreme()
    if method != "auto":
        with stage(f"init {method}"):
            start = STARTS[method](graph, values)
            return start, method, {method: graph.chi2(start)}
    known, relative = pose_graphs(graph, stated), all(map(says_poses, graph.factors))
    if not relative or any(len(poses.roots) != 1 or not poses.touched.all() for poses in known):
        stated = values  # a pose that no measurement moves keeps its value
    groups = {poses.group for poses in known}
    relaxed = SE2 in groups or SE3 in groups
    limits = {} if relaxed and stated is not values else {"file": 0.0}  # chi2 per row above which one is worth its cost
    limits |= {"chordal": 0.0} if relaxed else {}
    values = stated if relaxed else values
    candidates = Candidates(graph, values, relative)
    steps = groups or walks(graph)
    grows = bool(steps and (seen_points(graph, values) or (groups and walks(graph))))
    limits |= {"incremental": 10 * POOR} if grows else {}
    robust = not relative and any(factor.kernel is not None for factor in graph.factors)
    limits |= {"odometry": 0.0 if robust else POOR} if steps else {}
    for candidate, limit in limits.items():
        if not (limit and candidates.name) or candidates.misfit() >= limit * candidates.rows:
            candidates.add(candidate)
    if not candidates.chi2:
        raise candidates.refused.popitem()[1]
    poor = not relative and 0 < POOR * candidates.dof < candidates.misfit()  # far above the noise
    if len(limits) > 1 and (poor or robust):
        candidates.compare(robust)
        if poor and grows and not candidates.explained() and "incremental" not in candidates.chi2 | candidates.refused:
            candidates.add("incremental")
            candidates.compare(robust)
    for candidate in [c for c in candidates.refused if c != "file"]:
        message = f"initial guess {candidate!r} was left out: {candidates.refused[candidate]}"
        warnings.warn(message, GraphWarning, stacklevel=3)  # 2: single_thread
    return candidates.best, candidates.name, candidates.chi2


class Candidates:
    """Starts of a graph, and the best of them.

    Parameters
    ----------
    graph, values : the graph and what was given.
    relative : whether all measurements are relative poses, which chordal relaxation uses.

    Attributes
    ----------
    best, name : the start of lowest chi2, and its name; empty before there is one.
    chi2 : of every start, by name.
    refused : errors of those that do not exist or cannot be evaluated, by name.
    rows : measured ones.
    believes_all : whether steps led to the best, where robust kernels ignore nothing and noise explains chi2.
    """

    def __init__(self, graph: FactorGraph, values: Values, relative: bool) -> None:
        self.graph, self.values, self.pattern, self.best, self.name = graph, values, graph.pattern(values), values, ""
        self.chi2: dict[str, float] = {}
        self.refused: dict[str, LeadlineError] = {}
        self._starts: dict[str, Values] = {}
        self._compared: list[float] = []  # chi2 of the starts from which steps were taken
        self.believes_all = False
        self.rows, self.relative = self.pattern.measured_rows, relative

    @cached_property
    def dof(self) -> int:
        """Degrees of freedom: how many more rows there are than unknowns, a gauge not counted."""
        unknown = touched_variables(self.pattern) & ~fixed_variables(self.graph.fixed, self.best)
        return self.rows - int(self.pattern.dims[unknown].sum())

    def add(self, name: str) -> None:
        """Compute a start."""
        try:
            with stage(f"init {name}"):
                start = STARTS[name](self.graph, self.values)
                if name == "chordal" and self.relative:  # the optimization goes on from there
                    system = LinearSystem.at(self.pattern, start)
                    system.keep(start)
                    chi2 = system.chi2
                else:
                    chi2 = self.pattern.chi2(start)
        except REFUSED as error:
            self.refused[name] = error
            return
        self._starts[name] = start
        self._list(name, start, chi2, self.chi2.get(self.name, math.inf))

    def misfit(self) -> float:
        """chi2 of the best without robust kernels, under which every start looks near."""
        if all(factor.kernel is None for factor in self.graph.factors):
            return self.chi2[self.name]
        return sum(float(factor.chi2(self.best).sum()) for factor in self.graph.factors)

    def explained(self) -> bool:
        """Whether noise explains the best."""
        return self.misfit() <= 2.0 * self.dof

    def compare(self, robust: bool = False) -> None:
        """Take steps from the starts that have not been compared, the lowest first, until noise explains the best.

        With `robust` kernels until they ignore no measurement there.
        """
        for name in sorted(self._starts, key=self.chi2.__getitem__):
            if self.believes_all if robust else self.explained():
                return
            chi2 = self.chi2[name]
            if not any(math.isclose(chi2, other, rel_tol=SAME_CHI2) for other in self._compared):  # the same start
                self._compared.append(chi2)
                self.advance(name)

    def advance(self, name: str) -> None:
        """Take steps from a start; where they lead is a candidate, too. Where they cannot begin, nothing is added."""
        after = f"{name} + {COMPARED_STEPS} steps"
        try:
            with stage(f"init {after}"), warnings.catch_warnings():
                warnings.simplefilter("ignore", GraphWarning)  # the optimization that follows gives them
                result = self.graph.optimize(self._starts[name], Dogleg(Stop(max_iterations=COMPARED_STEPS)))
        except REFUSED:
            return
        if result.chi2_final <= self.chi2[self.name]:
            self.believes_all = not result.doubt and not any(share.ignored for share in result.shares)
        self._list(after, result.values, result.chi2_final, (1 - SAME_CHI2) * self.chi2[self.name])

    def _list(self, name: str, start: Values, chi2: float, limit: float) -> None:
        """Note a start; below the limit it is the best."""
        self.chi2[name] = chi2
        if chi2 < limit or not self.name:
            self.best, self.name = start, name
