r"""A graph beside another that says something else of the same measurements: which of the two do they support?

Two readings have as many unknowns and as many degrees of freedom, so their likelihoods compare. Under the first one

    P(chi2_0 - chi2_1 >= 2 ln k) <= 1/k

whatever the second is, because the expected likelihood ratio is 1 (J. Ville, "Etude critique de la notion de
collectif", 1939). Where the sigmas are too small by s, all falls are too large by s^2, which chi2_1 / dof estimates.
"""

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from factors import Position, Sighting
from models import SE2, SE3
from models.alignment import align
from models.chi_squared import chi2_tail
from models.errors import EvaluationError, GraphError, GraphWarning, SingularGeometryError, UnderconstrainedError
from nls.graph import FactorGraph
from nls.linear.factorization import SingularSystemError
from nls.optimizers import LevenbergMarquardt, Stop
from nls.starts import initialize
from nls.values import Values

UNLIKELY = 1e-3  # chance of a false alarm, all tries of one question together
EQUAL = 2 * math.log(1 / UNLIKELY)  # alternatives whose chi2 differ by less are not distinguished
HALF_CHI2 = 0.5  # chi2 of what explains the measurements is at most this part of the other, where sigmas are unknown
FIRST = 10  # of these, after which an alternative that is worse than others is given up
REFUSED = (SingularSystemError, EvaluationError, GraphError, UnderconstrainedError, SingularGeometryError)


def aligned(graph: FactorGraph, values: Values) -> Values:
    """Poses chained by odometry and points seen from them, all moved by one motion onto the measured positions.

    Parameters
    ----------
    graph : its `Position` factors of all coordinates say where the poses are.
    values : every variable.

    Raises
    ------
    UnderconstrainedError
        No positions are measured.
    SingularGeometryError
        The positions leave a rotation free.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Between, Isotropic
    >>> from nls import kinds
    >>> (x,) = kinds("x")
    >>> step = Between(x[[0, 1]], x[[1, 2]], [1.0, 0.0, 0.0], Isotropic(0.1))
    >>> fixes = Position(x[[0, 2]], [[5.0, 1.0], [5.0, 3.0]], Isotropic(0.1))
    >>> aligned(FactorGraph([step, fixes]), Values({x: (SE2, SE2.identity(3))}))[x].round(3).tolist()
    [[5.0, 1.0, 1.571], [5.0, 2.0, 1.571], [5.0, 3.0, 1.571]]
    """
    fixes = [f for f in graph.factors if isinstance(f, Position) and f.components is None]
    groups = {values.gather(factor)[0].manifolds[0] for factor in fixes}
    if len(groups) != 1:
        raise UnderconstrainedError("no positions are measured in one group of poses")
    (group,) = groups
    assert group in (SE2, SE3)
    start = initialize(graph, values, "odometry")[0]
    measured, positions = [], []
    for factor in fixes:
        model, X = start.gather(factor)
        measured.append(model.z)
        positions.append(model.factor.predict(model.manifolds, *X)[0])
    T = align(np.concatenate(measured), np.concatenate(positions))
    points = {factor.keys[1].kind for factor in graph.factors if isinstance(factor, Sighting)}
    moved = {}
    for kind, stack in start.stacks.items():
        if stack.manifold is group:
            moved[kind] = group.compose(T, stack.X)
        elif kind in points:
            moved[kind] = group.act(T, stack.X)
    return start.replaced(moved)


WORK = 2_800_000  # measurements times iterations of all tries of one explanation; 20 to 30 s
_LEFT: ContextVar[float] = ContextVar("left", default=math.inf)


class SpentError(Exception):
    """The work that is left does not suffice for the next try."""


@contextmanager
def bounded(work: float) -> Iterator[None]:
    """At most so much work, measurements times iterations, for all that is `solved` inside."""
    token = _LEFT.set(work)
    try:
        yield
    finally:
        _LEFT.reset(token)


def need(graph: FactorGraph, tries: int = 1) -> None:
    """Refuse tries for which too little work is left: `FIRST` iterations each.

    Raises
    ------
    SpentError
    """
    if _LEFT.get() < tries * FIRST * len(graph):
        raise SpentError


