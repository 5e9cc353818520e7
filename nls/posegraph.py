r"""Relative poses as arrays: edges, odometry and closures, covariances, trees, weights, and block matrices.

A relative pose z of node j in node i, both of one group, is an edge with the noise

    T_j = T_i o z o Exp(xi),   xi ~ N(0, C),   C = (A_j'A_j)^-1,   A_j = d b / d xi at residual zero,

so C has the axes of the end j, whatever the convention. An edge is odometry if its ends follow each other in number,
and a loop closure otherwise, unless its factor is of sequential matches. Weights kappa of rotations, tau of positions
reduce the information Omega = W'W of an edge to two numbers, for costs that are quadratic in rotation matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse as sp

from factors.base import Factor, Model
from models import LieGroup, Manifold
from models.algebra import Array, Index, Mask, congruence, gram
from models.errors import GraphError
from models.manifolds.rn import Vectors
from nls.gauge import by_number, fixed_variables
from nls.graph import FactorGraph
from nls.sparse.elimination import connected, firsts
from nls.sparse.pattern import Batch, Pattern, once
from nls.values import Values, take


def is_relative(factor: Factor) -> bool:
    """Whether a factor is of a kind that measures relative poses, see `Factor.relative_poses`."""
    return factor.states("relative_poses")


def says_poses(factor: Factor) -> bool:
    """Whether a factor measures relative poses by itself, without a third variable, such as the place of a sensor."""
    return is_relative(factor) and len(factor.keys) == 2


@once
def places(pattern: Pattern) -> Index:
    """(V,) place of every variable in the order by kind and number."""
    place = np.empty(len(pattern.dims), dtype=np.intp)
    for kind, begin in pattern.offsets.items():
        place[by_number(pattern, kind)] = begin + np.arange(len(pattern.numbers[kind]))
    return place


def odometry(pattern: Pattern) -> list[Mask]:
    """Per batch (k,) the relative poses whose ends follow each other in the numbers of one kind.

    Examples
    --------
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> from nls.posegraph import closures, odometry
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Between(x[[10, 20, 10]], x[[20, 40, 40]], [1, 0, 0], Isotropic(1))])
    >>> pattern = graph.pattern(Values({x: (SE2, SE2.identity(3), [10, 20, 40])}))
    >>> odometry(pattern)[0].tolist(), closures(pattern)[0].tolist()
    ([True, True, False], [False, False, True])
    """
    place = places(pattern)
    return [_steps(batch, place) for batch in pattern.batches]


def closures(pattern: Pattern) -> list[Mask]:
    """Per batch (k,) the relative poses that close loops: no `odometry`, no sequential matches."""
    place = places(pattern)
    return [_closing(batch, place) for batch in pattern.batches]


@dataclass(frozen=True, eq=False)
class Edges:
    """Some relative poses with their covariances.

    Attributes
    ----------
    group : of the poses.
    i, j : (m,) places of the poses in the order of their numbers.
    z : (m, size) measured poses of j in i.
    C : (m, d, d) covariances in the axes of j: of (x, y, yaw) or (x, y, z, roll, pitch, yaw), in m and rad.
    """

    group: LieGroup
    i: Index
    j: Index
    z: Array
    C: Array

    def __len__(self) -> int:
        return len(self.i)

    def __getitem__(self, which: Index | Mask) -> Edges:
        return Edges(self.group, self.i[which], self.j[which], self.z[which], self.C[which])

    def joined(self, other: Edges) -> Edges:
        """Edges of both."""
        i, j = np.concatenate([self.i, other.i]), np.concatenate([self.j, other.j])
        return Edges(self.group, i, j, np.concatenate([self.z, other.z]), np.concatenate([self.C, other.C]))

    def forward(self) -> Edges:
        """The edges, each from its earlier to its later pose: z^-1 with Ad(z) C Ad(z)' where they change."""
        back, z, C = self.i > self.j, self.z.copy(), self.C.copy()
        z[back] = self.group.inverse(self.z[back])
        C[back] = congruence(self.group.adjoint(self.z[back]), self.C[back])
        return replace(self, i=np.minimum(self.i, self.j), j=np.maximum(self.i, self.j), z=z, C=C)


