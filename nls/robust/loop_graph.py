r"""A pose graph as odometry and loop closures: which closures agree with each other, and the graph of some of them.

Do two closures agree with the odometry between them? (pairwise consistency)

Two closures a = (i, j), b = (k, l) whose ends lie near one another on the track make a short loop,

    z_a = T_ik o z_b o T_lj,     xi = Log(z_a^-1 o T_ik o z_b o T_lj),     d = xi' S^-1 xi,

in which only a few steps of odometry add to the covariance S of xi. True closures agree with their neighbors, and d is
chi2 distributed with the dimension of the group. A wrong closure seldom finds one that agrees with it by accident; a
place that looks like another gives a whole group of wrong closures, all of which agree. A copy of a closure agrees
with it whatever it says, and counts for nothing.

The same d tell by how much the stated sigmas are too large: sigma0^2 is the 10 % quantile of d over that of chi2.
Geodesy calls it the variance of unit weight. A median would not do, as wrong neighbors may outnumber the right ones.
This changes no estimate, but every test. Numbers without any noise say nothing of it. Where sigma0 is above 1 either
the sigmas are too small or most neighbors are wrong; nobody can tell, and the stated sigmas are used.

Neighbors say nothing of a long way along odometry, which has errors of its own. That is tested by

    rho^2 = 4 times the first quartile of d / median of chi2,    d = xi' (C + P_ij)^-1 xi,  xi = Log(z^-1 o T_ij),

over all closures, T_ij and P_ij along odometry, and never more than 1 or less than sigma0^2.

The covariance of the pose of j in i along odometry needs no walk from i to j. In the axes of the world the covariances
of the steps, Ad(T_k) C_k Ad(T_k)', add up. So a running sum serves all pairs.

Source: J. G. Mangelson, D. Dominic, R. M. Eustice, R. Vasudevan, "Pairwise consistent measurement set maximization for
robust multi-robot map merging", ICRA 2018, which takes the largest set of which every pair agrees; here agreement is
asked of neighbors only, which needs a few pairs for each closure. `nls.robust.accepted_closures` goes on from there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from models.advice import Advice
from models.algebra import Array, Index, Mask
from models.chi_squared import chi2_gate, mahalanobis
from models.errors import GraphError
from models.manifolds.rn import Vectors
from nls.covariance.frames import turned
from nls.graph import FactorGraph
from nls.posegraph import Edges, PoseGraph, pose_graphs
from nls.sparse.elimination import connected
from nls.values import Values

LOW = 0.1  # quantile that tells sigma0, the noise of right neighbors where nine of ten are wrong
ENOUGH_PAIRS = 10  # to tell the noise: one wrong closure among four spoils half of the pairs


@dataclass(frozen=True)
class Neighbors:
    """Which closures agree with which.

    Attributes
    ----------
    support : (m,) how many others agree with each.
    cluster : (m,) the connected part of each, named by its first closure.
    sigma0 : by what the stated sigmas have to be multiplied; 1 where few closures are near, or all are exact.
    rho : by what the sigmas of odometry have to be multiplied, at most 1.
    typical : sigma0 by the median: with as many wrong neighbors as right ones it is theirs.
    passing : share of the closures that odometry allows, by the stated sigmas.
    near : (p, 2) closures that agree with few steps of odometry between them.
    """

    support: Index
    cluster: Index
    sigma0: float = 1.0
    rho: float = 1.0
    typical: float = 1.0
    passing: float = 1.0
    near: Index = field(default_factory=lambda: np.zeros((0, 2), dtype=np.intp))

    def parts(self, accepted: Mask) -> Index:
        """(m,) the part of its cluster that each of some closures (m,) is in, named by its first closure.

        Parts hang together by near pairs. The more odometry lies between two closures the less says that they agree. So
        a few wrong ones may agree with a whole cluster of right ones from afar.
        """
        a, b = self.near[accepted[self.near].all(axis=1)].T
        return connected(a, b, len(accepted))


class Odometry:
    """Relative poses and their covariances along the track."""

    def __init__(self, odometry: Edges, T: Array) -> None:
        forward, group = odometry.forward(), odometry.group
        _, first = np.unique(forward.j, return_index=True)
        steps = forward[first]
        world = np.zeros((len(T), group.dim, group.dim))
        world[steps.j] = turned(group.adjoint(T[steps.j]), steps.C)
        self.group, self.T, self.sums = group, T, np.cumsum(world, axis=0)

    def between(self, i: Index, j: Index) -> tuple[Array, Array]:
        """Pose (m, size) of j in i and its covariance (m, d, d) at j."""
        group, T = self.group, self.T
        S = self.sums[np.maximum(i, j)] - self.sums[np.minimum(i, j)]
        return group.compose(group.inverse(T[i]), T[j]), turned(group.adjoint(group.inverse(T[j])), S)


def unit_variance(noise: float) -> float:
    """The variance of unit weight where there is noise; 1, that of the stated sigmas, where there is rounding alone."""
    return noise if noise > 1e-12 else 1.0


def _compared(track: Odometry, loops: Edges, a: Index, b: Index) -> Array:
    """The statistic d (k,) of pairs of closures, forward in time; nan where one is a copy of the other.

    A copy is the same measurement once more, but for the rounding of an inverse (m and rad).
    """
    group = loops.group
    T_ik, C_ik = track.between(loops.i[a], loops.i[b])
    T_lj, C_lj = track.between(loops.j[b], loops.j[a])
    z_b, to_j = loops.z[b], group.adjoint(group.inverse(T_lj))
    around = group.compose(group.compose(T_ik, z_b), T_lj)
    xi = group.log(group.compose(group.inverse(loops.z[a]), around))
    S = loops.C[a] + turned(to_j @ group.adjoint(group.inverse(z_b)), C_ik) + turned(to_j, loops.C[b]) + C_lj
    copy = (loops.i[a] == loops.i[b]) & (loops.j[a] == loops.j[b]) & (np.abs(xi) <= 1e-9).all(axis=1)
    return np.where(copy, np.nan, mahalanobis(xi, S))


def neighbors(closures: Edges, odometry: Edges, T: Array) -> Neighbors:
    """Compare every closure with those near it.

    Parameters
    ----------
    closures, odometry : the edges.
    T : (n, size) poses along odometry alone, in the order of places.
    """
    from scipy.spatial import cKDTree

    track, loops, group, m = Odometry(odometry, T), closures.forward(), closures.group, len(closures)
    ends = np.stack([loops.i, loops.j], axis=1)
    T_ij, P_ij = track.between(loops.i, loops.j)
    along = mahalanobis(group.log(group.compose(group.inverse(loops.z), T_ij)), loops.C + P_ij)
    passing = float((along <= chi2_gate(group.dim, 0.999)).mean())
    pairs = cKDTree(ends.astype(float)).query_pairs(20, p=np.inf, output_type="ndarray")  # steps at either end
    if not len(pairs):
        return Neighbors(np.zeros(m, dtype=np.intp), np.arange(m), passing=passing)
    pairs = pairs[np.lexsort(pairs.T[::-1])]
    parts = np.array_split(pairs, -(-len(pairs) // 10_000))  # their matrices stay in the cache
    d = np.concatenate([_compared(track, loops, *part.T) for part in parts])
    (a, b), d = pairs[~np.isnan(d)].T, d[~np.isnan(d)]
    near = np.abs(ends[a] - ends[b]).max(axis=1) <= 5  # steps
    enough_pairs = near.sum() >= ENOUGH_PAIRS
    noise = [float(np.quantile(d[near], q)) / chi2_gate(group.dim, q) if enough_pairs else 1.0 for q in (LOW, 0.5)]
    variance, typical = map(unit_variance, noise)
    agree = d <= min(variance, 1.0) * chi2_gate(group.dim, 0.99)
    joined = np.column_stack([a, b])[agree & near]
    a, b = a[agree], b[agree]
    rho2 = np.clip(4.0 * np.quantile(along, 0.25) / chi2_gate(group.dim, 0.5), min(variance, 1.0), 1.0)
    support = np.bincount(np.r_[a, b], minlength=m)
    sigma0, rho, sigma = (float(np.sqrt(v)) for v in (variance, rho2, typical))
    return Neighbors(support, connected(a, b, m), sigma0, rho, sigma, passing, joined)


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
        """Which closures agree with which, by the odometry between them."""
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
        closures, n = self.closures[accepted], self.poses.n
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
    graphs = pose_graphs(graph, values)
    if len(graphs) != 1:
        message = "loop closures are tested among relative poses (Between) of one space, this graph has"
        raise GraphError(f"{message} {len(graphs) or 'none'}", advice=[Advice("judge all")])
    poses = graphs[0]
    edges = poses.edges()
    joined = np.zeros(poses.n, dtype=bool)
    joined[np.maximum(edges.i, edges.j)[poses.odometry]] = True
    if not joined[1:].all():
        late = int(np.flatnonzero(~joined[1:])[0]) + 1
        a, b = (poses.pattern.key(int(poses.variables[node])) for node in poses.order[[late - 1, late]])
        sessions = f"the graph has {int((~joined[1:]).sum()) + 1} sessions, and loop closures are tested along one"
        advice = [Advice("odometry"), Advice.robust("Cauchy", 1), Advice("judge all")]
        raise GraphError(f"no odometry connects {a!r} to {b!r}: {sessions}", advice=advice)
    steps = _surest(edges, poses.odometry)
    refuse_infinite(poses, np.concatenate([steps, np.flatnonzero(poses.closures)]))
    X = poses.along(poses.tree(steps), poses.stack(values))
    return LoopGraph(graph, poses.replaced(values, X), poses, edges, steps)


def refuse_infinite(poses: PoseGraph, edges: Index) -> None:
    """A GraphError that names the first of some edges whose weights say nothing of some component."""
    bad = np.zeros(len(poses.i), dtype=bool)
    bad[edges] = ~np.isfinite(poses.C[edges, 0, 0])
    for batch, mask in zip(poses.batches, poses.by_batch(bad), strict=True):
        if mask.any():
            name = batch.model.factor.describe(int(np.argmax(mask)))
            text = "its weights say nothing of one of its components, so no uncertainty of a loop through it exists"
            raise GraphError(f"{name}: {text}", batch.model.factor.keys, name, advice=[Advice("judge all")])


def _surest(edges: Edges, odometry: Mask) -> Index:
    """One edge of odometry to every pose, of several the one of the smallest covariance."""
    along = np.flatnonzero(odometry)
    later = np.maximum(edges.i, edges.j)[along]
    finite = np.isfinite(edges.C[along, 0, 0])
    size = np.where(finite, np.linalg.det(np.where(finite[:, None, None], edges.C[along], 0.0)), np.inf)
    order = np.lexsort((size, later))
    return np.sort(along[order[np.flatnonzero(np.diff(later[order], prepend=-1))]])
