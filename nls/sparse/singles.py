"""Measurements that were added one by one, in batches: a graph grows by single steps and is evaluated by batches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from factors.base import Factor, Model
from factors.joined import batch_of, grouped
from nls.values import Values

__all__ = ["Singles"]

MANY = 32  # single measurements of one kind, from which on they are one batch


class Singles:
    """Which batches were made of single measurements, and of which."""

    def __init__(self) -> None:
        self._made: list[tuple[Factor, list[Factor]]] = []  # a batch, and its rows as they were given

    def joined(self, factors: Sequence[Factor], values: Values) -> list[Factor]:
        """The same measurements: those of one each in batches, a batch in the place of its first.

        Parameters
        ----------
        factors : of a graph, some of them batches that were made here before.
        values : of their variables.
        """
        fresh = [factor for factor in factors if len(factor) == 1 and not factor.opaque]
        if len(fresh) < MANY:
            return list(factors)
        parts = {id(factor): [factor] for factor in fresh} | {id(batch): rows for batch, rows in self._made}
        models = [_bound(factor, values) for factor in factors if id(factor) in parts]
        batches: dict[int, list[Factor]] = {}  # in the place of a factor
        for group in grouped(models):
            rows = [row for model in group for row in parts[id(model.factor)]]
            if len(group) > 1 and len(rows) >= MANY:
                batch = batch_of(group)
                batches |= {id(model.factor): [] for model in group} | {id(group[0].factor): [batch]}
                self._made.append((batch, rows))
        self._made = [made for made in self._made if id(made[0]) not in batches]
        return [new for factor in factors for new in batches.get(id(factor), [factor])]

    def without(self, factors: Sequence[Factor], factor: Factor) -> list[Factor] | None:
        """The factors without one that was given alone; None where it is in none of their batches."""
        for k, (batch, rows) in enumerate(self._made):
            place = next((k for k, row in enumerate(rows) if row is factor), None)
            if place is not None:
                rest = batch[np.arange(len(batch)) != place]
                rows = rows[:place] + rows[place + 1 :]
                self._made[k : k + 1] = [(rest, rows)] if rows else []
                return [rest if f is batch else f for f in factors if f is not batch or rows]
        return None


def _bound(factor: Factor, values: Values) -> Model:
    return factor.bind(*(values.stack(keys.kind).manifold for keys in factor.keys))
