"""Which pairs are worth a gate: sightings near others, and near landmarks, by trees.

Near is within the length of the arc and the error of the pose that the gate allows.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array, Index, Mask
from nls.covariance import Marginals
from nls.graph import FactorGraph
from nls.missions.contacts.anchors import Motions
from nls.missions.contacts.estimate import Estimate
from nls.missions.contacts.places import Pings
from nls.values import Values

__all__ = ["largest_variances", "near_landmarks", "near_pings", "near_sightings"]

MOST = 32  # neighbors of a sighting that are looked at
BEYOND = 1.5  # times half the aperture: a landmark farther above or below was not seen
APART = 1e6  # m between one ping and the next, so that one tree holds them all


def near_pings(
    pings: Pings, graph: FactorGraph, values: Values, lags: int, gate: float
) -> tuple[Index, Index, Motions]:
    """Pairs (k,) of sightings, the second from one of so many pings after that of the first, and their motions."""
    P, m = pings.group.act(pings.sensors(values), pings.middle), len(pings.poses)
    i = [np.arange(m - lag) for lag in range(1, lags + 1)]  # pings that have another one so much later
    begin = np.cumsum([0, *map(len, i)])
    first, second = np.concatenate(i), np.concatenate([early + lag for lag, early in enumerate(i, 1)])
    pair = pings.poses[first], pings.poses[second]
    Sigma = Marginals(graph, values, pairs=[pair]).relative(*pair)
    pairs, which = [], []
    for lag in range(1, lags + 1):
        early = pings.ping + lag < m
        radius = np.zeros(len(pings))
        radius[early] = _radius(pings, Sigma[begin[lag - 1] + pings.ping[early]], gate, early)
        here, there = (np.column_stack([P, APART * ping]) for ping in (pings.ping, pings.ping + lag))
        near = _within(there, here, radius)
        pairs.append(near)
        which.append(begin[lag - 1] + pings.ping[near[:, 0]])
    c, d = np.concatenate(pairs).T
    return c, d, Motions(Sigma, np.concatenate(which))


def near_sightings(
    pings: Pings, estimate: Estimate, Sigma: Array, which: Index, gate: float, widest: float = np.inf
) -> tuple[Index, Index]:
    """Pairs (k,) of some sightings in different pings, the first from the earlier one."""
    P = pings.group.act(pings.sensors(estimate.values), pings.middle)[which]
    c, d = _within(P, P, _radius(pings, Sigma[pings.ping], gate, slice(None), widest)[which]).T
    c, d = which[c], which[d]
    late = pings.ping[c] > pings.ping[d]  # the later pose may be the one with the larger error
    pairs = np.unique(np.where(late, [d, c], [c, d])[:, pings.ping[c] != pings.ping[d]], axis=1)
    return pairs[0], pairs[1]


def near_landmarks(
    pings: Pings, estimate: Estimate, Sigma: Array, which: Index, gate: float, widest: float = np.inf
) -> tuple[Index, Index]:
    """Some of the sightings (k,), and landmarks (k,) by number that they may be of, not yet seen in their ping.

    Pairs of innovations that are wider than `widest` sigmas of the sensor may be left out.
    """
    values = estimate.values
    if pings.kind.name not in values.stacks:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    S, stack = pings.sensors(values), values.stack(pings.kind)
    P = pings.group.act(S, pings.middle)
    radius = _radius(pings, Sigma[pings.ping], gate, slice(None), widest)
    d, row = _within(P[which], stack.X, radius[which]).T
    d = which[d]
    n = len(pings.poses)
    free = ~np.isin(stack.numbers[row] * n + pings.ping[d], estimate.tracks * n + pings.ping)
    d, row = d[free], row[free]
    if pings.limit:
        q = pings.group.act(pings.group.inverse(S[d]), stack.X[row])
        visible = np.abs(np.arctan2(q[:, 2], np.hypot(q[:, 0], q[:, 1]))) < BEYOND * pings.limit
        d, row = d[visible], row[visible]
    return d, stack.numbers[row]


def _within(points: Array, others: Array, radius: Array) -> Index:
    """Pairs (k, 2) of points (n, d) and others within the radius (n,) of each, the nearest `MOST`."""
    from scipy.spatial import cKDTree

    distance, near = cKDTree(others).query(points, np.arange(1, MOST + 1), distance_upper_bound=radius.max(initial=0))
    rows, columns = np.nonzero(distance <= radius[:, None])
    return np.column_stack([rows, near[rows, columns]])


def _radius(pings: Pings, Sigma: Array, gate: float, which: Mask | slice, widest: float = np.inf) -> Array:
    """How far from the middle of their arcs targets (k,) may seem, m, for covariances (k, d, d) of the pose."""
    k = pings.group.point_dim
    far = np.linalg.norm(pings.middle[which], axis=1)
    position, turn = largest_variances(Sigma, k)
    noise = pings.variances[which]
    sigma = np.sqrt(position + 2 * noise) + far * np.sqrt(turn)  # of both sightings
    return np.asarray(pings.extent[which] + np.sqrt(gate) * np.minimum(sigma, widest * np.sqrt(noise)))


def largest_variances(Sigma: Array, k: int) -> tuple[Array, Array]:
    """Of poses or motions, by covariances (n, d, d): along any axis of the k of position (n,), and of the turn (n,)."""
    position, turn = (np.linalg.eigvalsh(block)[:, -1] for block in (Sigma[:, :k, :k], Sigma[:, k:, k:]))
    return np.maximum(position, 0.0), np.maximum(turn, 0.0)
