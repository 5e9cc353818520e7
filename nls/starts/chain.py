"""Starts composed along edges: the odometry chain, and the spanning tree of fewest steps."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from models.algebra import Array
from nls.graph import FactorGraph
from nls.starts.edges import PoseEdges, pose_edges
from nls.values import Values

__all__ = ["along_chain", "chain", "spanning_tree"]


def chain(graph: FactorGraph, values: Values) -> Values:
    """Poses composed from one number to the next: the dead-reckoned trajectory.

    Where two neighbors in number have no common edge, the edge that jumps over the fewest numbers is taken (a minimum
    spanning tree over the difference of places). Fixed poses keep their
    values; in a component without any, the first pose does.

    Parameters
    ----------
    graph : its `Between` factors over groups are used, whatever their noise.
    values : every variable; only the first poses matter.

    Returns
    -------
    Values

    Examples
    --------
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> from nls.starts import chain
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], [[1, 0, 1.5], [1, 0, 0]], Isotropic(1))])
    >>> chain(graph, Values({x: (SE2, SE2.identity(3))}))[x].round(3).tolist()
    [[0.0, 0.0, 0.0], [1.0, 0.0, 1.5], [1.071, 0.997, 1.5]]
    """
    for edges in pose_edges(graph, values):
        values = edges.replaced(values, along_chain(edges, edges.stack(values)))
    return values


def along_chain(edges: PoseEdges, X: Array) -> Array:
    """Poses (n, size) composed from one number to the next, from those of X at the roots."""
    pairs = edges.first_pairs()
    jump = np.abs(edges.place[edges.i[pairs]] - edges.place[edges.j[pairs]]).astype(float)
    steps = pairs[jump == 1]
    if len(steps) < edges.n - 1:
        from scipy.sparse.csgraph import minimum_spanning_tree

        lookup = sp.csr_array((jump, (edges.i[pairs], edges.j[pairs])), shape=(edges.n, edges.n))
        tree = sp.coo_array(minimum_spanning_tree(lookup))
        kept = np.isin(edges.i[pairs] * edges.n + edges.j[pairs], tree.row.astype(np.intp) * edges.n + tree.col)
        steps = pairs[kept]
    return edges.along(*edges.tree(steps, edges.roots), X)


def spanning_tree(graph: FactorGraph, values: Values) -> Values:
    """Poses composed along the tree of fewest edges from the first pose of every component.

    Parameters and result as for `chain`. Loop closures shorten the way, so errors of odometry add up over fewer steps;
    a wrong closure bends everything behind it.
    """
    for edges in pose_edges(graph, values):
        parent, edge = edges.tree(edges.first_pairs(), edges.roots)
        values = edges.replaced(values, edges.along(parent, edge, edges.stack(values)))
    return values
