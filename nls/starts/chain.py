"""Starts composed along edges: the odometry chain, and the spanning tree of fewest steps."""

from __future__ import annotations

from nls.graph import FactorGraph
from nls.posegraph import pose_graphs
from nls.values import Values, refuse_other

__all__ = ["chain", "spanning_tree"]


def chain(graph: FactorGraph, values: Values) -> Values:
    """Poses composed from one number to the next: the dead-reckoned trajectory.

    Where two neighbors in number have no common edge, the edge that jumps over the fewest numbers is taken. This is a
    minimum spanning tree over the difference of places. Fixed poses keep their values; in a component without any, the
    first pose does.

    Parameters
    ----------
    graph : its relative poses are used, see `Factor.relative_poses`, whatever their noise.
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
    for poses in pose_graphs(graph, values):
        values = poses.replaced(values, poses.along(poses.odometry_tree(), poses.stack(values)))
    return values


def spanning_tree(graph: FactorGraph, values: Values) -> Values:
    """Poses composed along the tree of fewest edges from the first pose of every component.

    Parameters and result as for `chain`. Loop closures shorten the way, so errors of odometry add up over fewer steps;
    a wrong closure bends everything behind it.
    """
    refuse_other("spanning_tree", graph, values)
    for poses in pose_graphs(graph, values):
        values = poses.replaced(values, poses.along(poses.tree(poses.pairs()), poses.stack(values)))
    return values
