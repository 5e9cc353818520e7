r"""Pairs of landmarks whose contacts were exchanged in one image: two rejected contacts, each fits the other landmark.

    s_ab = |W (z_a - h(x, l_b))|^2 <= q,     s_ba = |W (z_b - h(x, l_a))|^2 <= q

for two rejected contacts of landmarks a and b from one pose x, at an estimate without them; q is the 99 % quantile of
chi2 of two numbers. A false contact fits another landmark by accident, two at once hardly ever do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from factors.keys import Keys
from factors.replaced import replaced
from factors.sighting import Sighting
from models.algebra import Array, Index, Mask
from nls.analysis.chi_squared import chi2_gate
from nls.graph import FactorGraph
from nls.values import Values

__all__ = ["Exchanged", "exchanged_contacts"]

FITS = 0.99  # probability with which an exchanged contact fits the other landmark


@dataclass(frozen=True)
class Exchanged:
    """Two landmarks that were taken for one another.

    Attributes
    ----------
    first, second : the landmarks.
    places : number of the factor and index of every contact that was exchanged, two for each image.
    standing, chi2 : chi2 of these contacts with their own landmarks, and with each other's.
    """

    first: Keys
    second: Keys
    places: tuple[tuple[int, int], ...]
    standing: float
    chi2: float


def exchanged_contacts(graph: FactorGraph, values: Values, rejected: Sequence[Mask]) -> tuple[Exchanged, ...]:
    """Pairs of landmarks with exchanged contacts, those with the most first.

    Parameters
    ----------
    graph : with all contacts.
    values : an estimate without those that were rejected; contacts of landmarks without a value are passed over.
    rejected : per factor which of its measurements (n,) were; those that are no contacts are passed over.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> mission = sim.hauv_floor(np.random.default_rng(1), legs=2, per_leg=12, wrong_associations=0.02)
    >>> rejected = [mission.wrong if f is mission.contacts else np.zeros(len(f), bool) for f in mission.graph.factors]
    >>> pairs = exchanged_contacts(mission.graph, mission.truth, rejected)
    >>> bool(sum(len(pair.places) for pair in pairs) > 0.9 * mission.wrong.sum())
    True
    """
    exchanges: dict[tuple[str, int, int], list[tuple[int, int, float, float]]] = {}
    for number, (factor, mask) in enumerate(zip(graph.factors, rejected, strict=True)):
        if not isinstance(factor, Sighting) or not factor.contact or not mask.any():
            continue
        stack = values.stack(factor.keys[1].kind)
        rows = np.flatnonzero(mask & np.isin(factor.keys[1].numbers, stack.numbers))
        a, b = _together(factor.keys[0].numbers[rows])
        if not len(a):
            continue
        a, b = rows[a], rows[b]
        s_ab, s_ba = _misfit(factor, values, a, b), _misfit(factor, values, b, a)
        s_a, s_b = _misfit(factor, values, a, a), _misfit(factor, values, b, b)
        fits = np.maximum(s_ab, s_ba) <= chi2_gate(2, FITS)
        columns = (a, b, s_a, s_b, s_ab, s_ba)
        for i, j, own_a, own_b, at_b, at_a in zip(*(column[fits].tolist() for column in columns), strict=True):
            first, second = sorted(factor.keys[1].numbers[[i, j]].tolist())
            contacts = [(number, i, own_a, at_b), (number, j, own_b, at_a)]
            exchanges.setdefault((stack.kind, first, second), []).extend(contacts)
    pairs = []
    for (kind, first, second), contacts in exchanges.items():
        places = tuple((number, index) for number, index, *_ in contacts)
        standing, chi2 = (sum(column) for column in list(zip(*contacts, strict=True))[2:])
        pairs.append(Exchanged(Keys(kind, first), Keys(kind, second), places, standing, chi2))
    return tuple(sorted(pairs, key=lambda pair: -len(pair.places)))


def _together(pose: Index) -> tuple[Index, Index]:
    """All pairs of places of the same pose."""
    order = np.argsort(pose, kind="stable")
    _, count = np.unique(pose, return_counts=True)
    first = np.cumsum(count) - count
    size, start = np.repeat(count, count), np.repeat(first, count)
    a = np.repeat(np.arange(len(pose)), size)
    b = np.arange(len(a)) - np.repeat(np.cumsum(size) - size, size) + np.repeat(start, size)
    ahead = a < b
    return order[a[ahead]], order[b[ahead]]


def _misfit(factor: Sighting, values: Values, a: Index, b: Index) -> Array:
    """Squared whitened residuals of contacts a (k,) with the landmarks of contacts b."""
    contacts = factor[a]
    return replaced(contacts, [contacts.keys[0], factor.keys[1][b], *contacts.keys[2:]]).chi2(values)
