"""Sums over measurements by variable: one `numpy.bincount` per slot of a batch, whatever the width of its parts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from models.algebra import Array
    from nls.assemble import Batch

__all__ = ["Scatter"]

Index = npt.NDArray[np.intp]


class Scatter:
    """Adds numbers that belong to measurements into a flat array that belongs to variables.

    Parameters
    ----------
    batches : the batches of the pattern.
    first : (V,) where in the flat array the numbers of each variable begin.
    size : of the flat array.
    inner : for a variable of dimension d the places (c,) of its numbers from there; all d of them when omitted.
    """

    def __init__(
        self, batches: Sequence[Batch], first: Index, size: int, inner: Callable[[int], Index] = np.arange
    ) -> None:
        self.batches, self.first, self.size, self.inner = batches, first, size, inner
        self._places: dict[tuple[int, int], Index] = {}  # by batch and slot

    def add(self, total: Array, batch: int, slot: int, part: Array) -> None:
        """Add a part (c, k), components first, of k measurements to ``total`` (size,)."""
        places = self._places.get((batch, slot))
        if places is None:
            model, variables = self.batches[batch].model, self.batches[batch].variables[slot]
            inner = self.inner(model.manifolds[slot].dim)
            places = self._places[batch, slot] = (self.first[variables] + inner[:, None]).reshape(-1)
        total += np.bincount(places, part.reshape(-1), self.size)
