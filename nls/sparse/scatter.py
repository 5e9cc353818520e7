"""Sums over measurements by variable: one `numpy.bincount` per slot of a batch, whatever the width of its parts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from models.algebra import Array, Index

Slots = Sequence[Sequence[tuple[Index, int]]]
"""Per batch and slot the variables (k,) of its measurements, and their dimension."""


class Scatter:
    """Adds numbers that belong to measurements into a flat array that belongs to variables.

    Parameters
    ----------
    slots : of every batch.
    first : (V,) where in the flat array the numbers of each variable begin.
    size : of the flat array.
    inner : for a variable of dimension d the places (c,) of its numbers from there; all d of them when omitted.
    """

    def __init__(self, slots: Slots, first: Index, size: int, inner: Callable[[int], Index] = np.arange) -> None:
        self.slots, self.first, self.size, self.inner = slots, first, size, inner
        self._places: dict[tuple[int, int], Index] = {}  # by batch and slot

    def add(self, total: Array, batch: int, slot: int, addend: Array) -> None:
        """Add a part (c, k), components first, of k measurements to ``total`` (size,)."""
        places = self._places.get((batch, slot))
        if places is None:
            variables, d = self.slots[batch][slot]
            places = self._places[batch, slot] = (self.first[variables] + self.inner(d)[:, None]).reshape(-1)
        total += np.bincount(places, addend.reshape(-1), self.size)
