r"""What the sightings of a ping say together.

A pairing p of a sighting with a landmark has the innovation b_p and the Jacobians A_p of pose and landmark. Pairings of
one ping share the error of its pose, and their landmarks are correlated:

    nu = (b_1, ..., b_k),   S_pq = A_p P A_q' + [p = q] I,      a set is compatible with  nu' S^-1 nu  within its gate

with P the joint covariance.

Source: J. Neira, J. D. Tardos, "Data association in stochastic mapping using the joint compatibility test", IEEE
Transactions on Robotics and Automation 17, 2001.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from models.algebra import Array, Index, product
from models.errors import ResourceLimitError
from nls.analysis.chi_squared import chi2_gate
from nls.covariance import Marginals
from nls.filters.association import jcbb
from nls.missions.contacts import partition
from nls.missions.contacts.estimate import Estimate
from nls.missions.contacts.gates import Anchored, landmark_distances
from nls.missions.contacts.pings import Pings


def resolved(
    pings: Pings, estimate: Estimate, anchored: Anchored, d: Index, landmarks: Index, least: int, probability: float
) -> Index:
    """The tracks (n,) of an estimate, their undecided sightings given to landmarks ping by ping.

    Undecided are the sightings of tracks of fewer than so many, and of tracks that nothing needs. A landmark has one
    sighting in a ping: what is decided stays. A ping of more sets of pairings than `jcbb` looks at stays undecided.

    Parameters
    ----------
    pings, estimate : the sightings, and poses and landmarks by them.
    anchored : covariances of the estimate, for these pairs.
    d, landmarks : (k,) sightings that may be given to a landmark, and landmarks by number near them.
    least : sightings that make a landmark.
    probability : with which a right set of pairings is within its gate.
    """
    tracks, m = estimate.tracks, pings.dim
    every = np.arange(len(tracks))
    d2, _ = landmark_distances(pings, estimate, anchored, d, landmarks)
    near = d2 < chi2_gate(m, probability)
    d, landmarks, d2 = d[near], landmarks[near], d2[near]
    needless = partition.superfluous(tracks, d, landmarks, d2, m, probability)
    undecided = needless | (partition.sizes(tracks) < least)
    possible = undecided[d] & ~undecided[landmarks]
    d, landmarks = d[possible], landmarks[possible]
    groups = np.where(undecided, len(tracks) + every, tracks)
    for rows, nu, S in ping_innovations(pings, estimate, d, landmarks):
        sightings, i = np.unique(d[rows], return_inverse=True)
        numbers, j = np.unique(landmarks[rows], return_inverse=True)
        try:
            at = jcbb(np.column_stack([i, j]), nu, S, len(sightings), probability)
        except ResourceLimitError:
            continue
        groups[sightings[at >= 0]] = numbers[at[at >= 0]]
    return partition.renamed(groups)


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
