"""How well the motion between two poses is known, whether or not they share a factor."""

from __future__ import annotations

import numpy as np

from factors import Between, SqrtInformation
from factors.keys import Keys
from models import LieGroup
from models.algebra import Array
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.values import Values

__all__ = ["motion_covariances"]


def motion_covariances(graph: FactorGraph, values: Values, i: Keys, j: Keys) -> Array:
    """Covariance (n, d, d) of motions X_i^-1 X_j of any pairs of poses, in the axes of j; one pass for all.

    A `Between` without information makes each pair share a factor, as `Marginals.relative` needs it.

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
    group = values.stack(i.kind).manifold
    assert isinstance(group, LieGroup)
    nothing = SqrtInformation(np.zeros((group.dim, group.dim)))
    joined = Between(i, j, group.between(values[i], values[j]), nothing)
    return Marginals(FactorGraph([*graph.factors, joined], graph.fixed), values).relative(i, j)
