"""The joint covariance of a set of variables, with names on its rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from factors.keys import Keys
from models.algebra import Array
from models.errors import GraphError

__all__ = ["Joint"]


@dataclass(frozen=True)
class Joint:
    """Joint covariance of several variables.

    Parameters
    ----------
    matrix : (k, k), symmetric.
    names : of its rows and columns, ``"x3: yaw"``.
    keys : the variables, in order.
    parts : the rows of each variable.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls import Marginals, kinds
    >>> (x,) = kinds("x")
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
    >>> joint = Marginals(world.graph, world.truth).joint(x[[3, 23]], frame="world")
    >>> joint.matrix.shape, joint.names[2], joint.block(x[3], x[23]).shape
    ((6, 6), 'x3: yaw', (3, 3))
    """

    matrix: Array
    names: tuple[str, ...]
    keys: tuple[Keys, ...]
    parts: Sequence[slice]

    def block(self, row: Keys, column: Keys) -> Array:
        """Covariance between two of the variables, a copy.

        Raises
        ------
        GraphError
            One of them is not in the set.
        """
        for key in (row, column):
            if key not in self.keys:
                raise GraphError(f"{key!r} is not in this joint covariance of {len(self.keys)} variables", [key])
        i, j = (self.parts[self.keys.index(key)] for key in (row, column))
        return self.matrix[i, j].copy()
