"""A pose graph as odometry and loop closures: which closures agree with each other, and the graph of some of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.algebra import Array
from models.manifolds.rn import Vectors
from nls.graph import FactorGraph
from nls.robust.closures import Links, Mask, chained
from nls.robust.consistency import Neighbors, neighbors
from nls.starts.chain import along_chain
from nls.starts.edges import PoseEdges
from nls.values import Values

__all__ = ["LoopGraph", "loop_graph"]


@dataclass(frozen=True)
class LoopGraph:
    """Relative poses of one kind of variables, m loop closures among them.

    Attributes
    ----------
    graph : all measurements.
    values : the poses along odometry.
    edges, links : the relative poses, as measured and with covariances at their ends.
    odometry : which of the relative poses are steps from one pose to the next; all others are loop closures.
    """

    graph: FactorGraph
    values: Values
    edges: PoseEdges
    links: Links
    odometry: Mask

    @cached_property
    def closures(self) -> Links:
        """The m loop closures."""
        return self.links[~self.odometry]

    @cached_property
    def neighbors(self) -> Neighbors:
        """Which closures agree with which, judged by the odometry between them."""
        return neighbors(self.closures, self.links[self.odometry], self.poses(self.values))

    def poses(self, values: Values) -> Array:
        """(n, size) poses in the order of their numbers."""
        return values.stacks[self.edges.kinds[0]].X[self.edges.order]

    def places(self, values: Values) -> Array:
        """(n, r) coordinates of the poses; none of rotations."""
        group, X = self.edges.group, self.poses(values)
        return X if isinstance(group, Vectors) else group.position(X)

    def masks(self, accepted: Mask) -> list[Mask]:
        """Per factor which measurements are odometry, accepted closures (m,), or of another kind."""
        kept = self.odometry.copy()
        kept[~self.odometry] = accepted
        ends = np.cumsum([len(model.z) for model in self.edges.models])
        parts = zip(self.edges.models, np.split(kept, ends[:-1]), strict=True)
        of = {id(model.factor): mask for model, mask in parts}
        return [of.get(id(factor), np.ones(len(factor), dtype=bool)) for factor in self.graph.factors]

    def accepted(self, masks: Sequence[Mask]) -> Mask:
        """Which closures (m,) the masks of all factors keep: the inverse of `masks`."""
        of = {id(factor): mask for factor, mask in zip(self.graph.factors, masks, strict=True)}
        return np.concatenate([of[id(model.factor)] for model in self.edges.models])[~self.odometry]

    def spanned(self, accepted: Mask) -> int:
        """How many steps of odometry lie between the two ends of an accepted closure."""
        closures = self.closures[accepted]
        n = self.edges.n
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
    edges, links, odometry = chained(graph, values)
    return LoopGraph(graph, edges.replaced(values, along_chain(edges, edges.stack(values))), edges, links, odometry)
