"""A track along trusted measurements: relative poses of any two of its poses, and their covariances.

The covariance of a step, in the axes of its end, is that of the trusted graph (`nls.analysis.motions`). The steps are
added as if they were independent (`nls.robust.consistency.Odometry`). They are where odometry measures them; a depth or
an attitude that every pose measures by itself makes the sum too large, never too small.

A track ends where nothing trusted joins a pose to the one before: dives that only have landmarks in common.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.keys import Keys
from models import LieGroup
from models.algebra import Array, Index, Numbers
from nls.analysis.motions import motion_covariances
from nls.gauge import component_labels
from nls.graph import FactorGraph
from nls.posegraph import Edges
from nls.robust.consistency import Odometry
from nls.values import Values

__all__ = ["Track", "along"]


@dataclass(frozen=True)
class Track:
    """Poses of one kind in the order of their numbers.

    Attributes
    ----------
    numbers : (n,) of the poses, rising.
    X : (n, size) poses.
    part : (n,) number of the part of the track that each pose is in.
    odometry : relative poses and covariances of poses in one part, by place.
    """

    numbers: Numbers
    X: Array
    part: Index
    odometry: Odometry

    def places(self, keys: Keys) -> Index:
        """Places (k,) of poses on the track."""
        return np.searchsorted(self.numbers, keys.numbers)


def along(graph: FactorGraph, values: Values, kind: str) -> Track:
    """The track of a kind of poses.

    Parameters
    ----------
    graph, values : the trusted measurements, and their optimum.

    Raises
    ------
    UnderconstrainedError
        The trusted measurements leave a pose free within its part of the track.

    Examples
    --------
    >>> import numpy as np
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Between(x[[0, 1]], x[[1, 2]], [1.0, 0.0, 0.0], Isotropic(0.1))])
    >>> track = along(graph, Values({x: (SE2, [[0, 0, 0], [1, 0, 0], [2, 0, 0]])}), "x")
    >>> pose, covariance = track.odometry.between(np.array([0]), np.array([2]))
    >>> pose, covariance[0].diagonal().round(3)
    (array([[2., 0., 0.]]), array([0.02, 0.03, 0.02]))
    """
    stack = values.stack(kind)
    group = stack.manifold
    assert isinstance(group, LieGroup)
    order = np.argsort(stack.numbers, kind="stable")
    numbers, X = stack.numbers[order], np.asarray(stack.X[order])
    pattern = graph.pattern(values)
    label = component_labels(pattern)[pattern.offsets[kind] + order]
    step = np.flatnonzero(label[1:] == label[:-1])
    part = np.concatenate([[0], np.cumsum(label[1:] != label[:-1])])
    i, j = Keys(kind, numbers[step]), Keys(kind, numbers[step + 1])
    T = group.between(X[step], X[step + 1])
    C = motion_covariances(graph, values, i, j) if len(step) else np.zeros((0, group.dim, group.dim))
    return Track(numbers, X, part, Odometry(Edges(group, step, step + 1, T, C), X))
