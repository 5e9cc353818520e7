r"""Which loop closures to accept: begin with odometry, and accept first what is most certain.

A closure (i, j, z) is tested against the prediction of what has been accepted so far,

    xi = Log(z^-1 o T_ij),   d = xi' (sigma0^2 C + rho^2 P_ij)^-1 xi,

P_ij the covariance of that prediction, sigma0 and rho the noise that neighbors and odometry show
(`nls.robust.loop_graph`), never above the stated one. After a long loop P is large and nearly everything passes; a
test says much where the prediction is about as sharp as the measurement itself. So those that pass are accepted in the
order of

    log det(C + P_ij) - log det C - k,

the volume that was open, in units of the closure's own, less the number k of closures that agree with it and pass as
well. A large group is less likely to pass as a whole by accident. A quarter of those that pass is accepted, and the
poses are solved for. With each closure the predictions between the places around it become sharp, and so do the next
tests. Misfits are given back, and at the end every group of closures that all others contradict.

Before it starts, closures that agree with no neighbor are set aside (`nls.robust.loop_graph`).

P_ij is along the shortest path over odometry and accepted closures. The path of least summed uncertainty bounds the
covariance of the relative pose from above; in the axes of the world its links add up,

    P_ij = Ad(T_j)^-1 (sum of Ad(T_k) C_k Ad(T_k)') Ad(T_j)^-T.

**Groups** of closures are tested against all the others: what would the rest of the graph say of them? A group of wrong
closures that agree can bend the odometry around it until each fits. Left out as a whole, with b_g and A_g its rows at
the optimum and P the covariance there, it has the statistic

    t_g = b_g' (I - A_g P A_g')^-1 b_g,

which is chi2 distributed with as many degrees of freedom as it has rows, if its closures are right. For a linear
problem chi2 falls by it when the group is taken out. No other solution is needed for it. The P of all groups come out
of one selected inverse: solving for the columns of 300 groups of city10000 takes 22 s, this 1.

The same matrix tells how much that statistic can say. A closure c of the group is predicted by the rest with the
covariance S_c. In the units of its own noise this is the block of c in (I - A_g P A_g')^-1. A wrong closure that says
anything passes by chance with the probability

    volume of xi' S_c^-1 xi <= q  /  volume of all relative poses on the map.

Near 1 the closure is checked by nothing.

Source: W. Baarda, "A testing procedure for use in geodetic networks", 1968, for single measurements.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import ceil, gamma, pi

import numpy as np
from scipy import sparse as sp

from factors.keys import Keys
from models.algebra import Array, Index, Mask
from models.chi_squared import chi2_gate, mahalanobis
from nls.covariance import Marginals
from nls.covariance.frames import turned
from nls.graph import FactorGraph
from nls.optimizers import Automatic, Result, Stop
from nls.posegraph import Edges
from nls.robust.loop_graph import LoopGraph, Neighbors, loop_graph, unit_variance
from nls.starts.chordal import chordal
from nls.values import Values

ACCEPTED_SHARE = 0.25  # of those that pass, accepted in one round
PLACES = 10_000_000  # that paths are kept to, from all sources searched together: 120 MB


@dataclass(frozen=True)
class Growth:
    """The accepted closures.

    Attributes
    ----------
    values : the poses that odometry and the accepted closures lead to.
    masks : per factor of the graph which of its measurements were accepted.
    sigma0 : by what the stated sigmas have to be multiplied, as neighboring closures show it.
    """

    values: Values
    masks: list[Mask]
    sigma0: float


def grow(graph: FactorGraph, values: Values) -> Growth:
    """Accept loop closures one after the other, the most certain first, beginning with odometry alone.

    Parameters
    ----------
    graph : relative poses of one kind: steps from each pose to the next, taken to be right, and loop
        closures. Other factors stay in the graph and are trusted.
    values : where the poses begin; only the first one matters.

    Raises
    ------
    GraphError
        No such graph: a step is missing, or the weights of a closure say nothing of one of its components.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.robust import grow
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=30)
    >>> grown = grow(world.graph, world.truth)
    >>> all(mask.all() for mask in grown.masks)
    True
    """
    return grown(loop_graph(graph, values))


def grown(loops: LoopGraph) -> Growth:
    """`grow` from a graph whose closures have been compared already."""
    values, closures, odometry = loops.values, loops.closures, loops.odometry
    dim, near = closures.group.dim, loops.neighbors
    steps = closures.group.position(odometry.z)
    meters = 10 * float(np.median(np.linalg.norm(steps, axis=1))) or 1.0  # weigh as much as a radian
    sigma0, few = min(near.sigma0, 1.0), 0
    accepted = np.zeros(len(closures), dtype=bool)
    waiting = near.support > 0
    P = np.full_like(closures.C, np.nan)
    for _ in range(40):
        left = np.flatnonzero(waiting & ~accepted)
        known = odometry.joined(closures[accepted])
        T, scales = loops.track(values), (sigma0, near.rho, meters)
        fits, order, P[left] = _tested(known, closures[left], T, scales, near.cluster[left], P[left])
        if not len(fits):
            break
        last = np.sort(order)[ceil(ACCEPTED_SHARE * len(fits)) - 1]
        new = left[fits[order <= last]]  # all of those that are as certain: their numbers must not decide
        accepted[new] = True
        values, s = _solved(loops, values, accepted)
        spread = float(np.sqrt(np.median(s[accepted]) / chi2_gate(dim, 0.5)))
        sigma0 = min(max(near.sigma0, spread), 1.0)
        given_back = accepted & (s > sigma0**2 * chi2_gate(dim, FITS))
        accepted &= ~given_back
        few = few + 1 if len(new) - given_back.sum() < 0.005 * accepted.sum() else few
        if few == 2:
            break
    if accepted.any():
        result = loops.graph.only(loops.masks(accepted)).optimize(values)
        wrong = misfits(witnesses(loops, result.values, accepted), result, loops)
        if wrong.any():
            accepted &= ~wrong
            values, _ = _solved(loops, values, accepted)
    return Growth(values, loops.masks(accepted), near.sigma0)


def _tested(
    known: Edges, closures: Edges, T: Array, scales: tuple[float, float, float], cluster: Index, P: Array
) -> tuple[Index, Array, Array]:
    """Which closures (k,) pass, the rank (k,) of each, the most certain lowest, and the covariances of all predictions.

    The scales are by what stated sigmas are multiplied, of closures and of odometry, and the meters that weigh as much
    as a radian. P are those of the round before, nan where there are none. They shrink with nearly every link, so what
    does not pass with twice their sigmas (4 P) keeps them: half of the time on manhattan with as many wrong closures.
    """
    group, gate, (sigma0, rho, meters) = closures.group, chi2_gate(closures.group.dim, FITS), scales
    C, rho2 = sigma0**2 * closures.C, rho**2
    T_ij = group.compose(group.inverse(T[closures.i]), T[closures.j])
    xi = group.log(group.compose(group.inverse(closures.z), T_ij))
    open_ = ~(mahalanobis(xi, C + 4.0 * rho2 * P) > gate)
    P = P.copy()
    P[open_] = path_covariances(known, T, closures.i[open_], closures.j[open_], meters)
    S = C + rho2 * P
    fits = np.flatnonzero(open_ & (mahalanobis(xi, S) <= gate))
    open_volume = np.linalg.slogdet(S[fits])[1] - np.linalg.slogdet(C[fits])[1]
    _, group_of, members = np.unique(cluster[fits], return_inverse=True, return_counts=True)
    return fits, open_volume - members[group_of], P


def _solved(loops: LoopGraph, values: Values, accepted: Mask) -> tuple[Values, Array]:
    """The poses under the accepted closures, and chi2 (m,) of every closure there."""
    subgraph = loops.graph.only(loops.masks(accepted))
    start = chordal(subgraph, values)  # what is accepted is right, mostly: torus3D's odometry is no start for anything
    if subgraph.chi2(start) < subgraph.chi2(values):
        values = start
    values = subgraph.optimize(values, Automatic(Stop(chi2_rtol=1e-3, max_iterations=4))).values
    s = np.concatenate([batch.model.factor.chi2(values) for batch in loops.poses.batches])
    return values, s[loops.poses.closures]


def path_covariances(edges: Edges, T: Array, i: Index, j: Index, meters: float) -> Array:
    """Covariances (m, d, d) of the pose of j in i, at j.

    Parameters
    ----------
    edges : what joins the places; they must join all of them.
    T : (n, size) poses.
    i, j : (m,) places.
    meters : the length that counts as much as a radian when paths are compared.
    """
    from scipy.sparse.csgraph import dijkstra

    group, n, d, r = edges.group, len(T), edges.group.dim, edges.group.point_dim
    variances = np.diagonal(edges.C, axis1=1, axis2=2)
    length = variances[:, :r].sum(axis=1) / meters**2 + variances[:, r:].sum(axis=1)
    pair = np.minimum(edges.i, edges.j) * n + np.maximum(edges.i, edges.j)
    order = np.lexsort((length, pair))
    best = order[np.r_[True, np.diff(pair[order]) > 0]]  # of several edges between two places the one known best
    pairs, ends = pair[best], np.stack([edges.i[best], edges.j[best]])
    world = turned(group.adjoint(T[ends[1]]), edges.C[best]).reshape(-1, d * d)
    steps = sp.csr_array((length[best], (ends.min(axis=0), ends.max(axis=0))), shape=(n, n))
    sums = np.zeros((len(i), d * d))
    sources, source = np.unique(i, return_inverse=True)
    size = max(PLACES // n, 1)
    for begin in range(0, len(sources), size):
        mine = np.flatnonzero((source >= begin) & (source < begin + size))
        _, before = dijkstra(steps, False, sources[begin : begin + size], return_predecessors=True)
        at, row = j[mine], source[mine] - begin
        while len(mine):  # all paths one step back, until each is where it began
            last = before[row, at]
            mine, row, at, last = (x[last >= 0] for x in (mine, row, at, last))
            sums[mine] += world[np.searchsorted(pairs, np.minimum(last, at) * n + np.maximum(last, at))]
            at = last
    return turned(group.adjoint(group.inverse(T[j])), sums.reshape(-1, d, d))


LARGEST_GROUP = 60  # closures; larger groups are a reference for the others, and for their own loose parts
# A group misfits beyond so many times this quantile; right ones of simulated graphs reach 1.4.
WIDER_GATE, FITS = 1.6, 0.999


@dataclass(frozen=True)
class Witness:
    """A group of closures, tested against the rest.

    Attributes
    ----------
    members : (k,) its closures.
    t : the statistic, of k d numbers.
    chance : probability with which the best checked of them would pass if it were wrong.
    """

    members: Index
    t: float
    chance: float


def misfits(judged: Iterable[Witness], result: Result, loops: LoopGraph) -> Mask:
    """Which closures (m,) belong to a group of neighbors that agree and that the rest of the graph contradicts.

    Parameters
    ----------
    judged : the groups, at the optimum `result` of the graph.
    """
    noise = unit_variance(result.chi2_final / max(result.dof, 1))
    wrong = np.zeros(len(loops.closures), dtype=bool)
    for witness in judged:
        gate = chi2_gate(len(witness.members) * loops.poses.group.dim, FITS)
        wrong[witness.members] = witness.t > WIDER_GATE * noise * gate
    return wrong


def witnesses(loops: LoopGraph, values: Values, accepted: Mask) -> Iterator[Witness]:
    """The groups of accepted closures (m,) at their optimum, those of the largest residuals first."""
    poses, graph, d = loops.poses, loops.graph.only(loops.masks(accepted)), loops.poses.group.dim
    rows = [batch.model.linearize(*batch.arguments(values)) for batch in poses.batches]
    b = np.concatenate([b for _, b in rows])[poses.closures]
    A = [np.concatenate([sides[slot] for sides, _ in rows])[poses.closures] for slot in (0, 1)]
    ends = [poses.i[poses.closures], poses.j[poses.closures]]
    volume = np.linalg.slogdet(loops.closures.C)[1] / 2 + _passing(loops, values)
    groups = _judgeable(loops.neighbors, accepted)
    groups.sort(key=lambda members: -float(np.square(b[members]).mean()))
    del groups[300:]  # those of the largest residuals are tested
    touched = [np.unique(np.concatenate([end[members] for end in ends]), return_inverse=True) for members in groups]
    joint = _joint(graph, values, loops, [nodes for nodes, _ in touched])
    for members, (nodes, place), P in zip(groups, touched, joint, strict=True):
        k = len(members)
        blocks = np.zeros((k, d, len(nodes), d))
        for block, at in zip(A, np.split(place, 2), strict=True):
            blocks[np.arange(k), :, at] = block[members]
        A_g, b_g = blocks.reshape(k * d, -1), b[members].reshape(-1)
        S = np.linalg.inv(np.eye(k * d) - A_g @ P @ A_g.T)
        own = S.reshape(k, d, k, d)[np.arange(k), :, np.arange(k)]
        chance = np.exp(np.min(np.linalg.slogdet(own)[1] / 2 + volume[members]))
        yield Witness(members, float(b_g @ S @ b_g), min(float(chance), 1.0))


def _joint(graph: FactorGraph, values: Values, loops: LoopGraph, groups: list[Index]) -> Iterator[Array]:
    """The covariance (k d, k d) of each group of nodes (k,), in the axes of the body; one pass for all."""
    kind, d = loops.poses.kinds[0], loops.poses.group.dim
    numbers = values.stacks[kind].numbers
    if not groups:
        return
    lower = [np.tril_indices(len(nodes)) for nodes in groups]
    i, j = (np.concatenate([nodes[at[side]] for nodes, at in zip(groups, lower, strict=True)]) for side in (0, 1))
    pairs = Keys(kind, numbers[i]), Keys(kind, numbers[j])
    blocks = Marginals(graph, values, pairs=[pairs]).cross(*pairs, frame="body")
    begin = 0
    for nodes, (row, column) in zip(groups, lower, strict=True):
        k, end = len(nodes), begin + len(row)
        P = np.empty((k, d, k, d))
        P[row, :, column] = blocks[begin:end]
        P[column, :, row] = blocks[begin:end].mT
        begin = end
        yield P.reshape(k * d, k * d)


def _judgeable(neighbors: Neighbors, accepted: Mask) -> list[Index]:
    """Members of every accepted cluster, or of the parts of a large one, but for those that are large themselves."""
    cluster = neighbors.cluster
    large = np.bincount(cluster[accepted], minlength=len(cluster))[cluster] > LARGEST_GROUP
    group = np.where(large, neighbors.parts(accepted), cluster)
    closures = np.flatnonzero(accepted)
    order = closures[np.argsort(group[closures], kind="stable")]
    groups = np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
    return [members for members in groups if 0 < len(members) <= LARGEST_GROUP]


def _passing(loops: LoopGraph, values: Values) -> float:
    """Logarithm of the share of all relative poses on the map that lie in a unit ellipsoid, at the quantile."""
    d, places = loops.poses.group.dim, loops.places(values)
    span: Array = np.ptp(places, axis=0)
    sides = 2 * np.maximum(span, 1e-3 * span.max(initial=0.0))  # what is thinner is counted as so thick
    if not sides.all():
        return np.inf  # all in one place
    r = len(sides)
    ball = pi ** (d / 2) / gamma(d / 2 + 1) * chi2_gate(d, FITS) ** (d / 2)
    turns = {0: 1.0, 1: 2 * pi, 3: 8 * pi**2}[d - r]  # volume of all rotations, by their dimension
    return float(np.log(ball / turns) - np.log(sides).sum())
