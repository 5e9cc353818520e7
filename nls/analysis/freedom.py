r"""Directions that the measurements leave free, and every measurement against all others with these held.

The directions and the anchors that hold them come from `nls.linear.null_space`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index
from nls.analysis.linearization import Checked, Linearization
from nls.linear.factorization import SingularSystemError
from nls.linear.null_space import BLOCKS, FreeDirections, column_lengths
from nls.sparse.pattern import Pattern
from nls.system import LinearSystem
from nls.values import Values

__all__ = ["Freedom", "freedom"]


@dataclass(frozen=True)
class Freedom:
    """The free directions, and every measurement against all others with these held.

    Attributes
    ----------
    checked : None where weights or scales differ too much for A'A although nothing is free.
    anchors : (f,) columns that were held.
    singles : (n, q) directions of one variable each, in units of the unknowns.
    combinations : (n, r) directions that move several.
    norms : (n,) lengths of the columns of A; 1 where a column is zero.
    scale : (N,) lengths with nothing held; 0 where a column is zero.
    more : there may be further ones.
    """

    checked: Checked | None
    anchors: Index
    singles: sp.csc_array
    combinations: Array
    norms: Array
    scale: Array
    more: bool

    @property
    def count(self) -> int:
        """Free directions found."""
        return int(self.singles.shape[1] + self.combinations.shape[1])


def freedom(pattern: Pattern, values: Values) -> Freedom:
    """All free directions at the values.

    Parameters
    ----------
    pattern : the graph with the gauge held.
    values : where it is linearized.
    """
    linear = Linearization(pattern, values)
    everything = pattern.holding(np.zeros_like(pattern.held))
    scale = column_lengths(LinearSystem(everything, linear.system.blocks, linear.system.b))
    free = FreeDirections(pattern.restrict(scale))

    def outcome(checked: Checked | None, more: bool = False) -> Freedom:
        return Freedom(checked, free.anchors, free.singles, free.combinations, free.norms, scale, more)

    for _ in range(BLOCKS):
        if free.count:
            linear = Linearization(free.held(pattern, values), values)
        try:
            return outcome(Checked(linear))
        except SingularSystemError:
            pass
        if not free.collect(linear.system):
            return outcome(None)
    return outcome(None, more=True)
