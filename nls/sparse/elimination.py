"""The graph of variables: its connected components, and which pairs share a block of H in the order of elimination.

All matrices over one graph of variables have an `Elimination` in common, whatever the sizes of their blocks. They are
the two systems of a chordal start and the normal equations. It is found once per graph; a `Pattern` keeps the
latest, ten whole numbers a pair.
"""

from collections.abc import Callable

import numpy as np

from models.algebra import Index, Mask


def connected(i: Index, j: Index, n: int) -> Index:
    """The lowest node (n,) of every node's component, of the pairs (i, j).

    Runs of nodes that are each joined to the one before hang below their first: a trajectory numbered along its way is
    done. As long as a pair has two roots, the root of its higher node is hung below that of the lower one. Then ways to
    the root are halved until all are of length one. This takes 0.2 ms for city10000; `scipy.sparse.csgraph` takes 3 to
    build and check a matrix first.

    Examples
    --------
    >>> import numpy as np
    >>> connected(np.array([0, 3]), np.array([2, 4]), 5).tolist()
    [0, 1, 0, 3, 3]
    """
    first = np.ones(n, dtype=bool)
    step = j - i
    first[j[step == 1]] = first[i[step == -1]] = False
    root = np.maximum.accumulate(np.where(first, np.arange(n), 0))
    while True:
        a, b = root.take(i), root.take(j)
        if (a == b).all():
            return root
        np.minimum.at(root, np.maximum(a, b), np.minimum(a, b))
        while ((above := root.take(root)) != root).any():
            root = above


def firsts(component: Index, nodes: Index) -> Index:
    """The first of some nodes in every component that has any of them, by rising component (n,) of `connected`.

    Examples
    --------
    >>> import numpy as np
    >>> firsts(np.array([0, 1, 0, 3, 3]), np.array([4, 3, 2, 0])).tolist()
    [2, 4]
    """
    first = np.full(len(component), -1)
    backward = nodes[::-1]
    first[component[backward]] = backward  # of several numbers for one place the last one stays
    return first[first >= 0]


Order = Callable[[Index, Index, int], Index]
"""(u, v, V) -> order of elimination (V,), such as `Cholmod.order`: every pair once, u > v, by rising v and then u."""


class Elimination:
    """Pairs of variables by elimination order.

    Parameters
    ----------
    u, v : (P,) pairs of variables, u != v, in any orientation, repeats allowed.
    V : variables.
    order : the elimination order (V,), or a function that gives it; None keeps the given order.

    Attributes
    ----------
    variables : (V,) in the order in which they are eliminated.
    row, column : (P,) places of the two variables of every pair, row > column.
    turned : (P,) whether the pair has its column first.
    blocks : (B,) one pair of every block below the diagonal, by columns and within them by rows.
    again, twin : the other pairs (P - B,), and which of `blocks` each repeats.
    """

    def __init__(self, u: Index, v: Index, V: int, order: Order | Index | None) -> None:
        self.u, self.v, self.V, self.order = u, v, V, order
        position = np.arange(V)
        self.variables = position
        if callable(order):
            pairs = np.minimum(u, v) * V + np.maximum(u, v)
            pairs.sort()
            low, high = np.divmod(pairs[first_of_equals(pairs)], max(V, 1))
            order = order(high, low, V)
        if order is not None:
            self.variables, position = order, np.empty(V, dtype=np.intp)
            position[order] = np.arange(V)
        a, b = position[u], position[v]
        self.row, self.column, self.turned = np.maximum(a, b), np.minimum(a, b), a < b
        place = self.column * V + self.row
        sort = np.argsort(place)
        new = first_of_equals(place[sort])
        again = (~new).nonzero()[0]
        self.blocks, self.again, self.twin = sort[new], sort[again], new.cumsum()[again] - 1

    def serves(self, u: Index, v: Index, V: int, order: Order | None) -> bool:
        """Whether the elimination is that of some pairs."""
        return self.V == V and self.order is order and np.array_equal(self.u, u) and np.array_equal(self.v, v)


def first_of_equals(numbers: Index) -> Mask:
    """Which numbers (n,) differ from the one before; the first does."""
    first = np.ones(len(numbers), dtype=bool)
    np.not_equal(numbers[1:], numbers[:-1], out=first[1:])
    return first
