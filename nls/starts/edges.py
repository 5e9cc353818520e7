"""The relative-pose measurements of a graph as plain arrays: what every start is computed from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from factors.between import Between
from models import LieGroup
from models.algebra import Array
from nls.components import connected
from nls.graph import FactorGraph
from nls.values import Values, take

__all__ = ["PoseEdges", "pose_edges", "pose_groups"]

Index = npt.NDArray[np.intp]


@dataclass(frozen=True)
class PoseEdges:
    """All `Between` measurements over one group.

    Attributes
    ----------
    kinds : the kinds of variables in the group; their stacks, one after the other, are the n nodes.
    order : (n,) nodes by kind and number: the order in time where numbers are.
    fixed : (n,) nodes the graph holds fixed; no start moves them.
    i, j : (m,) nodes; z : (m, size) measurements; W : their whiteners.
    """

    group: LieGroup
    kinds: tuple[str, ...]
    n: int
    order: Index
    fixed: npt.NDArray[np.bool_]
    i: Index
    j: Index
    z: Array
    W: Array

    def stack(self, values: Values) -> Array:
        """The nodes' values (n, size)."""
        return np.concatenate([values.stacks[kind].X for kind in self.kinds])

    def replaced(self, values: Values, X: Array) -> Values:
        """Values with these nodes."""
        sizes = np.cumsum([len(values.stacks[kind]) for kind in self.kinds])[:-1]
        return values.replaced(dict(zip(self.kinds, np.split(X, sizes), strict=True)))

    def weights(self, rows: slice) -> Array:
        """Mean information (m,) over a block of components: trace of the block of W'W over its size."""
        W = self.W[:, rows] if self.W.ndim == 2 else self.W[:, :, rows]
        total = np.sum(W * W, axis=tuple(range(1, W.ndim)))
        return np.broadcast_to(total / W.shape[-1], (len(self.i),))

    @property
    def touched(self) -> npt.NDArray[np.bool_]:
        """(n,) nodes that have an edge."""
        touched = np.zeros(self.n, dtype=bool)
        touched[self.i] = touched[self.j] = True
        return touched

    def roots(self) -> Index:
        """Nodes that keep their value: all fixed ones, and the lowest-numbered of every component without any."""
        label, touched = connected(self.i, self.j, self.n), self.touched
        anchored = np.zeros(int(label.max(initial=-1)) + 1, dtype=bool)
        anchored[label[self.fixed]] = True
        ordered = self.order[(touched & ~anchored[label])[self.order]]
        _, first = np.unique(label[ordered], return_index=True)
        return np.append(np.flatnonzero(self.fixed & touched), ordered[first])

    def first_pairs(self) -> Index:
        """One edge for every joined pair of nodes."""
        pair = np.minimum(self.i, self.j) * self.n + np.maximum(self.i, self.j)
        return np.unique(pair, return_index=True)[1]

    def _in_order(self, edges: Index, roots: Index) -> tuple[Index, Index] | None:
        """What `tree` gives where every edge leads from one node to the next in order and every root comes first."""
        place = np.empty(self.n, dtype=np.intp)
        place[self.order] = np.arange(self.n)
        i, j = place[self.i[edges]], place[self.j[edges]]
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


def pose_groups(graph: FactorGraph, values: Values) -> list[LieGroup]:
    """The groups in which a graph has relative measurements."""
    spaces = {values.stack(f.keys[0].kind).manifold for f in graph.factors if isinstance(f, Between)}
    return sorted((space for space in spaces if isinstance(space, LieGroup)), key=repr)


def pose_edges(graph: FactorGraph, values: Values) -> Iterator[PoseEdges]:
    """The relative poses of a graph, group by group."""
    betweens = [f for f in graph.factors if isinstance(f, Between)]
    for group in pose_groups(graph, values):
        kinds = tuple(name for name, stack in values.stacks.items() if stack.manifold is group)
        start = dict(zip(kinds, np.cumsum([0, *(len(values.stacks[k]) for k in kinds)]), strict=False))
        mine = [f for f in betweens if f.keys[0].kind in kinds]
        models = [f.bind(group, group) for f in mine]
        i, j = (
            np.concatenate([start[f.keys[s].kind] + values.stacks[f.keys[s].kind].index(f.keys[s]) for f in mine])
            for s in (0, 1)
        )
        W = [np.broadcast_to(m.W, (len(m.z), *m.W.shape[1:])) for m in models]
        if len({w.ndim for w in W}) > 1:
            W = [w if w.ndim == 3 else w[..., None] * np.eye(w.shape[-1]) for w in W]
        order = np.concatenate([start[k] + np.argsort(values.stacks[k].numbers, kind="stable") for k in kinds])
        n = sum(len(values.stacks[k]) for k in kinds)
        fixed = np.zeros(n, dtype=bool)
        for keys in graph.fixed:
            if keys.kind in kinds:
                fixed[start[keys.kind] + values.stacks[keys.kind].index(keys)] = True
        yield PoseEdges(group, kinds, n, order, fixed, i, j, np.concatenate([m.z for m in models]), np.concatenate(W))
