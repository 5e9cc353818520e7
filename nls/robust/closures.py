r"""The loop closures of a pose graph beside its odometry, as plain arrays.

Poses are counted by their place in the order of their numbers; what joins two neighbors is odometry, all else is a loop
closure and may be wrong. The covariance of a measurement is wanted in the axes of the pose it leads to,

    T_j = T_i o z o Exp(xi),   xi ~ N(0, C),   C = (A_j'A_j)^-1,   A_j = d b / d xi at residual zero,

whatever the convention of its residual.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from factors.base import Model
from factors.between import Between
from models import LieGroup
from models.advice import Advice
from models.algebra import Array, Index, gram
from models.errors import GraphError
from nls.covariance.frames import turned
from nls.graph import FactorGraph
from nls.starts.edges import PoseEdges, pose_batches, pose_edges
from nls.track import closures, steps
from nls.values import Values

__all__ = ["Links", "Mask", "chained", "loop_closures"]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Links:
    """Relative poses over one group.

    Attributes
    ----------
    i, j : (m,) places of the poses.
    z : (m, size) measured poses of j in i.
    C : (m, d, d) covariances of Exp at j.
    """

    group: LieGroup
    i: Index
    j: Index
    z: Array
    C: Array

    def __len__(self) -> int:
        return len(self.i)

    def __getitem__(self, which: Index | Mask) -> Links:
        return Links(self.group, self.i[which], self.j[which], self.z[which], self.C[which])

    def joined(self, other: Links) -> Links:
        """These and others."""
        i, j = np.concatenate([self.i, other.i]), np.concatenate([self.j, other.j])
        return Links(self.group, i, j, np.concatenate([self.z, other.z]), np.concatenate([self.C, other.C]))

    def forward(self) -> Links:
        """The same links, each from its earlier to its later pose."""
        back = self.i > self.j
        Z, A = self.group.inverse(self.z[back]), self.group.adjoint(self.z[back])
        z, C = self.z.copy(), self.C.copy()
        z[back], C[back] = Z, turned(A, self.C[back])
        return replace(self, i=np.minimum(self.i, self.j), j=np.maximum(self.i, self.j), z=z, C=C)


def loop_closures(graph: FactorGraph, values: Values) -> list[Mask]:
    """Which measurements of every factor are loop closures: `Between` of poses that are no neighbors in number."""
    pattern = graph.pattern(values)
    between = [isinstance(factor, Between) for factor in graph.factors]
    return [closures(batch, pattern) & each for batch, each in zip(pattern.batches, between, strict=True)]


def chained(graph: FactorGraph, values: Values) -> tuple[PoseEdges, Links, Mask]:
    """The relative poses of a graph, as edges and as links, and which of these are odometry.

    Raises
    ------
    GraphError
        No relative poses, or of several kinds; neighbors without odometry; weights that say nothing of a component.
    """
    found = list(pose_edges(graph, values))
    if len(found) != 1 or len(found[0].kinds) != 1:
        raise GraphError(
            "loop closures are chosen among relative poses (Between) of one kind of variables, this graph has "
            f"{sum(len(each.kinds) for each in found) or 'none'}",
            advice=[Advice("judge all")],
        )
    edges = found[0]
    C = np.concatenate([_covariances(model) for model in edges.models])
    links = Links(edges.group, edges.place[edges.i], edges.place[edges.j], edges.z, C)
    pattern = graph.pattern(values)
    odometry = np.concatenate([steps(batch, pattern) for batch in pose_batches(pattern)[edges.group]])
    joined = np.zeros(edges.n, dtype=bool)
    joined[np.maximum(links.i, links.j)[odometry]] = True
    if not joined[1:].all():
        kind, late = edges.kinds[0], int(np.flatnonzero(~joined[1:])[0]) + 1
        a, b = values.stacks[kind].numbers[edges.order[[late - 1, late]]]
        raise GraphError(
            f"no odometry joins {kind}{a} to {kind}{b}: the graph has {int((~joined[1:]).sum()) + 1} sessions, and "
            "loop closures are judged along one",
            advice=[Advice("odometry"), Advice.robust("Cauchy", 1), Advice("judge all")],
        )
    return edges, links, odometry


def _covariances(model: Model) -> Array:
    """(m, d, d) covariances of the measurements of a bound `Between`."""
    group = model.space
    assert isinstance(group, LieGroup)
    (_, A), _ = model.linearize(group.identity(len(model.z)), model.z)
    information = gram(A)
    sizes = np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    sizes = np.where(sizes > 0, sizes, 1.0)  # meters and radians in units of their own: a rank is of numbers alike
    correlation = information / (sizes[:, :, None] * sizes[:, None, :])
    bad = np.linalg.matrix_rank(correlation, hermitian=True) < group.dim
    if bad.any():
        name = model.factor.describe(int(np.argmax(bad)))
        raise GraphError(
            f"{name}: its weights say nothing of one of its components, so that no uncertainty of a loop through it "
            "exists",
            model.factor.keys,
            name,
            advice=[Advice("judge all")],
        )
    return np.asarray(np.linalg.inv(information))
