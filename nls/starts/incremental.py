r"""Start by solving the graph as it grows: for landmarks under an odometry that drifts too far for one solve.

Poses are taken in the order of their numbers, a stage at a time:

    1. new poses are dead-reckoned from the last optimized ones,
    2. points seen for the first time are placed where the optimized and reckoned poses saw them,
    3. the new poses and all points they see are optimized; older poses are held, and with them, by what they saw,
       the points. Where that does not fit, a loop pulls, and all poses and points so far are optimized.

A landmark seen again pulls the trajectory back while it is off by the drift of one stage; seen again at the end, after
the drift of the whole run, it pulls towards the nearest of many minima. Levenberg-Marquardt does the stages: a point
may be known in some direction only.

Source: M. Kaess, A. Ranganathan, F. Dellaert, "iSAM: incremental smoothing and mapping", T-RO 2008 (which updates the
factorization at every pose instead); the cure is older than that, and is how a vehicle would do it on its way.
"""

import math

import numpy as np

from factors.sighting import Sighting
from models import SE2, SE3
from models.algebra import Mask
from models.errors import UnderconstrainedError
from models.options import check_whole
from nls.graph import FactorGraph
from nls.optimizers import Iteration, LevenbergMarquardt, Stop
from nls.posegraph import says_poses
from nls.starts.dead_reckoning import chain, dead_reckoning
from nls.starts.landmarks import locate_points, search_elevation
from nls.starts.parts import Masks, Parts, put_back
from nls.values import Values, refuse_other


def incremental(graph: FactorGraph, values: Values, stage_size: int | None = None) -> Values:
    """Poses and points from a graph that is solved while it grows, pose by pose in the order of their numbers.

    Parameters
    ----------
    graph : relative poses, or `XYH` and `ZPR`, carry the poses on; `Landmark`, `Range`, `RangeAzimuth` and their like
        place the points; all factors whose variables are known are optimized.
    values : every variable. Of the poses only the first of each component matters, and fixed ones, which stay.
        Variables that are neither poses nor points seen from them are known from the beginning, at these values.
    stage_size : how many poses make a stage, at least 1: so few that dead reckoning stays near what the sensor can tell
        apart. When omitted 50, or a twentieth of all poses where that is less.

    Returns
    -------
    Values

    Raises
    ------
    OptionError
        No such number of poses.
    EvaluationError, SingularGeometryError
        The graph of some stage cannot be evaluated where its variables were put.

    Notes
    -----
    A stage that measures less than it has unknowns is dead-reckoned only: the next one has more. The cost is linear in
    the number of poses where no stage needs all before it; the page on start values has figures.

    Examples
    --------
    >>> from factors import Between, Isotropic, Landmark
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> from nls.starts import incremental
    >>> x, l = kinds("x", "l")
    >>> walk = Between(x[[0, 1]], x[[1, 2]], [[1, 0, 0.1], [1, 0, 0]], Isotropic(0.1))
    >>> sightings = Landmark(x[[0, 1, 2]], l[0], [[2.0, 1.0], [1.0, 1.0], [0.0, 1.0]], Isotropic(0.01))
    >>> start = Values({x: (SE2, SE2.identity(3)), l: (R(2), [0.0, 0.0])})
    >>> incremental(FactorGraph([walk, sightings]), start, stage_size=1)[x[2]].round(2)
    array([2.03, 0.  , 0.03])
    """
    refuse_other("incremental", graph, values)
    if stage_size is not None:
        check_whole("stage_size", stage_size, 1, "a number of poses, at least 1")
    growth, left = _Growth(graph, values, stage_size), 1.0
    for stage in range(growth.stages):
        values = growth.reckoned(values, stage)
        values = growth.located(values, stage)
        values, misfit = growth.optimized(values, stage, everything=not stage)
        if stage and misfit > 5.0 * max(left, 1.0):  # chi2 per row: noise gives 1
            values, misfit = growth.optimized(values, stage, everything=True)
            left = misfit
    return values