STARTS: dict[str, Callable[[FactorGraph, Values], Values]] = {  # the others of `nls.starts` cost several solves
    "chordal": lambda graph, values: initialize(graph, values, "chordal")[0],
    "odometry": lambda graph, values: initialize(graph, values, "odometry")[0],
    "aligned": aligned,
    "values": lambda graph, values: values,
}


class Judged(Protocol):
    """An optimum with chi2 and degrees of freedom."""

    @property
    def chi2(self) -> float: ...
    @property
    def dof(self) -> int: ...


J = TypeVar("J", bound=Judged)


@dataclass(frozen=True)
class Fit:
    """The optimum of one alternative.

    Attributes
    ----------
    graph : its measurements.
    values : the optimum.
    chi2, dof : there; with robust kernels chi2 is the sum of their costs.
    """

    graph: FactorGraph
    values: Values
    chi2: float
    dof: int


def solved(
    graph: FactorGraph, values: Values, start: bool = True, iterations: int = 50, limit: float = math.inf
) -> Fit | None:
    """The best optimum of a graph from its starts, or from these values alone; None where there is none.

    Parameters
    ----------
    graph, values : the measurements, and a start.
    start : whether there are other starts: chordal relaxation, odometry, odometry moved onto positions. The first one
        that leads to a chi2 that noise explains is taken.
    iterations : at most, from each start; the last values count, converged or not.
    limit : starts whose chi2 is above it are left out.

    Raises
    ------
    SpentError
        Too little work is left.
    """
    if not math.isinf(_LEFT.get()):
        iterations = max(FIRST, min(iterations, WORK // (4 * len(graph))))  # a quarter of the work at most
    best: Fit | None = None
    damped = LevenbergMarquardt(Stop(max_iterations=iterations))
    tried: list[float] = []  # chi2 of the starts
    for name in STARTS if start else ["values"]:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", GraphWarning)  # the user's own solve has given them
                begin = STARTS[name](graph, values)
                chi2 = graph.chi2(begin)
                if chi2 > limit or any(math.isclose(chi2, other, rel_tol=1e-6) for other in tried):
                    continue
                tried.append(chi2)
                need(graph)
                result = graph.optimize(begin, damped)
        except REFUSED:
            continue
        _LEFT.set(_LEFT.get() - result.iterations * len(graph))
        if best is None or result.chi2_final < best.chi2:
            best = Fit(graph, result.values, result.chi2_final, result.dof)
        if expected(best):
            break
    return best


def expected(fit: Judged) -> bool:
    """Whether noise explains chi2: its chance is at least 1e-3."""
    return bool(chi2_tail(np.array(fit.chi2), np.array(fit.dof)) >= UNLIKELY)


def nearest(fits: Sequence[J]) -> tuple[J, ...]:
    """The optima of the lowest chi2, which the data do not distinguish, the lowest first."""
    ordered = sorted(fits, key=lambda fit: fit.chi2)
    limit = ordered[0].chi2 + EQUAL * scale(ordered[0]) if ordered else 0.0
    return tuple(fit for fit in ordered if fit.chi2 <= limit)


def scale(fit: Judged) -> float:
    """By how much the sigmas squared are too small, 1 at least."""
    return max(1.0, fit.chi2 / max(fit.dof, 1))


def decisive(standing: Fit, other: Fit, tries: int) -> bool:
    """Whether chi2 of another graph, as one of so many tries, is lower than chance makes it."""
    return standing.chi2 - other.chi2 > 2 * (math.log(tries) - math.log(UNLIKELY)) * scale(other)


def supported(standing: Fit, other: Fit, tries: int) -> bool:
    """Whether the measurements support another graph instead of the one that stands, as one of so many tries.

    Notes
    -----
    Noise must explain chi2 of the other, or it must be at most half of the one that stands. Wrong closures and sigmas
    that are off remain under every reading.
    """
    return decisive(standing, other, tries) and (expected(other) or other.chi2 <= HALF_CHI2 * standing.chi2)
