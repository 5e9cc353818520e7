r"""Start by solving the graph as it grows: for landmarks under an odometry that drifts too far for one solve.

Poses are taken in the order of their numbers, a stage at a time:

    1. new poses are dead-reckoned from the last optimized ones,
    2. points seen for the first time are placed where the optimized and reckoned poses saw them,
    3. the graph of all factors whose variables are known by now is optimized.

A landmark seen again pulls the trajectory back while it is off by the drift of one stage; seen again at the end, after
the drift of the whole run, it pulls towards the nearest of many minima. Levenberg-Marquardt does the stages: a point
may be known in some direction only.

Source: M. Kaess, A. Ranganathan, F. Dellaert, "iSAM: incremental smoothing and mapping", T-RO 2008 (which updates the
factorization at every pose instead); the cure is older than that, and is how a vehicle would do it on its way.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.base import Factor
from factors.between import Between
from factors.function import FunctionFactor
from factors.keys import Keys
from factors.seen import Seen
from models import SE2, SE3
from models.errors import OptionError, UnderconstrainedError
from nls.graph import FactorGraph
from nls.optimizers import LevenbergMarquardt, Stop
from nls.starts.chain import chain
from nls.starts.landmarks import locate_points
from nls.values import Values

__all__ = ["incremental", "sees_points"]

Known = dict[str, npt.NDArray[np.bool_]]  # per kind (n,), in the order of its stack
STAGE = Stop(max_iterations=20, chi2_rtol=1e-3)  # more digits are the business of the last solve


def incremental(graph: FactorGraph, values: Values, stages: int = 20) -> Values:
    """Poses and points from a graph that is solved while it grows, pose by pose in the order of their numbers.

    Parameters
    ----------
    graph : `Between` factors carry the poses on, `Landmark`, `Range` and their like place the points; all factors whose
        variables are known are optimized.
    values : every variable. Of the poses only the first of each component matters, and fixed ones, which stay.
        Variables that are neither poses nor points seen from them are known from the beginning, at these values.
    stages : in how many parts the poses are taken, at least 1.

    Returns
    -------
    Values

    Raises
    ------
    OptionError
        Stages below 1.
    EvaluationError, SingularGeometryError
        The graph of some stage cannot be evaluated where its variables were put.

    Notes
    -----
    A stage that measures less than it has unknowns is dead-reckoned only: the next one has more. All stages together
    cost about ``stages`` / 2 solves of the whole. On the Victoria Park graph (6969 poses, 151 trees) odometry starts at
    a chi2 of 1.3e8, from which a hundred steps of Levenberg-Marquardt reach 9.5e5; this start has 6184.2 after 3 s, and
    the optimum is 6184.1.

    Examples
    --------
    >>> from factors import Between, Isotropic, Landmark
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> from nls.starts import incremental
    >>> x, l = kinds("x", "l")
    >>> walk = Between(x[[0, 1]], x[[1, 2]], [[1, 0, 0.1], [1, 0, 0]], Isotropic(0.1))
    >>> seen = Landmark(x[[0, 1, 2]], l[0], [[2.0, 1.0], [1.0, 1.0], [0.0, 1.0]], Isotropic(0.01))
    >>> start = Values({x: (SE2, SE2.identity(3)), l: (R(2), [0.0, 0.0])})
    >>> incremental(FactorGraph([walk, seen]), start, stages=3)[x[2]].round(2)
    array([2.03, 0.  , 0.03])
    """
    if stages < 1:
        raise OptionError("stages", stages, "a number of at least 1")
    poses, points = _poses(graph, values), _points(graph, values)
    numbers = np.sort(np.concatenate([np.zeros(0, np.int64), *(values.stack(kind).numbers for kind in poses)]))
    if not len(numbers):
        return values
    growing = poses | set(points)
    known = {kind: np.full(len(stack), kind not in growing) for kind, stack in values.stacks.items()}
    for last in np.unique(numbers[np.linspace(0, len(numbers), stages + 1).astype(int)[1:] - 1]):
        before = known
        known = before | {kind: values.stack(kind).numbers <= last for kind in poses}
        walked = _part(graph, values, known, Between)
        walked.fixed += _keys(values, {kind: before[kind] for kind in poses})
        values = chain(walked, values)

        known |= {kind: _determined(graph, values, known, kind) for kind in points}
        seen = _part(graph, values, known, Seen)
        seen.fixed += _keys(values, {kind: before[kind] & complete for kind, complete in points.items()})
        values = _optimized(_part(graph, values, known), locate_points(seen, values))
    return values


def sees_points(graph: FactorGraph, values: Values) -> bool:
    """Whether a factor of the graph sees a point from a pose."""
    return bool(_points(graph, values))


def _poses(graph: FactorGraph, values: Values) -> set[str]:
    """Kinds of poses: in SE2 or SE3, and not the place of a sensor."""
    places = {factor.keys[slot].kind for factor in graph.factors for slot in factor.unmoved}
    return {kind for kind, stack in values.stacks.items() if stack.manifold in (SE2, SE3)} - places


def _points(graph: FactorGraph, values: Values) -> Known:
    """Kinds of points seen from poses, and which of them some measurement places on its own."""
    points: Known = {}
    for factor in graph.factors:
        if isinstance(factor, Seen) and len(factor):
            stack = values.stack(factor.keys[1].kind)
            if stack.manifold not in (SE2, SE3):
                complete = points.setdefault(stack.kind, np.zeros(len(stack), dtype=bool))
                complete[stack.index(factor.keys[1])] |= factor.locates
    return points


def _determined(graph: FactorGraph, values: Values, known: Known, kind: str) -> npt.NDArray[np.bool_]:
    """Points (n,) of a kind that known variables measure in as many numbers as a point has."""
    stack = values.stack(kind)
    measured = np.zeros(len(stack), dtype=np.intp)
    for factor in _part(graph, values, known | {kind: np.ones(len(stack), dtype=bool)}, Seen).factors:
        if factor.keys[1].kind == kind:
            model, _ = values.gather(factor)
            measured += model.dim * np.bincount(stack.index(factor.keys[1]), minlength=len(stack))
    return measured >= stack.manifold.dim


def _part(graph: FactorGraph, values: Values, known: Known, kind: type[object] = Factor) -> FactorGraph:
    """The measurements, of one type or all, whose variables are known; the known ones that are fixed."""
    part = FactorGraph()
    for factor in graph.factors:
        if isinstance(factor, kind):
            each = [known[keys.kind][values.stack(keys.kind).index(keys)] for keys in factor.keys]
            inside = np.logical_and.reduce(each)
            if inside.all():
                part.add(factor)
            elif inside.any() and not isinstance(factor, FunctionFactor):  # that one waits for all its variables
                part.add(factor[inside])
    part.fixed = [keys[known[keys.kind][values.stack(keys.kind).index(keys)]] for keys in graph.fixed]
    return part


def _keys(values: Values, wanted: Known) -> list[Keys]:
    return [Keys(kind, values.stack(kind).numbers[mask]) for kind, mask in wanted.items()]


def _optimized(part: FactorGraph, values: Values) -> Values:
    """Values with the variables of a part of the graph at its optimum, where it has one."""
    if not len(part):
        return values
    touched = {kind: np.zeros(len(stack), dtype=bool) for kind, stack in values.stacks.items()}
    for keys in (keys for factor in part.factors for keys in factor.keys):
        touched[keys.kind][values.stack(keys.kind).index(keys)] = True
    stacks = {kind: values.stack(kind) for kind, mask in touched.items() if mask.any()}
    within = Values({k: (s.manifold, s.X[touched[k]], s.numbers[touched[k]]) for k, s in stacks.items()})
    part.fixed = [
        keys[np.isin(keys.numbers, within.stack(keys.kind).numbers)] for keys in part.fixed if keys.kind in stacks
    ]
    try:
        found = part.optimize(within, LevenbergMarquardt(STAGE)).values
    except UnderconstrainedError:
        return values  # fewer measurements than unknowns so far
    X = {kind: np.array(stack.X) for kind, stack in stacks.items()}
    for kind in X:
        X[kind][touched[kind]] = found.stack(kind).X
    return values.replaced(X)
