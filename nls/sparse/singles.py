"""Measurements that were added one by one, in batches: a graph grows by single steps and is evaluated by batches."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from factors.base import Factor
from factors.joined import batch_of, bound_batch, joined_noise, sort_of
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
        groups: dict[Hashable, list[Factor]] = {}
        for factor in factors:
            if id(factor) in parts:
                groups.setdefault(sort_of(factor), []).append(factor)
        batches: dict[int, Factor] = {}  # by the identity of its first
        gone: set[int] = set()
        for group in groups.values():
            rows = [row for factor in group for row in parts[id(factor)]]
            if len(group) > 1 and len(rows) >= MANY:
                batch = _batch(group, values)
                batches[id(group[0])] = batch
                gone |= {id(factor) for factor in group}
                self._made.append((batch, rows))
        self._made = [made for made in self._made if id(made[0]) not in gone]
        rest = [batches.pop(id(factor), None) if id(factor) in gone else factor for factor in factors]
        return [factor for factor in rest if factor is not None]

    def without(self, factors: Sequence[Factor], factor: Factor) -> list[Factor] | None:
        """The factors without one that was given alone; None where it is in none of their batches."""
        for k, (batch, rows) in enumerate(self._made):
            if not any(f is batch for f in factors):
                continue
            place = next((k for k, row in enumerate(rows) if row is factor), None)
            if place is not None:
                rest = batch[np.arange(len(batch)) != place]
                rows = rows[:place] + rows[place + 1 :]
                self._made[k : k + 1] = [(rest, rows)] if rows else []
                return [rest if f is batch else f for f in factors if f is not batch or rows]
        return None


def _batch(group: Sequence[Factor], values: Values) -> Factor:
    """Factors of one sort as one; bound one by one only where their noises differ in type."""
    noise = joined_noise([factor.noise for factor in group], [len(factor) for factor in group])
    sizes = {factor.z.size // len(factor) for factor in group}
    if noise is None or len(sizes) > 1:
        spaces = [values.stack(keys.kind).manifold for keys in group[0].keys]  # of one sort: of all of them
        return bound_batch([factor.bind(*spaces) for factor in group])
    return batch_of(group, [factor.z.reshape(len(factor), -1) for factor in group], noise)