class _Growth:
    """A graph as it is known at each stage.

    Attributes
    ----------
    born : per kind of poses the stage (n,) in which they come.
    placed : per kind of points which (n,) have been placed so far; measured: in how many numbers they are (n,).
    ripe : per factor the stage (n,) from which its poses are known.
    """

    def __init__(self, graph: FactorGraph, values: Values, stage_size: int | None) -> None:
        self.parts, points = Parts(graph, values), seen_points(graph, values)
        # in SE2 or SE3, and not the place of a sensor
        places = {factor.keys[slot].kind for factor in graph.factors for slot in factor.unmoved}
        kinds = {kind for kind, stack in values.stacks.items() if stack.manifold in (SE2, SE3)} - places
        poses = {kind: values.stack(kind).numbers for kind in kinds}
        numbers = np.sort(np.concatenate([np.zeros(0, np.int64), *poses.values()]))
        stage_size = min(50, max(len(numbers) // 20, 1)) if stage_size is None else stage_size
        last = np.unique(numbers[stage_size - 1 : -1 : stage_size])  # of every stage but the last
        self.stages = len(last) + 1 if len(numbers) else 0
        self.born = {kind: np.searchsorted(last, n) for kind, n in poses.items()}
        self.placed: Masks = {kind: np.zeros(len(values.stack(kind)), dtype=bool) for kind in points}
        self.measured = {kind: np.zeros(len(placed), dtype=np.intp) for kind, placed in self.placed.items()}
        self.ripe = []
        for factor, index in zip(graph.factors, self.parts.index, strict=True):
            ripe = np.zeros(len(factor), dtype=np.intp)
            for keys, rows in zip(factor.keys, index, strict=True):
                if keys.kind in self.born:
                    ripe = np.maximum(ripe, self.born[keys.kind][rows])
            self.ripe.append(ripe)

    def reckoned(self, values: Values, stage: int) -> Values:
        """The poses of a stage chained from those before."""
        carry = [says_poses(f) or f.states("level_steps") or f.states("tilts") for f in self.parts.factors]
        steps = [(ripe == stage) & carries for ripe, carries in zip(self.ripe, carry, strict=True)]
        subgraph, within = self.parts.take(steps, {kind: born < stage for kind, born in self.born.items()}, values)
        if not len(subgraph):
            return values
        return put_back(values, dead_reckoning(subgraph, chain(subgraph, within)), subgraph.fixed)

    def located(self, values: Values, stage: int) -> Values:
        """The points that are measured in as many numbers as they have, for the first time, placed by their views."""
        views = [
            k for k, f in enumerate(self.parts.factors) if isinstance(f, Sighting) and f.keys[1].kind in self.placed
        ]
        for k in views:
            factor, now = self.parts.factors[k], self.ripe[k] == stage
            kind, dim = factor.keys[1].kind, values.gather(factor[:1])[0].dim
            self.measured[kind] += dim * np.bincount(self.parts.index[k][1][now], minlength=len(self.measured[kind]))
        new = {
            kind: ~placed & (self.measured[kind] >= values.stack(kind).manifold.dim)
            for kind, placed in self.placed.items()
        }
        sightings = [np.zeros(len(factor), dtype=bool) for factor in self.parts.factors]
        for k in views:
            sightings[k] = (self.ripe[k] <= stage) & self.parts.any(k, new)
        self.placed = {kind: placed | new[kind] for kind, placed in self.placed.items()}
        subgraph, within = self.parts.take(sightings, {}, values)
        if not len(subgraph):
            return values
        # a degree apart in a DIDSON; a search of 14 takes twice as long for the same start
        points = search_elevation(subgraph, locate_points(subgraph, within), steps=7)
        return put_back(values, points, subgraph.fixed)

    def optimized(self, values: Values, stage: int, everything: bool) -> tuple[Values, float]:
        """The known variables at their optimum, all or the poses of a stage and the points they see; chi2 per row."""
        known = self._known(stage)
        measurements, held = (known, {}) if everything else self._near(known, values, stage)
        subgraph, within = self.parts.take(measurements, held, values)
        if not len(subgraph):
            return values, 0.0
        enough = 1e-3 if everything else 1e-2  # a step that lowers chi2 by less is the last; 1e-2 bends Victoria Park
        # the damping holds elevations that are nearly free so far, or rounding decides on centimeters
        method = LevenbergMarquardt(Stop(max_iterations=20), _Falls(enough), 3e-3)
        try:
            result = subgraph.optimize(within, method)
        except UnderconstrainedError:
            return values, 0.0  # fewer measurements than unknowns so far
        rows = subgraph.pattern(within).measured_rows
        return put_back(values, result.values, subgraph.fixed), result.chi2_final / max(rows, 1)

    def _known(self, stage: int) -> list[Mask]:
        """Measurements (n,) by factor whose variables are known."""
        missing = {kind: ~placed for kind, placed in self.placed.items()}
        known = [(ripe <= stage) & ~self.parts.any(k, missing) for k, ripe in enumerate(self.ripe)]
        for rows, factor in zip(known, self.parts.factors, strict=True):
            if factor.opaque:  # that one waits for all its variables
                rows[:] = rows.all()
        return known

    def _near(self, known: list[Mask], values: Values, stage: int) -> tuple[list[Mask], Masks]:
        """Of what is known, the measurements (n,) of poses of this stage and of points they see; what is not moved."""
        moved = {kind: born == stage for kind, born in self.born.items()}
        sighted = {kind: np.zeros(len(placed), dtype=bool) for kind, placed in self.placed.items()}
        for k, factor in enumerate(self.parts.factors):
            now = known[k] & self.parts.any(k, moved)
            for keys, index in zip(factor.keys, self.parts.index[k], strict=True):
                if keys.kind in sighted:
                    sighted[keys.kind][index[now]] = True
        moved |= sighted
        held = {kind: ~moved[kind] if kind in moved else np.ones(len(s), bool) for kind, s in values.stacks.items()}
        return [rows & self.parts.any(k, moved) for k, rows in enumerate(known)], held


class _Falls:
    """A callback that stops when a step lowers chi2 by less than a part of it.

    `Stop.update_sigmas` would confirm that by an undamped solve and name what is free, such as the elevation of a
    landmark that was seen once so far: half of the time of a mission.
    """

    def __init__(self, fraction: float) -> None:
        self.fraction, self.before = fraction, math.inf

    def __call__(self, iteration: Iteration) -> bool:
        little = iteration.chi2 > (1 - self.fraction) * self.before
        self.before = iteration.chi2
        return little


def seen_points(graph: FactorGraph, values: Values) -> set[str]:
    """Kinds of points seen from poses."""
    kinds = {factor.keys[1].kind for factor in graph.factors if isinstance(factor, Sighting) and len(factor)}
    return {kind for kind in kinds if values.stack(kind).manifold not in (SE2, SE3)}
