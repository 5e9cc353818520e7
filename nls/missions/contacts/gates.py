r"""How far a sighting is from a target, in sigmas: squared Mahalanobis distances of pairs.

A sighting d of ping j and the arc of a sighting c of ping i, point by point, whitened by the noise of d:

    b = W (z_d - h(X_j, p_k)),   S = I + A_X Sigma_G A_X' + A_l C A_l',        d2 = min over the arc of b' S^-1 b

with Sigma_G the covariance of the motion X_i^-1 X_j and C that of the point by the noise of c, both with the Jacobians
of the middle of the arc.

The elevation of a landmark l is determined by other sightings. C_l is its covariance beside its anchor a, in the axes
of the world. Sigma_G is that of the motion a^-1 X_j (`nls.missions.contacts.anchors`). For a sighting d of l:

    b = W (z_d - h(X_j, l)),     S = I + A_X Sigma_G A_X' + A_l C_l A_l',      d2 = b' S^-1 b

Source: J. Neira, J. D. Tardos, "Data association in stochastic mapping using the joint compatibility test", IEEE
Transactions on Robotics and Automation 17, 2001, for the gate; the arc is that of `models.sensors.arcs`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from models.algebra import Array, Index, congruence, product
from nls.analysis.chi_squared import mahalanobis
from nls.covariance import Marginals
from nls.missions.contacts.anchors import Anchored, Motions
from nls.missions.contacts.estimate import Estimate
from nls.missions.contacts.places import Pings
from nls.values import Values

__all__ = ["landmark_distances", "ping_innovations", "sighting_distances"]

AT_ONCE = 4096  # pairs of sightings, so that memory does not grow with their number


def sighting_distances(pings: Pings, values: Values, c: Index, d: Index, motions: Motions) -> tuple[Array, Array]:
    """d2 (k,) of sightings d from the arcs of sightings c in other pings, and the largest sigma (k,) of that.

    The motions (k,) are those from the pings of c to the pings of d.
    """
    X, sensors = values[pings.poses][pings.ping], pings.sensors(values)
    d2, width = np.empty(len(c)), np.empty(len(c))
    for begin in range(0, len(c), AT_ONCE):
        span = slice(begin, begin + AT_ONCE)
        Sigma = motions.Sigma[motions.which[span]]
        d2[span], width[span] = _arc_distances(pings, X, sensors, c[span], d[span], Sigma)
    return d2, width


def _arc_distances(pings: Pings, X: Array, sensors: Array, c: Index, d: Index, Sigma: Array) -> tuple[Array, Array]:
    """As `sighting_distances`, with the poses of vehicle and sensor at all sightings, and the Sigma_G (k, d, d)."""
    group, (k, K, dim) = pings.group, pings.points[c].shape
    every, R = np.repeat(d, K), group.rotation(sensors[c])
    L = group.position(sensors[c])[:, None] + pings.points[c] @ R.mT
    b = pings.model(every).error(X[every], L.reshape(k * K, dim)).reshape(k, K, -1)
    (A_X, A_l), _ = pings.model(d).linearize(X[d], L[:, K // 2])
    C = congruence(product(A_l, R), pings.covariances[c])
    S = np.eye(b.shape[2]) + congruence(A_X, Sigma) + C
    return _least(b, np.asarray(np.linalg.inv(S))), np.sqrt(np.linalg.eigvalsh(S)[:, -1])


def _least(b: Array, M: Array) -> Array:
    """Least b' M b (k,) on the lines from the best of points b (k, K, m) to its neighbors, by M (k, m, m)."""
    pair, best = np.arange(len(b)), quadratic(b, M[:, None]).argmin(axis=1)
    a = b[pair, best]
    least = quadratic(a, M)
    for step in (-1, 1):
        u = b[pair, np.clip(best + step, 0, b.shape[1] - 1)] - a
        Mu = (M @ u[..., None])[..., 0]
        length = (u * Mu).sum(axis=1)
        t = np.clip(-(a * Mu).sum(axis=1) / np.where(length > 0, length, 1.0), 0.0, 1.0)
        least = np.minimum(least, quadratic(a + t[:, None] * u, M))
    return np.asarray(least)


