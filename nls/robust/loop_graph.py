"""A pose graph as odometry and loop closures: which closures agree with each other, and the graph of some of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.advice import Advice
from models.algebra import Array, Index, Mask
from models.errors import GraphError
from models.manifolds.rn import Vectors
from nls.graph import FactorGraph
from nls.posegraph import Edges, PoseGraph, pose_graphs
from nls.robust.consistency import Neighbors, neighbors
from nls.values import Values

__all__ = ["LoopGraph", "loop_graph"]


@dataclass(frozen=True)
class LoopGraph:
    """Relative poses of one kind of variables, m loop closures among them.

    Attributes
    ----------
    graph : all measurements.
    values : the poses along odometry.
    poses : the relative poses as measured, between nodes.
    edges : the relative poses with their covariances, between places.
    steps : the edges, one from each pose to the next, that the poses were composed along.
    """

    graph: FactorGraph
    values: Values
    poses: PoseGraph
    edges: Edges
    steps: Index

    @cached_property
    def closures(self) -> Edges:
        """The m loop closures."""
        return self.edges[self.poses.closures]

    @cached_property
    def odometry(self) -> Edges:
        """The steps from each pose to the next."""
        return self.edges[self.steps]

    @cached_property
    def neighbors(self) -> Neighbors:
        """Which closures agree with which, judged by the odometry between them."""
        return neighbors(self.closures, self.odometry, self.track(self.values))

    def track(self, values: Values) -> Array:
        """(n, size) poses in the order of their numbers."""
        return self.poses.stack(values)[self.poses.order]

    def places(self, values: Values) -> Array:
        """(n, r) coordinates of the poses; none of rotations."""
        group, X = self.poses.group, self.track(values)
        return X if isinstance(group, Vectors) else group.position(X)

    def masks(self, accepted: Mask) -> list[Mask]:
        """Per factor which measurements are accepted closures (m,), or no closures."""
        inliers = ~self.poses.closures
        inliers[self.poses.closures] = accepted
        parts = zip(self.poses.batches, self.poses.by_batch(inliers), strict=True)
        of = {id(batch.model.factor): mask for batch, mask in parts}
        return [of.get(id(factor), np.ones(len(factor), dtype=bool)) for factor in self.graph.factors]

    def accepted(self, masks: Sequence[Mask]) -> Mask:
        """Which closures (m,) the masks of all factors keep: the inverse of `masks`."""
        of = {id(factor): mask for factor, mask in zip(self.graph.factors, masks, strict=True)}
        return np.concatenate([of[id(batch.model.factor)] for batch in self.poses.batches])[self.poses.closures]

    def spanned(self, accepted: Mask) -> int:
        """How many steps of odometry lie between the two ends of an accepted closure."""
        closures = self.closures[accepted]
        n = self.poses.n
        begins = np.bincount(np.minimum(closures.i, closures.j), minlength=n)
        ends = np.bincount(np.maximum(closures.i, closures.j), minlength=n)
        return int((np.cumsum(begins - ends) > 0).sum())


def loop_graph(graph: FactorGraph, values: Values) -> LoopGraph:
    """Odometry and loop closures of a graph of relative poses; of the values only the first pose matters.

    Raises
    ------
    GraphError
        No relative poses, or of several kinds; neighbors without odometry; weights that say nothing of a component.
    """
    graphs = list(pose_graphs(graph, values))
    if len(graphs) != 1:
        raise GraphError(
            "loop closures are chosen among relative poses (Between) of one space, this graph has "
            f"{len(graphs) or 'none'}",
            advice=[Advice("judge all")],
        )
    poses = graphs[0]
    edges = poses.edges()
    joined = np.zeros(poses.n, dtype=bool)
    joined[np.maximum(edges.i, edges.j)[poses.odometry]] = True
    if not joined[1:].all():
        late = int(np.flatnonzero(~joined[1:])[0]) + 1
        a, b = (poses.pattern.key(int(poses.variables[node])) for node in poses.order[[late - 1, late]])
        raise GraphError(
            f"no odometry joins {a!r} to {b!r}: the graph has {int((~joined[1:]).sum()) + 1} sessions, and loop "
            "closures are judged along one",
            advice=[Advice("odometry"), Advice.robust("Cauchy", 1), Advice("judge all")],
        )
    steps = _surest(edges, poses.odometry)
    poses.refuse_infinite(np.concatenate([steps, np.flatnonzero(poses.closures)]))
    X = poses.along(poses.tree(steps), poses.stack(values))
    return LoopGraph(graph, poses.replaced(values, X), poses, edges, steps)


def _surest(edges: Edges, odometry: Mask) -> Index:
    """One edge of odometry to every pose, of several the one of the smallest covariance."""
    along = np.flatnonzero(odometry)
    later = np.maximum(edges.i, edges.j)[along]
    finite = np.isfinite(edges.C[along, 0, 0])
    size = np.where(finite, np.linalg.det(np.where(finite[:, None, None], edges.C[along], 0.0)), np.inf)
    order = np.lexsort((size, later))
    return np.sort(along[order[np.flatnonzero(np.diff(later[order], prepend=-1))]])
