r"""Which loop closures to believe: begin with odometry, and accept first what is most certain.

A closure (i, j, z) is tested against the prediction of what has been accepted so far,

    xi = Log(z^-1 o T_ij),   d = xi' (C + P_ij)^-1 xi,

P_ij the covariance of that prediction. After a long loop P is large and nearly everything passes; a test says much
where the prediction is about as sharp as the measurement itself. So those that pass are accepted in the order of

    log det(C + P_ij) - log det C - k,

the volume that was open, in units of the closure's own, less the number k of closures that agree with it and pass as
well: that all of a large group pass by accident is less likely. A quarter of those that pass is accepted, the poses are
solved for, and with each closure the predictions between the places around it become sharp, so that the next tests are.
What does not fit any more is given back, and at the end every group of closures that all others contradict
(`nls.robust.groups`).

Before it starts, closures that agree with no neighbor are set aside (`nls.robust.consistency`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from models.algebra import Array
from nls.chi_squared import chi2_gate
from nls.graph import FactorGraph
from nls.optimizers import GaussNewton, Stop
from nls.robust.closures import Index, Links, Mask, chained
from nls.robust.consistency import mahalanobis, neighbors, unit_variance
from nls.robust.groups import misfits
from nls.robust.paths import path_covariances
from nls.starts.chain import along_chain
from nls.starts.chordal import chordal
from nls.starts.edges import PoseEdges
from nls.values import Values

__all__ = ["Growth", "grow"]

FITS = 0.999  # probability with which a true closure passes
SHARE = 0.25  # of those that pass, accepted in one round
SLACK = 4.0  # times the variances of its last prediction: what does not pass even so has no new one computed
ROUNDS, LITTLE = 40, 0.005  # rounds at most; the last ones add less than this part of what is accepted
METERS = 10  # steps of odometry that weigh as much as a radian when paths are compared
BRIEF = Stop(max_iterations=4, chi2_rtol=1e-3)


@dataclass(frozen=True)
class Growth:
    """What was accepted.

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
    graph : relative poses (`Between`) of one kind: steps from each pose to the next, taken to be right, and loop
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
    edges, links, odometry = chained(graph, values)
    loops, group, kind = links[~odometry], links.group, edges.kinds[0]
    values = edges.replaced(values, along_chain(edges, edges.stack(values)))
    found = neighbors(loops, links[odometry], edges.stack(values)[edges.order])
    accepted = np.zeros(len(loops), dtype=bool)
    steps = group.position(links.z[odometry])
    meters = METERS * float(np.median(np.linalg.norm(steps, axis=1))) or 1.0
    sigma0, few = found.sigma0, 0
    waiting = found.support > 0
    P = np.full_like(loops.C, np.nan)
    for _ in range(ROUNDS):
        T = values.stacks[kind].X[edges.order]
        left = np.flatnonzero(waiting & ~accepted)
        known = links[odometry].joined(loops[accepted])
        fits, order, P[left] = _tested(known, loops[left], T, sigma0, found.cluster[left], meters, P[left])
        if not len(fits):
            break
        last = np.sort(order)[ceil(SHARE * len(fits)) - 1]
        new = left[fits[order <= last]]  # all of those that are as certain: their numbers must not decide
        accepted[new] = True
        values, s = _solved(graph, values, edges, odometry, accepted)
        sigma0 = max(found.sigma0, float(np.sqrt(np.median(s[accepted]) / chi2_gate(group.dim, 0.5))))
        given_back = accepted & (s > sigma0**2 * chi2_gate(group.dim, FITS))
        accepted &= ~given_back
        few = few + 1 if len(new) - given_back.sum() < LITTLE * accepted.sum() else few
        if few == 2:
            break
    masks = _masks(graph, edges, odometry, accepted)
    if accepted.any():
        closures = np.flatnonzero(~odometry)[accepted]
        part = graph.only(masks)
        result = part.optimize(values)
        noise = unit_variance(result.chi2_final / max(result.dof, 1))
        wrong = misfits(part, result.values, edges, closures, found.cluster[accepted], noise)
        if wrong.any():
            accepted[np.flatnonzero(accepted)[wrong]] = False
            values, _ = _solved(graph, values, edges, odometry, accepted)
            masks = _masks(graph, edges, odometry, accepted)
    return Growth(values, masks, found.sigma0)


def _tested(
    known: Links, loops: Links, T: Array, sigma0: float, cluster: Index, meters: float, P: Array
) -> tuple[Index, Array, Array]:
    """Which closures (k,) pass, the rank (k,) of each, the most certain lowest, and the covariances of all predictions.

    P are those of the round before, nan where there are none. They shrink with nearly every link, so what does not pass
    with twice their sigmas keeps them: half of the time on manhattan with as many wrong closures.
    """
    group, gate = loops.group, sigma0**2 * chi2_gate(loops.group.dim, FITS)
    xi = group.log(group.compose(group.inverse(loops.z), group.compose(group.inverse(T[loops.i]), T[loops.j])))
    open_ = ~(mahalanobis(xi, loops.C + SLACK * P) > gate)
    P = P.copy()
    P[open_] = path_covariances(known, T, loops.i[open_], loops.j[open_], meters)
    S = loops.C + P
    fits = np.flatnonzero(open_ & (mahalanobis(xi, S) <= gate))
    open_volume = np.linalg.slogdet(S[fits])[1] - np.linalg.slogdet(loops.C[fits])[1]
    _, group_of, members = np.unique(cluster[fits], return_inverse=True, return_counts=True)
    return fits, open_volume - members[group_of], P


def _masks(graph: FactorGraph, edges: PoseEdges, odometry: Mask, accepted: Mask) -> list[Mask]:
    """Per factor which measurements are odometry, accepted, or of another kind."""
    kept = odometry.copy()
    kept[~odometry] = accepted
    ends = np.cumsum([len(model.z) for model in edges.models])
    of = {id(model.factor): part for model, part in zip(edges.models, np.split(kept, ends[:-1]), strict=True)}
    return [of.get(id(factor), np.ones(len(factor), dtype=bool)) for factor in graph.factors]


def _solved(
    graph: FactorGraph, values: Values, edges: PoseEdges, odometry: Mask, accepted: Mask
) -> tuple[Values, Array]:
    """The poses under the accepted closures, and chi2 (m,) of every closure there."""
    part = graph.only(_masks(graph, edges, odometry, accepted))
    start = chordal(part, values)  # what is accepted is right, mostly: torus3D's odometry is no start for anything
    if part.chi2(start) < part.chi2(values):
        values = start
    values = part.optimize(values, GaussNewton(BRIEF)).values
    s = np.concatenate([model.factor.chi2(values) for model in edges.models])
    return values, s[~odometry]
