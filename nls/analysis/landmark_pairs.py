"""The sightings of two landmarks, and which of them are exchanged where chi2 is lowest."""

from __future__ import annotations

import warnings

import numpy as np

from factors import Sighting
from factors.base import Factor
from factors.keys import Keys
from factors.replaced import replaced
from models.algebra import Array, Index, Mask
from models.errors import GraphWarning
from nls.analysis.alternatives import FIRST, REFUSED
from nls.graph import FactorGraph
from nls.optimizers import LevenbergMarquardt, Stop
from nls.starts import locate_points
from nls.values import Values

BEGINNINGS = (1.0, 0.5, 0.25, 0.75)  # part of the sightings after which they are exchanged
TURNS = 4  # of locating the landmarks and choosing what is exchanged


def landmark_factors(graph: FactorGraph, values: Values) -> list[int]:
    """Numbers of the factors that see landmarks."""
    numbers = []
    for k, factor in enumerate(graph.factors):
        if isinstance(factor, Sighting):
            manifolds = values.gather(factor)[0].manifolds
            if manifolds[1] is not manifolds[0]:
                numbers.append(k)
    return numbers


class Pair:
    """The sightings of two landmarks; those of one landmark from one pose are one sighting, whichever factors say so.

    Attributes
    ----------
    n : number of sightings, by the number of their pose.
    """

    def __init__(self, graph: FactorGraph, values: Values, pair: Keys) -> None:
        self.graph, self.values, self.pair = graph, values, pair
        self.rows: dict[int, Index] = {}
        labels = []
        for k in landmark_factors(graph, values):
            pose, target = graph.factors[k].keys[:2]
            if target.kind == pair.kind and len(rows := np.flatnonzero(np.isin(target.numbers, pair.numbers))):
                self.rows[k] = rows
                labels.append(np.column_stack([pose.numbers[rows], target.numbers[rows]]))
        sightings, group = np.unique(np.concatenate(labels), axis=0, return_inverse=True)
        self.n = len(sightings)
        ends = np.cumsum([len(rows) for rows in self.rows.values()])
        self.group = dict(zip(self.rows, np.split(group.reshape(-1), ends[:-1]), strict=True))
        self.parts = {k: graph.factors[k][rows] for k, rows in self.rows.items()}
        priors = [f for f in graph.factors if f.frame == "world" and f.keys[0].kind == pair.kind]
        self.priors = [f[mask] for f in priors if (mask := np.isin(f.keys[0].numbers, pair.numbers)).any()]

    def _relabelled(self, factor: Factor, mask: Mask) -> Factor:
        """The factor with the two landmarks exchanged in some measurements (n,)."""
        pose, target, *sensors = factor.keys
        a, b = self.pair.numbers
        numbers = np.where(target.numbers == a, b, np.where(target.numbers == b, a, target.numbers))
        return replaced(factor, [pose, Keys(target.kind, np.where(mask, numbers, target.numbers)), *sensors])

    def local(self, exchanged: Mask) -> FactorGraph:
        """Sightings and priors of the two, everything else held."""
        factors = [self._relabelled(sightings, exchanged[self.group[k]]) for k, sightings in self.parts.items()]
        held = [keys for factor in factors for slot, keys in enumerate(factor.keys) if slot != 1]
        return FactorGraph([*factors, *self.priors], held)

    def whole(self, exchanged: Mask) -> FactorGraph:
        """The graph with some sightings (n,) exchanged."""
        factors = list(self.graph.factors)
        for k, rows in self.rows.items():
            mask = np.zeros(len(factors[k]), dtype=bool)
            mask[rows] = exchanged[self.group[k]]
            if mask.any():
                factors[k] = self._relabelled(factors[k], mask)
        return FactorGraph(factors, self.graph.fixed)

    def places(self, exchanged: Mask) -> tuple[tuple[int, int], ...]:
        """Number of the factor and index of the measurements of some sightings (n,)."""
        chosen = {k: rows[exchanged[self.group[k]]] for k, rows in self.rows.items()}
        return tuple((k, i) for k, rows in chosen.items() for i in rows.tolist())

    def nearer(self, values: Values) -> Mask:
        """Sightings (n,) whose chi2 is lower with the other landmark."""
        gain: Array = np.zeros(self.n)
        for k, sightings in self.parts.items():
            swapped = self._relabelled(sightings, np.ones(len(sightings), dtype=bool))
            gain += np.bincount(self.group[k], sightings.chi2(values) - swapped.chi2(values), minlength=self.n)
        return gain > 0

    def best(self) -> tuple[Mask, Array] | None:
        """Which sightings (n,) are exchanged where chi2 is lowest, and the landmarks (2, d); poses stay."""
        damped = LevenbergMarquardt(Stop(max_iterations=FIRST))
        fits = []
        for beginning in BEGINNINGS:
            exchanged = np.arange(self.n) >= beginning * self.n
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", GraphWarning)  # other variables are not touched
                    for _ in range(TURNS):
                        graph = self.local(exchanged)
                        result = graph.optimize(locate_points(graph, self.values), damped)
                        fits.append((result.chi2_final, exchanged, result.values[self.pair]))
                        nearer = self.nearer(result.values)
                        if (nearer == exchanged).all():
                            break
                        exchanged = nearer
            except REFUSED:
                continue
        if not fits:
            return None
        _, exchanged, points = min(fits, key=lambda fit: (fit[0], int(fit[1].sum())))
        if 2 * exchanged.sum() > self.n and not self.priors:
            exchanged, points = ~exchanged, points[::-1]
        return exchanged, points
