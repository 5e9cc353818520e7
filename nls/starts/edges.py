"""The relative-pose measurements of a graph as plain arrays: what every start is computed from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from factors.base import Model
from factors.between import Between
from models import LieGroup, Manifold
from models.algebra import Array, Index
from nls.graph import FactorGraph
from nls.sparse.components import connected, firsts
from nls.sparse.pattern import Batch, Pattern
from nls.values import Values, take

__all__ = ["PoseEdges", "edges_of", "pose_batches", "pose_edges"]


@dataclass(frozen=True)
class PoseEdges:
    """All `Between` measurements over one group.

    Attributes
    ----------
    kinds : the kinds of variables in the group; their stacks, one after the other, are the n nodes.
    order : (n,) nodes by kind and number: the order in time where numbers are.
    fixed : (n,) nodes the graph holds fixed; no start moves them.
    i, j : (m,) nodes; z : (m, size) measurements, of all models one after the other.
    """

    group: LieGroup
    kinds: tuple[str, ...]
    n: int
    order: Index
    fixed: npt.NDArray[np.bool_]
    i: Index
    j: Index
    z: Array
    models: list[Model]

    def stack(self, values: Values) -> Array:
        """The nodes' values (n, size)."""
        return np.concatenate([values.stacks[kind].X for kind in self.kinds])

    def replaced(self, values: Values, X: Array) -> Values:
        """Values with these nodes."""
        parts, end = {}, 0
        for kind in self.kinds:
            begin, end = end, end + len(values.stacks[kind])
            parts[kind] = X[begin:end]
        return values.replaced(parts)

    def weights(self) -> tuple[Array, Array]:
        """Mean information of the position and of the rotation, (m,) each: trace of its block of W'W over its size."""
        diagonals = []
        for model in self.models:
            squares = np.square(model.W)
            diagonal = squares if squares.ndim == 2 else squares.sum(axis=1)
            diagonals.append(diagonal if len(diagonal) == len(model.z) else diagonal.repeat(len(model.z), axis=0))
        information, d = np.concatenate(diagonals), self.group.point_dim
        return information[:, :d].sum(axis=1) / d, information[:, d:].sum(axis=1) / (self.group.dim - d)

    def sums(self, at_i: Array, at_j: Array) -> Array:
        """Sum (n,) at every node of what its edges (m,) have there."""
        return np.asarray(np.bincount(self.i, at_i, self.n) + np.bincount(self.j, at_j, self.n), dtype=float)

    @cached_property
    def place(self) -> Index:
        """(n,) the place of every node in the order."""
        place = np.empty(self.n, dtype=np.intp)
        place[self.order] = np.arange(self.n)
        return place

    @cached_property
    def touched(self) -> npt.NDArray[np.bool_]:
        """(n,) nodes that have an edge."""
        touched = np.zeros(self.n, dtype=bool)
        touched[self.i] = touched[self.j] = True
        return touched

    @cached_property
    def roots(self) -> Index:
        """Nodes that keep their value: all fixed ones, and the lowest-numbered of every component without any."""
        component, anchored = connected(self.i, self.j, self.n), np.zeros(self.n, dtype=bool)
        anchored[component[self.fixed]] = True
        waiting = self.touched & ~anchored.take(component)
        first = firsts(component, self.order[waiting.take(self.order)])
        return np.concatenate([self.fixed.nonzero()[0], first])

    def first_pairs(self) -> Index:
        """One edge for every joined pair of nodes."""
        pair = np.minimum(self.i, self.j) * self.n + np.maximum(self.i, self.j)
        return np.unique(pair, return_index=True)[1]

    def _in_order(self, edges: Index, roots: Index) -> tuple[Index, Index] | None:
        """What `tree` gives where every edge leads from one node to the next in order and every root comes first."""
        i, j = self.place[self.i[edges]], self.place[self.j[edges]]
        later = self.order[np.maximum(i, j)]
        parent, edge = np.full((2, self.n), -1, dtype=np.intp)
        parent[later], edge[later] = self.order[np.minimum(i, j)], edges
        return (parent, edge) if (np.abs(i - j) == 1).all() and (parent[roots] < 0).all() else None

    def tree(self, edges: Index, roots: Index) -> tuple[Index, Index]:
        """Parent (n,) of every node in the breadth-first tree over some edges, and the edge to it; -1 for roots."""
        if (found := self._in_order(edges, roots)) is not None:
            return found
        from scipy.sparse.csgraph import breadth_first_order

        source = np.concatenate([self.i[edges], roots])
        target = np.concatenate([self.j[edges], np.full(len(roots), self.n)])  # one node above all roots
        name = np.concatenate([edges, np.full(len(roots), -1)])
        graph = sp.csr_array((np.ones(len(source)), (source, target)), shape=(self.n + 1, self.n + 1))
        _, parent = breadth_first_order(graph, self.n, directed=False, return_predecessors=True)
        parent = np.where((parent[: self.n] < 0) | (parent[: self.n] == self.n), -1, parent[: self.n]).astype(np.intp)
        size = self.n + 1
        key = np.minimum(source, target) * size + np.maximum(source, target)
        sort = np.argsort(key)
        child = np.arange(self.n)
        wanted = np.minimum(child, parent) * size + np.maximum(child, parent)
        place = np.minimum(np.searchsorted(key[sort], wanted), len(key) - 1)
        return parent, np.where(parent < 0, -1, name[sort[place]])

    def along(self, parent: Index, edge: Index, X: Array) -> Array:
        """Poses (n, size) composed from the roots of X outward along a tree, by doubling: log2(depth) products.

        Above a root there is itself, with the identity as its step.
        """
        reached = parent >= 0
        forward = reached & (self.j[edge] == np.arange(self.n))
        backward = reached & ~forward
        step = np.asfortranarray(self.group.identity(self.n))
        step[forward] = self.z[edge[forward]]
        step[backward] = self.group.inverse(self.z[edge[backward]])
        above = np.where(reached, parent, np.arange(self.n))
        while ((higher := above[above]) != above).any():
            step = self.group.compose(take(step, above), step)
            above = higher
        out = np.array(X)
        out[reached] = self.group.compose(X[above[reached]], step[reached])
        return out


