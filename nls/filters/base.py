r"""Common base of filters: the graph cut into steps, the interface of a filter, the record of a run.

A step is a pose, the factors from the pose before it (`motion`), and all others whose latest pose it is
(`observations`). They are the factors of the graph, with fewer measurements each: nothing is modelled a second time.

    steps(graph, values)            -> [Step, Step, ...]        by rising number of the pose
    filter.start(step, values)      first step: the prior of the first pose, and the sightings from there
    filter.step(step)               every other one
    filter.pose, filter.landmarks   the present estimate
    filter.run(graph, values)       -> Track                    all of it
"""

from abc import abstractmethod
from dataclasses import dataclass, field
from itertools import pairwise
from time import perf_counter

import numpy as np

from factors.base import Factor
from factors.keys import Keys, Kind
from models import Manifold
from models.abstract import Abstract
from models.algebra import Array, Index
from models.errors import GraphError
from nls.filters.consistency import nees
from nls.graph import FactorGraph
from nls.metrics import TrajectoryError, ate
from nls.sparse.threads import single_thread
from nls.values import Values, refuse_other

POSE = "x"  # the kind whose numbers are the steps of time; the other kind of a graph are its landmarks


@dataclass(frozen=True)
class Step:
    """The input of a filter at one step.

    Attributes
    ----------
    pose : the pose of this step, one variable.
    motion : factors between the pose before and this one, one measurement each; empty at the first step.
    observations : all other factors whose latest pose this is, as batches. First come priors of landmarks that are seen
        here for the first time, then the rest in the order of the graph.
    """

    pose: Keys
    motion: list[Factor] = field(default_factory=list)
    observations: list[Factor] = field(default_factory=list)


def landmark_kind(graph: FactorGraph) -> str | None:
    """The one kind of variables of a graph beside its poses; None where there is none.

    Raises
    ------
    GraphError
        Several such kinds.
    """
    kinds = {keys.kind: keys for factor in graph.factors for keys in factor.keys if keys.kind != POSE}
    if len(kinds) > 1:
        raise GraphError(
            f"filters know poses, kind {POSE}, and one kind of landmarks; this graph has kinds {', '.join(kinds)}. "
            "Use one number range for all landmarks; give fixed quantities, such as the offset of a sensor, as numbers",
            [keys[[0]] for keys in kinds.values()],
        )
    return next(iter(kinds), None)


def steps(graph: FactorGraph, values: Values) -> list[Step]:
    """A graph cut into the measurements at each pose, poses in the order of their numbers.

    Parameters
    ----------
    graph : over poses of kind ``x``, whose numbers are the order of time, and landmarks of one other kind.
    values : every variable; only the spaces and which poses there are matter.

    Returns
    -------
    list of Step
        A prior of a landmark alone is at the step that sees the landmark first, or the first step if none does.

    Raises
    ------
    GraphError
        No poses; a pose without a factor from the one before; fixed variables; several kinds of landmarks.

    Examples
    --------
    >>> from factors import Between, Isotropic, Landmark, Prior
    >>> from models import SE2, R
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> graph = FactorGraph([
    ...     Prior(x[3], [0, 0, 0], Isotropic(0.1)),
    ...     Between(x[[3, 5]], x[[5, 6]], [[1, 0, 0], [1, 0, 0]], Isotropic(0.1)),
    ...     Landmark(x[[6, 5, 6]], l[[8, 8, 9]], [[1, 0], [2, 0], [1, 1]], Isotropic(0.1)),
    ... ])
    >>> values = Values({x: (SE2, SE2.identity(3), [3, 5, 6]), l: (R(2), [[3, 0], [3, 1]], [8, 9])})
    >>> for step in steps(graph, values):
    ...     print(step.pose, step.motion, step.observations)
    x3 [] [Prior(x3)]
    x5 [Between(x3, x5)] [Landmark(x5, l8)]
    x6 [Between(x5, x6)] [Landmark(x[6, 6], l[8, 9])]
    """
    if (held := next((keys for keys in graph.fixed if len(keys)), None)) is not None:
        cure = "release it with `graph.release` and add a Prior with its sigmas"
        raise GraphError(f"{held[[0]]} is fixed, which a filter does not support: {cure}", [held])
    landmark_kind(graph)
    numbers = np.sort(values.stack(POSE).numbers)
    if not len(numbers):
        raise GraphError(f"Values hold no poses, kind {POSE}: there is nothing to step through")
    cut = [Step(Keys(POSE, number)) for number in numbers.tolist()]
    first: dict[int, int] = {}  # landmark -> the step that sees it first
    alone: list[Factor] = []
    for factor in graph.factors:
        if not len(factor):
            continue
        values.gather(factor)  # bound now: what does not fit is refused as a whole, and its parts know their size
        poses = [keys.numbers for keys in factor.keys if keys.kind == POSE]
        if not poses:
            alone.append(factor)
            continue
        at = np.searchsorted(numbers, np.stack(poses))  # (slots, n)
        last, earliest = at.max(axis=0), at.min(axis=0)
        moves = len(poses) == len(factor.keys) == 2
        for k, rows in _groups(last):
            follow = (last[rows] - earliest[rows] == 1) & moves
            cut[k].motion.extend(_rows_of(factor, row[None]) for row in rows[follow])
            if not follow.all():
                cut[k].observations.append(_rows_of(factor, rows[~follow]))
        for keys in factor.keys:
            if keys.kind != POSE:
                for number, k in zip(keys.numbers.tolist(), last.tolist(), strict=True):
                    first[number] = min(first.get(number, k), k)
    for factor in reversed(alone):
        steps_of_first = np.array([[first.get(n, 0) for n in keys.numbers.tolist()] for keys in factor.keys])
        for k, rows in _groups(steps_of_first.max(axis=0)):
            cut[k].observations.insert(0, _rows_of(factor, rows))
    for before, step in pairwise(cut):
        if not step.motion:
            cure = "Add the odometry, or number the poses in the order of time"
            message = (
                f"{step.pose} has no factor from {before.pose}, the pose before it: a filter cannot follow. {cure}"
            )
            raise GraphError(message, [before.pose, step.pose])
    return cut


