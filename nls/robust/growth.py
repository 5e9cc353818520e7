r"""Which loop closures to believe: begin with odometry, and accept first what is most certain.

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
tests. Misfits are given back, and at the end every group of closures that all others contradict (`nls.robust.groups`).

Before it starts, closures that agree with no neighbor are set aside (`nls.robust.loop_graph`).

P_ij is along the shortest path over odometry and accepted closures. The path of least summed uncertainty bounds the
covariance of the relative pose from above; in the axes of the world its links add up,

    P_ij = Ad(T_j)^-1 (sum of Ad(T_k) C_k Ad(T_k)') Ad(T_j)^-T.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from scipy import sparse as sp

from models.algebra import Array, Index, Mask
from nls.analysis.chi_squared import chi2_gate, mahalanobis
from nls.covariance.frames import turned
from nls.graph import FactorGraph
from nls.optimizers import GaussNewton, Stop
from nls.posegraph import Edges
from nls.robust.groups import FITS, misfits, witnesses
from nls.robust.loop_graph import LoopGraph, loop_graph
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
        closures. Other factors stay in the graph and are not doubted.
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
    brief = GaussNewton(Stop(1e-6, 1e-3, 1e-10, max_iterations=4), reuse=True)
    values = subgraph.optimize(values, brief).values
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
