"""How well two poses are known together, and the motion between them, whether or not they share a factor."""

from __future__ import annotations

from factors.keys import Keys
from models.algebra import Array
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.values import Values

__all__ = ["motion_covariances"]


def motion_covariances(graph: FactorGraph, values: Values, i: Keys, j: Keys) -> Array:
    """Covariance (n, d, d) of motions X_i^-1 X_j of any pairs of poses, in the axes of j; one pass for all.

    Parameters
    ----------
    graph, values : the measurements, and where they are linearized.
    i, j : the pairs, as many of one as of the other.

    Examples
    --------
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> from nls import kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], [1.0, 0.0, 0.0], Isotropic(0.1))])
    >>> values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0], [2, 0, 0]])})
    >>> motion_covariances(graph, values, x[[0]], x[[2]])[0].diagonal().round(3)
    array([0.02, 0.03, 0.02])
    """
    return Marginals(graph, values, pairs=[(i, j)]).relative(i, j)
