"""Values between samples: at every node of a common time grid, which two samples a sensor's value is mixed from.

    y(t) = (1 - s) y_a + s y_b,    s = (t - t_a) / (t_b - t_a)

A node that falls on a sample has s = 0: it is that sample. Mixing is linear, so noise passes through it as values do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.algebra import Array, Index
from models.manifolds.so3 import SO3


@dataclass(frozen=True)
class Mixture:
    """Nodes as mixtures of samples.

    Attributes
    ----------
    a, b : (m,) samples before and after.
    s : (m,) share of b, in [0, 1).
    """

    a: Index
    b: Index
    s: Array

    def of(self, y: Array) -> Array:
        """Vectors y (n, k) at the nodes, (m, k)."""
        return (1 - self.s)[:, None] * y[self.a] + self.s[:, None] * y[self.b]

    def of_rotations(self, q: Array) -> Array:
        """Rotations q (n, 4) at the nodes, along the shortest turn: q_a Exp(s Log(q_a^-1 q_b))."""
        turn = SO3.log(SO3.between(q[self.a], q[self.b]))
        return SO3.compose(q[self.a], SO3.exp(self.s[:, None] * turn))

    def __getitem__(self, nodes: Index) -> Mixture:
        return Mixture(self.a[nodes], self.b[nodes], self.s[nodes])


def mixture(nodes: Array, t: Array) -> Mixture:
    """Where nodes (m,) lie between samples at t (n,), both rising, the nodes within [t_0, t_n-1] and n at least 2.

    Examples
    --------
    >>> import numpy as np
    >>> mixture(np.array([0.0, 0.5, 2.0]), np.array([0.0, 2.0])).of(np.array([[0.0], [8.0]])).ravel()
    array([0., 2., 8.])
    """
    a = np.searchsorted(t, nodes, side="right") - 1
    b = np.minimum(a + 1, len(t) - 1)
    s = np.where(b > a, (nodes - t[a]) / np.where(b > a, t[b] - t[a], 1.0), 0.0)
    return Mixture(a, b, s)