def landmark_distances(
    pings: Pings, estimate: Estimate, anchored: Anchored, d: Index, landmarks: Index
) -> tuple[Array, Array]:
    """d2 (k,) of sightings d from landmarks by number, and the largest sigma (k,) of that.

    The pairs (landmarks, d) are among those of the covariances.
    """
    d2, width = np.empty(len(d)), np.empty(len(d))
    if not len(d):
        return d2, width
    motions, C_l = anchored.of_landmarks(landmarks, d), anchored.landmarks()
    row = estimate.values.stack(pings.kind).index(pings.kind[landmarks])
    for begin in range(0, len(d), AT_ONCE):
        span = slice(begin, begin + AT_ONCE)
        _, _, (A_X, A_l), b = estimate.linearized(pings, d[span], landmarks[span])
        of_motion, of_landmark = congruence(A_X, motions.Sigma[motions.which[span]]), congruence(A_l, C_l[row[span]])
        S = np.eye(b.shape[1]) + of_motion + of_landmark
        d2[span], width[span] = mahalanobis(b, S), np.sqrt(np.linalg.eigvalsh(S)[:, -1])
    return d2, width


def ping_innovations(
    pings: Pings, estimate: Estimate, d: Index, landmarks: Index
) -> Iterator[tuple[Index, Array, Array]]:
    """Innovations of sightings d (k,) from landmarks (k,), ping by ping.

    Yields
    ------
    rows (r,) of these pairings in a ping, by sighting, their innovations (r, m) and the covariance of these (r m, r m).
    """
    if not len(d):
        return
    order, n = np.lexsort((d, pings.ping[d])), len(pings)
    d, landmarks = d[order], landmarks[order]
    ping = pings.ping[d]
    pose, landmark, (A_X, A_l), b = estimate.linearized(pings, d, landmarks)
    members, column = np.unique(ping * n + landmarks, return_inverse=True)  # the landmarks of every ping
    begin, first = _bounds(ping), _bounds(members // n)
    after = first[1:].repeat(np.diff(first)) - np.arange(len(members)) - 1  # members of the same ping behind each
    pair = np.concatenate([[0], np.cumsum(after)])
    i = np.arange(len(members)).repeat(after)
    j = i + 1 + np.arange(len(i)) - pair[i]
    twos, place = np.unique(members[i] % n * n + members[j] % n, return_inverse=True)
    u, v = pings.kind[twos // n], pings.kind[twos % n]
    marginals = Marginals(estimate.graph, estimate.values, pairs=[(pose, landmark), (u, v)])
    P_X, P_l, P_uv = marginals.covariance(pose, frame="body"), marginals.covariance(landmark), marginals.cross(u, v)
    D = product(marginals.cross(pose, landmark, frame="body"), A_l.mT)
    F, G = np.concatenate([product(A_X, P_X) + D.mT, A_X], axis=2), np.concatenate([A_X, D.mT], axis=2)
    for rows, own in zip(map(slice, begin[:-1], begin[1:]), map(slice, first[:-1], first[1:]), strict=True):
        k, m, at = rows.stop - rows.start, b.shape[1], column[rows] - own.start
        P, two = np.empty((own.stop - own.start,) * 2 + P_l.shape[1:]), slice(pair[own.start], pair[own.stop])
        P[at, at], above, left = P_l[rows], i[two] - own.start, j[two] - own.start
        P[above, left] = block = P_uv[place[two]]
        P[left, above] = block.mT
        S = A_l[rows][:, None] @ P[at[:, None], at] @ A_l[rows].mT
        S = S.swapaxes(1, 2).reshape(k * m, k * m) + F[rows].reshape(k * m, -1) @ G[rows].reshape(k * m, -1).T
        yield order[rows], b[rows], S + np.eye(k * m)


def _bounds(groups: Index) -> Index:
    """Where groups (k,), one behind the other, begin, and in the end k."""
    return np.flatnonzero(np.concatenate([[True], groups[1:] != groups[:-1], [True]]))


def quadratic(b: Array, M: Array) -> Array:
    """b' M b of stacks."""
    return np.asarray((b * (M @ b[..., None])[..., 0]).sum(axis=-1))