def _rows_of(factor: Factor, rows: Index) -> Factor:
    """Some measurements of a factor; all of them are the factor itself, which may be one that cannot be cut."""
    return factor if len(rows) == len(factor) else factor[rows]


def _groups(at: Index) -> list[tuple[int, Index]]:
    """Steps (k) that occur in (n,), and the measurements of each."""
    order = np.argsort(at, kind="stable")
    where, begins = np.unique(at[order], return_index=True)
    return list(zip(where.tolist(), np.split(order, begins[1:]), strict=True))


@dataclass(frozen=True)
class Track:
    """The estimates of a filter, step by step, and in the end.

    Attributes
    ----------
    method : which filter, with its options.
    x : the poses, in the order of time.
    manifold : their space.
    X, P : (n, size) and (n, d, d), every pose and its covariance at the time it was the latest. P is in the tangent
        space at X: axes of the body, position in m before angles in rad.
    values : the poses in the final estimate (those of X where nothing is smoothed), and the landmarks that
        were found.
    landmarks, P_landmarks : the landmarks in `values` and (m, d, d) their covariances in the end.
    seconds : (n,) of every step.
    """

    method: str
    x: Keys
    manifold: Manifold
    X: Array
    P: Array
    values: Values
    landmarks: Keys
    P_landmarks: Array
    seconds: Array

    def nees(self, truth: Values) -> Array:
        """Normalized squared errors (n,) of the poses when they were the latest, `nls.filters.consistency.nees`."""
        return nees(self.x, self.manifold, self.X, self.P, truth[self.x])

    def ate(self, truth: Values, align: str = "none", smoothed: bool = False) -> TrajectoryError:
        """Absolute trajectory error of the poses when they were the latest; smoothed: by the final estimate."""
        return ate(self.values[self.x] if smoothed else self.X, truth[self.x], align)

    def landmark_errors(self, truth: Values) -> Array:
        """Steps (m, d) of the landmarks from the truth to the final estimate: dX and dY of points."""
        return self.values.stack(self.landmarks.kind).manifold.local(truth[self.landmarks], self.values[self.landmarks])


class Filter(Abstract):
    """An estimator that takes a step at a time. A subclass gives `start`, `step`, `pose` and `landmarks`."""

    @property
    def method(self) -> str:
        """Name and options of the filter, for reports."""
        return type(self).__name__

    @abstractmethod
    def start(self, step: Step, values: Values) -> None:
        """Forget everything and take the first step; the values say which spaces, and where to start solving."""

    @abstractmethod
    def step(self, step: Step) -> None:
        """Take the next step."""

    @property
    @abstractmethod
    def pose(self) -> tuple[Array, Array]:
        """The latest pose X (size,) and its covariance P (d, d) in the tangent space at X."""

    @property
    @abstractmethod
    def landmarks(self) -> tuple[Keys, Array, Array]:
        """The landmarks found so far, L (m, size) and their covariances P (m, d, d)."""

    def smoothed(self) -> Array | None:
        """All poses (n, size) of the present estimate, in the order of time; None where nothing is smoothed."""
        return None

    @single_thread()
    def run(self, graph: FactorGraph, values: Values) -> Track:
        """All steps of a graph.

        Parameters
        ----------
        graph : the measurements, as `steps` takes them.
        values : every variable; the spaces and which poses there are matter, and the values where a start is needed.

        Returns
        -------
        Track

        Raises
        ------
        GraphError
            A graph that cannot be cut into steps, or with factors the filter does not know.
        UnderconstrainedError
            A first pose or a landmark that the measurements of its step do not determine.
        """
        refuse_other(f"{type(self).__name__}.run", graph, values)
        cut, kind = steps(graph, values), landmark_kind(graph)
        values = Values.of(values.stack(name) for name in (POSE, kind) if name is not None)
        X, P, seconds = [], [], []
        for step in cut:
            began = perf_counter()
            if step is cut[0]:
                self.start(step, values)
            else:
                self.step(step)
            seconds.append(perf_counter() - began)
            latest, covariance = self.pose
            X.append(latest.copy())
            P.append(covariance.copy())
        x, manifold = Keys(POSE, [int(step.pose.numbers[0]) for step in cut]), values.stack(POSE).manifold
        smoothed = self.smoothed()
        keys, L, P_landmarks = self.landmarks
        final = Values({Kind(POSE): (manifold, np.stack(X) if smoothed is None else smoothed, x.numbers)})
        if len(keys):
            final.add(Kind(keys.kind), values.stack(keys.kind).manifold, L, keys.numbers)
        return Track(self.method, x, manifold, np.stack(X), np.stack(P), final, keys, P_landmarks, np.array(seconds))
