"""How well two poses are known together, and the motion between them, whether or not they share a factor.

A `Between` without information makes two poses share one: the selected inverse then has their block.
"""

from __future__ import annotations

import numpy as np

from factors import Between, SqrtInformation
from factors.keys import Keys
from models import LieGroup
from models.algebra import Array
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.values import Values

__all__ = ["cross_covariances", "motion_covariances"]


def motion_covariances(graph: FactorGraph, values: Values, i: Keys, j: Keys) -> Array:
    """Covariance (n, d, d) of motions X_i^-1 X_j of any pairs of poses, in the axes of j; one pass for all.

    Parameters
    ----------
    graph, values : the measurements, and where they are linearized.
    i, j : the pairs, as many of one as of the other.

    Examples
    --------
    >>> from factors import Isotropic
    >>> from models import SE2
    >>> from nls import kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], [1.0, 0.0, 0.0], Isotropic(0.1))])
    >>> values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0], [2, 0, 0]])})
    >>> motion_covariances(graph, values, x[[0]], x[[2]])[0].diagonal().round(3)
    array([0.02, 0.03, 0.02])
    """
    return _joined(graph, values, i, j).relative(i, j)


def cross_covariances(graph: FactorGraph, values: Values, i: Keys, j: Keys) -> Array:
    """Covariance (n, d, d) of any pairs of poses, or of one with itself, in the axes of the body; one pass for all.

    Parameters
    ----------
    graph, values, i, j : as for `motion_covariances`.

    Examples
    --------
    >>> from factors import Isotropic
    >>> from models import SE2
    >>> from nls import kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], [1.0, 0.0, 0.0], Isotropic(0.1))])
    >>> values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0], [2, 0, 0]])})
    >>> cross_covariances(graph, values, x[[2, 1]], x[[2, 2]]).diagonal(axis1=1, axis2=2).round(3)
    array([[0.02, 0.03, 0.02],
           [0.01, 0.01, 0.01]])
    """
    apart = i.numbers != j.numbers
    return _joined(graph, values, i[apart], j[apart]).cross(i, j, frame="body")


def _joined(graph: FactorGraph, values: Values, i: Keys, j: Keys) -> Marginals:
    """The covariances of a graph in which these pairs share a factor."""
    if not len(i):
        return Marginals(graph, values)
    group = values.stack(i.kind).manifold
    assert isinstance(group, LieGroup)
    nothing = SqrtInformation(np.zeros((group.dim, group.dim)))
    joined = Between(i, j, group.between(values[i], values[j]), nothing)
    return Marginals(FactorGraph([*graph.factors, joined], graph.fixed), values)