class PoseGraph:
    """Measured differences of elements of one group: m edges between n nodes.

    Parameters
    ----------
    pattern : of the factor graph.
    fixed : (V,) variables that the graph holds fixed.
    group : the group of the measurements, often the manifold of the variables.
    measured : batches between two variables of one manifold, and what they measure in that group, (k, size).

    Attributes
    ----------
    pattern, group, batches : as they were given.
    kinds : the kinds of variables they join; their stacks, one after the other, are the nodes.
    n, variables : the number of nodes, and their numbers (n,) among all variables.
    place, order : (n,) place of every node in the order by kind and number, and the nodes in that order.
    fixed : (n,) nodes that are held fixed; no start moves them.
    i, j : (m,) nodes; z : (m, size) measurements, of all batches one after the other.

    Examples
    --------
    >>> from factors import Between, Isotropic
    >>> from models import SE2
    >>> from nls import FactorGraph, Values, kinds
    >>> from nls.posegraph import pose_graphs
    >>> (x,) = kinds("x")
    >>> graph = FactorGraph([Between(x[[0, 1, 0]], x[[1, 2, 2]], [[1, 0, 0], [1, 0, 0], [2, 0, 0]], Isotropic(0.1))])
    >>> (poses,) = pose_graphs(graph, Values({x: (SE2, SE2.identity(3))}))
    >>> poses.odometry.tolist(), poses.C[2].diagonal().round(4).tolist()
    ([True, True, False], [0.01, 0.01, 0.01])
    """

    def __init__(self, pattern: Pattern, fixed: Mask, group: LieGroup, measured: Sequence[tuple[Batch, Array]]) -> None:
        self.pattern, self.group = pattern, group
        self.batches, self._z = zip(*measured, strict=True)
        joined = {kind for batch in self.batches for kind in batch.kinds[:2]}
        self.kinds = tuple([kind for kind in pattern.manifolds if kind in joined])
        ranges = [pattern.offsets[kind] + np.arange(len(pattern.numbers[kind])) for kind in self.kinds]
        self.variables = np.concatenate(ranges)
        self.n, self.fixed = len(self.variables), fixed.take(self.variables)
        self._node = np.empty(len(pattern.dims), dtype=np.intp)
        self._node[self.variables] = np.arange(self.n)
        self.place = self.nodes(places(pattern).take(self.variables))
        self.order = np.empty(self.n, dtype=np.intp)
        self.order[self.place] = np.arange(self.n)
        ends = zip(*(batch.variables[:2] for batch in self.batches), strict=True)
        self.i, self.j = (self.nodes(np.concatenate(variables)) for variables in ends)
        self.z: Array = np.concatenate(self._z)

    def nodes(self, variables: Index) -> Index:
        """Nodes (k,) of some variables (k,) in the manifold."""
        return self._node.take(variables)

    def stack(self, values: Values) -> Array:
        """The nodes' values (n, size)."""
        return np.concatenate([values.stacks[kind].X for kind in self.kinds])

    def replaced(self, values: Values, X: Array) -> Values:
        """Values with these nodes."""
        begins = [self._node[self.pattern.offsets[kind]] for kind in self.kinds]
        ends = [*begins[1:], self.n]
        return values.replaced({kind: X[a:b] for kind, a, b in zip(self.kinds, begins, ends, strict=True)})

    @cached_property
    def odometry(self) -> Mask:
        """(m,) edges that are odometry."""
        return np.concatenate([_steps(batch, places(self.pattern)) for batch in self.batches])

    @cached_property
    def closures(self) -> Mask:
        """(m,) edges that close loops."""
        return np.concatenate([_closing(batch, places(self.pattern)) for batch in self.batches])

    @cached_property
    def C(self) -> Array:
        """(m, d, d) covariances of Exp at j, infinite where weights say nothing of some component."""
        C = [_covariances(batch.model, self.group, z) for batch, z in zip(self.batches, self._z, strict=True)]
        return np.concatenate(C)

    def edges(self) -> Edges:
        """All edges in the order of the measurements, with their covariances."""
        return Edges(self.group, self.place[self.i], self.place[self.j], self.z, self.C)

    def mean_weights(self) -> tuple[Array, Array]:
        """kappa and tau (m,), 1/rad^2 and 1/m^2: trace of the block of Omega over its size."""
        D, d = self.group.dim, self.group.point_dim
        Omega = self._of_edges([np.square(W) if W.ndim == 2 else np.square(W).sum(axis=1) for W in self._W])
        return Omega[:, d:].sum(axis=1) / (D - d), Omega[:, :d].sum(axis=1) / d

    def isotropic_weights(self) -> tuple[Array, Array]:
        """kappa and tau (m,) of SE-Sync, 1/rad^2 and 1/m^2, by the traces of inverse blocks; 0 without an inverse.

        tau = d / tr Omega_t^-1; kappa = Omega_33 in the plane and 3 / (2 tr Omega_R^-1) in space.
        """
        D, d = self.group.dim, self.group.point_dim
        Omega = gram(self._of_edges([W if W.ndim == 3 else W[..., None] * np.eye(D) for W in self._W]))
        rotation, position = (_inverse_trace(block) for block in (Omega[:, d:, d:], Omega[:, :d, :d]))
        return np.where(rotation < np.inf, Omega[:, 2, 2], 0.0) if d == 2 else 1.5 / rotation, d / position

    @property
    def _W(self) -> list[Array]:
        """Roots of Omega by batch, (k or 1, d, d) or diagonals; at j where the measurements are no poses themselves."""
        parts, g = [(batch.model, z) for batch, z in zip(self.batches, self._z, strict=True)], self.group
        own = [model.space is g and np.may_share_memory(z, model.z) for model, z in parts]
        return [m.W if as_it_is else _jacobians_at_j(m, g, z) for (m, z), as_it_is in zip(parts, own, strict=True)]

    def by_batch(self, x: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
        """Numbers (m, ...) of all edges, batch by batch (k, ...)."""
        return np.split(x, np.cumsum([len(batch) for batch in self.batches])[:-1])

    def _of_edges(self, parts: list[Array]) -> Array:
        """(m, ...) numbers of all edges, from those of every batch: (k, ...), or (1, ...) where they are the same."""
        sized = zip(map(len, self.batches), parts, strict=True)
        return np.concatenate([x if len(x) == k else np.broadcast_to(x, (k, *x.shape[1:])) for k, x in sized])

    def sums(self, at_i: Array, at_j: Array) -> Array:
        """Sum (n, ...) at every node of the numbers (m, ...) that its edges have there."""
        if at_i.ndim == 1:
            return np.asarray(np.bincount(self.i, at_i, self.n) + np.bincount(self.j, at_j, self.n), dtype=float)
        (m, *shape), (to_i, to_j) = at_i.shape, self._incidence
        return np.asarray((to_i @ at_i.reshape(m, -1) + to_j @ at_j.reshape(m, -1)).reshape(self.n, *shape))

    @cached_property
    def _incidence(self) -> tuple[sp.csr_array, sp.csr_array]:
        """Matrices (n, m) that sum over the edges that begin, and that end, at every node."""
        ones, m = np.ones(len(self.i)), np.arange(len(self.i))
        return sp.csr_array((ones, (self.i, m)), (self.n, len(m))), sp.csr_array((ones, (self.j, m)), (self.n, len(m)))

    @property
    def component(self) -> Index:
        """(n,) the connected component of every node, named by its lowest one."""
        return connected(self.i, self.j, self.n)

    @cached_property
    def touched(self) -> Mask:
        """(n,) nodes that have an edge."""
        return np.bincount(np.concatenate([self.i, self.j]), minlength=self.n) > 0

    @cached_property
    def roots(self) -> Index:
        """Nodes that keep their value: all fixed ones, and the first in order of every component without any."""
        component, anchored = self.component, np.zeros(self.n, dtype=bool)
        anchored[component[self.fixed]] = True
        waiting = self.touched & ~anchored.take(component)
        return np.concatenate([self.fixed.nonzero()[0], firsts(component, self.order[waiting.take(self.order)])])

    def pairs(self) -> Index:
        """One edge for every joined pair of nodes."""
        return np.unique(np.minimum(self.i, self.j) * self.n + np.maximum(self.i, self.j), return_index=True)[1]

    def odometry_tree(self) -> tuple[Index, Index]:
        """`tree` along the order; a gap in it is bridged by the edge that jumps over the fewest places."""
        pairs = self.pairs()
        i, j = self.i[pairs], self.j[pairs]
        jump = np.abs(self.place[i] - self.place[j]).astype(float)
        steps = pairs[jump == 1]
        if len(steps) < self.n - 1:
            from scipy.sparse.csgraph import minimum_spanning_tree

            lookup = sp.csr_array((jump, (i, j)), shape=(self.n, self.n))
            spanning = sp.coo_array(minimum_spanning_tree(lookup))
            steps = pairs[np.isin(i * self.n + j, spanning.row.astype(np.intp) * self.n + spanning.col)]
        return self.tree(steps)

    def tree(self, edges: Index) -> tuple[Index, Index]:
        """Parent (n,) of every node in the breadth-first tree over some edges, and the edge to it; -1 for roots."""
        i, j, roots = self.place[self.i[edges]], self.place[self.j[edges]], self.roots
        later = self.order[np.maximum(i, j)]
        parent, edge = np.full((2, self.n), -1, dtype=np.intp)
        parent[later], edge[later] = self.order[np.minimum(i, j)], edges
        if (np.abs(i - j) == 1).all() and (parent[roots] < 0).all():
            return parent, edge  # every edge leads to the next node in order, and every root comes first
        from scipy.sparse.csgraph import breadth_first_order

        source = np.concatenate([self.i[edges], roots])
        target = np.concatenate([self.j[edges], np.full(len(roots), self.n)])  # one node above all roots
        name, size = np.concatenate([edges, np.full(len(roots), -1)]), self.n + 1
        graph = sp.csr_array((np.ones(len(source)), (source, target)), shape=(size, size))
        _, parent = breadth_first_order(graph, self.n, directed=False, return_predecessors=True)
        parent = np.where((parent[:-1] < 0) | (parent[:-1] == self.n), -1, parent[:-1]).astype(np.intp)
        key = np.minimum(source, target) * size + np.maximum(source, target)
        sort, child = np.argsort(key), np.arange(self.n)
        wanted = np.minimum(child, parent) * size + np.maximum(child, parent)
        place = np.minimum(np.searchsorted(key[sort], wanted), len(key) - 1)
        return parent, np.where(parent < 0, -1, name[sort[place]])

    def along(self, tree: tuple[Index, Index], X: Array) -> Array:
        """Poses (n, size) composed from the roots of X outward along a tree, by doubling: log2(depth) products.

        Above a root there is itself, with the identity as its step.
        """
        parent, edge = tree
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


def pose_graphs(graph: FactorGraph, values: Values) -> list[PoseGraph]:
    """The relative poses of a graph by group, in the order of the groups' names; kept while nothing else is fixed."""
    pattern, fixed = graph.pattern(values), fixed_variables(graph.fixed, values)
    kept = pattern.answers.get("pose_graphs")
    if kept is None or not np.array_equal(kept[0], fixed):
        batches: dict[LieGroup, list[tuple[Batch, Array]]] = {}
        for batch in pattern.batches:
            group = batch.model.manifolds[0]
            if says_poses(batch.model.factor) and (z := stated(batch, "relative_poses", group)) is not None:
                assert isinstance(group, LieGroup)
                batches.setdefault(group, []).append((batch, z))
        graphs = [PoseGraph(pattern, fixed, g, batches[g]) for g in sorted(batches, key=repr)]
        kept = pattern.answers["pose_graphs"] = fixed, graphs
    return list(kept[1])


def stated(batch: Batch, trait: str, space: Manifold) -> Array | None:
    """Elements (k, size) of a space that a batch gives by a trait of its factor; None where it says nothing.

    Raises
    ------
    GraphError
        An array of another shape.
    """
    factor = batch.model.factor
    z: Array | None = getattr(factor, trait)(batch.model) if len(batch) else None
    if z is not None and np.shape(z) != (expected := (len(batch), space.size)):
        text = f"{trait} returned an array of shape {np.shape(z)}, expected {expected}, poses in {space}"
        raise GraphError(f"{factor!r:.80}: {text}", factor.keys, factor.name)
    return z


def _steps(batch: Batch, place: Index) -> Mask:
    """(k,) relative poses of a batch between neighbors in the numbers of one kind."""
    if not is_relative(batch.model.factor) or batch.kinds[0] != batch.kinds[1]:
        return np.zeros(len(batch), dtype=bool)
    return np.asarray(np.abs(place[batch.variables[0]] - place[batch.variables[1]]) == 1)


def _closing(batch: Batch, place: Index) -> Mask:
    """(k,) relative poses of a batch that close loops; vectors of two kinds, a drift and its mean, close none."""
    factor, vectors = batch.model.factor, isinstance(batch.model.manifolds[0], Vectors)
    closes = is_relative(factor) and not factor.sequential and not (vectors and batch.kinds[0] != batch.kinds[1])
    return ~_steps(batch, place) & closes


def _inverse_trace(blocks: Array) -> Array:
    """tr M^-1 (m,) of symmetric matrices (m, k, k); infinite where M has no inverse."""
    regular = np.linalg.eigvalsh(blocks)[:, 0] > 1e-12 * np.trace(blocks, axis1=1, axis2=2)
    out = np.full(len(blocks), np.inf)
    out[regular] = np.trace(np.linalg.inv(blocks[regular]), axis1=1, axis2=2)
    return out


def _jacobians_at_j(model: Model, group: LieGroup, z: Array) -> Array:
    """A_j (m, d, d) of relative poses z at residual zero."""
    return model.linearize(group.identity(len(z)), z)[0][1]


def _covariances(model: Model, group: LieGroup, z: Array) -> Array:
    """(m, d, d) covariances of relative poses z, infinite where weights say nothing of some component."""
    information = gram(_jacobians_at_j(model, group, z))
    sizes = np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    sizes = np.where(sizes > 0, sizes, 1.0)  # meters and radians in units of their own: a rank is of numbers alike
    rank = np.linalg.matrix_rank(information / (sizes[:, :, None] * sizes[:, None, :]), hermitian=True)
    C = np.full_like(information, np.inf)
    C[rank == group.dim] = np.linalg.inv(information[rank == group.dim])
    return C
