"""Whole kinds of measurements that fit when they are read otherwise: a wrong sign, order, or handedness of a frame.

A source is read otherwise as a whole, and the graph is solved from a start of its own. Then chi2 of both optima are
compared (`nls.analysis.alternatives`). Sources are all measurements of a type, steps and closures of it, and single
factors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from factors.base import Factor
from models.algebra import Index
from nls.analysis.alternatives import FIRST, expected, nearest, solved, supported
from nls.analysis.leave_one_out import kinds_of, middle_variance
from nls.analysis.readings import READINGS, Reading
from nls.graph import FactorGraph
from nls.sparse.pattern import Pattern, measuring
from nls.values import Values

__all__ = ["misread_kinds"]

MANY = 6  # measurements of a source that may be off alike
MIDDLE = 2.0  # variance of the middle measurement of a source that is read as it was meant, at most
NEAR = 10.0  # times the lowest chi2 after the first iterations: alternatives above that are given up
WORSE = 100.0  # times chi2 as it stands: starts above that lead nowhere; headings turned by 90 degrees begin at 6

Places = tuple[tuple[int, Index], ...]


@dataclass(frozen=True)
class MisreadKind:
    """A source of measurements that fits when it is read otherwise, and not as it stands.

    Attributes
    ----------
    kind : ``BearingRange``, ``Between``, ``Between, steps``, or ``Position, factor 3`` for one of several factors.
    places : number of the factor and indices (k,) of its measurements, for each factor that the source is made of.
    reading : a name of `nls.analysis.readings`.
    standing, chi2 : chi2 of the whole graph at the optimum as it stands, and as it was meant.
    dof : degrees of freedom of both.
    values : the optimum as it was meant.
    """

    kind: str
    places: Places
    reading: str
    standing: float
    chi2: float
    dof: int
    values: Values


def misread_kinds(graph: FactorGraph, values: Values) -> tuple[MisreadKind, ...]:
    """Sources of measurements with a wrong sign, order or frame, where noise does not explain chi2.

    Parameters
    ----------
    graph : not changed.
    values : its optimum.

    Returns
    -------
    tuple of MisreadKind
        The lowest chi2 first. Where there are several, nothing tells them apart: mirrored bearings against odometry,
        or mirrored odometry against bearings.

    Raises
    ------
    GraphError
        A variable of a factor has no value.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from factors.replaced import replaced
    >>> world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    >>> first, odometry, sightings = world.graph.factors
    >>> wrong = FactorGraph([first, odometry, replaced(sightings, z=sightings.z * [-1, 1])])
    >>> sorted((kind.kind, kind.reading) for kind in misread_kinds(wrong, wrong.optimize(world.start).values))
    [('BearingRange', 'mirrored'), ('Between', 'y flipped')]
    """
    standing = solved(graph, values, start=False)
    if standing is None or expected(standing):
        return ()
    again = solved(graph, values)
    if again is not None and again.chi2 < standing.chi2:
        standing = again
    if expected(standing):
        return ()
    alternatives = [
        (name, places, reading, factors)
        for name, places in _sources(graph.pattern(values)).items()
        for reading, read in READINGS.items()
        if (factors := _reread(graph, values, places, read)) is not None
    ]
    fits = [
        solved(FactorGraph([*reread, *other_factors], graph.fixed), standing.values, True, FIRST, WORSE * standing.chi2)
        for *_, (reread, other_factors) in alternatives
    ]
    lowest = min((fit.chi2 for fit in fits if fit is not None), default=0.0)
    meant = []
    for (name, places, reading, (reread, _)), begun in zip(alternatives, fits, strict=True):
        if begun is None or begun.chi2 > NEAR * lowest:
            continue
        fit = solved(begun.graph, begun.values, start=False)
        if fit is None or not supported(standing, fit, len(alternatives)) or _middle(reread, fit.values) > MIDDLE:
            continue
        meant.append(MisreadKind(name, places, reading, standing.chi2, fit.chi2, fit.dof, fit.values))
    return nearest(meant)


def _sources(pattern: Pattern) -> dict[str, Places]:
    """Measurements that may be off alike, each set of them once, the larger first."""
    types: dict[str, Places] = {}
    single: dict[str, Places] = {}
    for k, batch in enumerate(pattern.batches):
        factor = batch.model.factor
        if not factor.limit_only:
            place = (k, np.arange(len(batch)))
            types[factor.name] = (*types.get(factor.name, ()), place)
            single[f"{factor.name}, factor {k}"] = (place,)
    kinds = {name: tuple(kind) for name, kind in kinds_of(pattern, len(pattern.batches)).items()}
    sources: dict[str, Places] = {}
    known = set()
    for name, places in [*types.items(), *kinds.items(), *single.items()]:
        label = tuple((k, indices.tobytes()) for k, indices in places)
        if label not in known and sum(len(indices) for _, indices in places) >= MANY:
            known.add(label)
            sources[name] = places
    return sources


def _reread(
    graph: FactorGraph, values: Values, places: Places, read: Reading
) -> tuple[list[Factor], list[Factor]] | None:
    """The source read otherwise, and all other measurements; None where the reading makes no sense for the source."""
    chosen, reread, other_factors = dict(places), [], []
    for k, factor in enumerate(graph.factors):
        if k not in chosen:
            other_factors.append(factor)
            continue
        meant = read(values.gather(factor)[0])
        if meant is None:
            return None
        outside = np.ones(len(factor), dtype=bool)
        outside[chosen[k]] = False
        reread.append(meant[chosen[k]])
        if outside.any():
            other_factors.append(factor[outside])
    return reread, other_factors


def _middle(factors: list[Factor], values: Values) -> float:
    """Variance of the middle one of some measurements, relative to its noise; outliers do not move it."""
    chi2 = np.concatenate([factor.chi2(values) for factor in factors])
    m = np.concatenate([measuring(values.gather(factor)[0]) for factor in factors])
    return middle_variance(chi2[m > 0], m[m > 0]) if (m > 0).any() else math.inf