def pose_batches(pattern: Pattern) -> dict[LieGroup, list[Batch]]:
    """The relative measurements of a graph by group, in the order of the groups' names."""
    batches: dict[LieGroup, list[Batch]] = {}
    for batch in pattern.batches:
        if isinstance(batch.model.factor, Between) and len(batch):
            group = batch.model.space
            assert isinstance(group, LieGroup)
            batches.setdefault(group, []).append(batch)
    return {group: batches[group] for group in sorted(batches, key=repr)}


def pose_edges(graph: FactorGraph, values: Values) -> Iterator[PoseEdges]:
    """The relative poses of a graph, group by group."""
    for group, batches in pose_batches(graph.pattern(values)).items():
        yield edges_of(graph, values, batches, group, group)


def edges_of(
    graph: FactorGraph, values: Values, batches: list[Batch], manifold: Manifold, group: LieGroup
) -> PoseEdges:
    """Measurements between two variables in a manifold, as differences of elements of a group."""
    kinds = tuple(name for name, stack in values.stacks.items() if stack.manifold is manifold)
    first, n = {}, 0
    for kind in kinds:
        first[kind], n = n, n + len(values.stacks[kind])
    i, j = (np.concatenate([first[b.kinds[slot]] + b.index[slot] for b in batches]) for slot in (0, 1))
    order = np.concatenate([first[k] + np.argsort(values.stacks[k].numbers, kind="stable") for k in kinds])
    fixed = np.zeros(n, dtype=bool)
    for keys in graph.fixed:
        if keys.kind in kinds:
            fixed[first[keys.kind] + values.stacks[keys.kind].index(keys)] = True
    models = [batch.model for batch in batches]
    return PoseEdges(group, kinds, n, order, fixed, i, j, np.concatenate([model.z for model in models]), models)
