r"""Decisions at an optimum: which landmarks are two, and to which one the open sightings of a ping belong.

**Landmarks that are two**: how much better the graph fits where some pieces of a landmark are a landmark of their own.

The sightings i of a piece p pull at their landmark. At the optimum all pulls add up to nothing:

    g_p = sum A_l,i' b_i

Pieces of another target pull to another side. So the pieces are put in the order of their pulls, along the axis of the
largest ones, and cut in two at any place. If the pieces S before the cut may move by a common delta, chi2 falls by

    g_S' Lambda^-1 g_S,    g_S = sum of g_p over p in S

in one step of Gauss-Newton: a score test. Lambda is the information of delta, with all else in the graph at its best. A
wrong join need not show in its residuals, because the map gives way to it. It shows in its pull. Every landmark is cut
where chi2 would fall most with all poses held. For Lambda the pieces S have a place l_S of their own, tied to that of
the others with a sigma t; the information of the tie is taken out again:

    Lambda = cov(l_S - l)^-1 - I / t^2 (+ I / e^2: no contact is farther from the middle of its arc than e)

Source: C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters", Mathematical
Proceedings of the Cambridge Philosophical Society 44, 1948.

**The open sightings of a ping**, decided together.

A pairing p of a sighting with a landmark has the innovation b_p and the Jacobians A_p of pose and landmark. Pairings of
one ping share the error of its pose, and their landmarks are correlated:

    nu = (b_1, ..., b_k),   S_pq = A_p P A_q' + [p = q] I,      a set is compatible with  nu' S^-1 nu  within its gate

with P the joint covariance.

Source: J. Neira, J. D. Tardos, "Data association in stochastic mapping using the joint compatibility test", IEEE
Transactions on Robotics and Automation 17, 2001.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from factors import Between, Isotropic
from factors.replaced import replaced
from models import R
from models.algebra import Array, Index, Mask, apply, product
from models.chi_squared import chi2_gate, mahalanobis
from models.errors import ResourceLimitError
from nls.covariance import Marginals
from nls.filters.association import jcbb
from nls.graph import FactorGraph
from nls.missions.contacts import partition
from nls.missions.contacts.estimate import KERNEL, Anchored, Estimate, landmark_distances, quadratic
from nls.missions.contacts.pings import Pings, without


class Cuts:
    """The cut of every landmark of several pieces: the one of which chi2 falls most, if no pose may move.

    Parameters
    ----------
    pings : the sightings.
    graph : the measurements of `estimate` without them.
    estimate : of tracks.
    pieces : (n,) a finer partition than these.

    Attributes
    ----------
    tied : the estimate with the pieces before each cut as a landmark of their own, tied to the others. Such a landmark
        has the number of the whole one, and `len(pings)` more. Without landmarks of several pieces the same estimate.
    """

    def __init__(self, pings: Pings, graph: FactorGraph, estimate: Estimate, pieces: Index) -> None:
        tracks, dim = estimate.tracks, pings.group.point_dim
        self.tied, self._d = estimate, np.flatnonzero(partition.several(tracks, pieces))
        if not len(self._d):
            return
        names, piece = np.unique(np.column_stack([tracks, pieces])[self._d], axis=0, return_inverse=True)
        piece, (landmark, which) = piece.reshape(-1), np.unique(names[:, 0], return_inverse=True)
        pull, own = _pulls(pings, estimate, self._d, piece)
        order = _by_pull(which, pull)
        self._rough = np.eye(dim) / pings.extent.max() ** 2 if pings.limit else np.zeros((dim, dim))
        cut, self._g = _cuts(which, pull[order], own[order], self._rough)
        self._spread, self._which = _spread_of_pulls(estimate, np.bincount(piece), which), which[piece]
        self._apart = np.argsort(order)[piece] <= cut[self._which]
        sigma = 0.05 * float(np.sqrt(np.median(pings.variances)))  # tighter ties cost digits
        i, j = pings.kind[landmark], pings.kind[landmark + len(tracks)]
        self._tie, self._information = Between(i, j, np.zeros(dim), Isotropic(sigma)), np.eye(dim) / sigma**2
        self.tied = _tied(pings, graph, estimate, self._d[self._apart], self._tie)

    def leaving(self, marginals: Marginals, gate: float) -> Mask:
        """Sightings (n,) that leave their landmarks together: without them chi2 falls by more than the gate.

        Parameters
        ----------
        marginals : of `tied`.
        gate : bound on the fall of chi2. It grows with the error that the sightings of a piece share.
        """
        leaving = np.zeros(len(self.tied.tracks), dtype=bool)
        if len(self._d):
            Lambda = np.linalg.inv(marginals.relative(*self._tie.keys)) - self._information
            falls = mahalanobis(self._g, Lambda + self._rough)  # with all else at its best
            leaving[self._d] = self._apart & (falls > gate * self._spread)[self._which]
        return leaving


def _pulls(pings: Pings, estimate: Estimate, d: Index, piece: Index) -> tuple[Array, Array]:
    """g_p (k, dim) of pieces (n,) of sightings d (n,), and their information (k, dim, dim), with robust weights."""
    _, _, (_, A_l), b = estimate.linearized(pings, d, estimate.tracks[d])
    w, k, dim = KERNEL.weight((b * b).sum(axis=1)), int(piece.max()) + 1, pings.group.point_dim
    pull, own = np.zeros((k, dim)), np.zeros((k, dim, dim))
    np.add.at(pull, piece, w[:, None] * apply(A_l.mT, b))
    np.add.at(own, piece, w[:, None, None] * (A_l.mT @ A_l))
    return pull, own


def _by_pull(which: Index, pull: Array) -> Index:
    """The order of pieces (k,), landmark (k,) by landmark, along the axis of the largest pulls (k, dim) there."""
    scatter = np.zeros((int(which.max()) + 1, pull.shape[1], pull.shape[1]))
    np.add.at(scatter, which, pull[:, :, None] * pull[:, None])
    axis = np.linalg.eigh(scatter)[1][..., -1]
    return np.lexsort(((pull * axis[which]).sum(axis=1), which))


def _cuts(which: Index, pull: Array, own: Array, rough: Array) -> tuple[Index, Array]:
    """The piece (q,) after which every landmark is cut, and g_S (q, dim): chi2 falls most there if no pose may move.

    Parameters
    ----------
    which, pull, own : (k,) landmark, g_p (k, dim) and information (k, dim, dim) of the pieces in their order.
    rough : (dim, dim) information of a landmark without any piece.
    """
    first, last = np.flatnonzero(np.diff(which, prepend=-1)), np.flatnonzero(np.diff(which, append=-1))
    g, Lambda = (np.cumsum(of_piece, axis=0) for of_piece in (pull, own))
    g, Lambda = g - (g - pull)[first][which], Lambda - (Lambda - own)[first][which]
    inside = np.delete(np.arange(len(which)), last)
    both = Lambda[inside] + rough, Lambda[last][which[inside]] - Lambda[inside] + rough
    fall = np.full(len(which), -1.0)
    fall[inside] = quadratic(g[inside], np.linalg.inv(both[0]) + np.linalg.inv(both[1]))
    cut = np.flatnonzero(partition.largest(which, fall))
    return cut, g[cut]


def _spread_of_pulls(estimate: Estimate, size: Index, which: Index) -> Array:
    """The variance of pulls (q,), landmark by landmark, over that of independent errors.

    Where chi2 is below its degrees of freedom, sigmas are wider than the scatter of sightings. The rest of the error is
    one that all sightings of a piece share, as when a tree is seen from one side.

    size, which : (k,) sightings of each piece, and its landmark.
    """
    s = min(1.0, estimate.reduced_chi2)
    return np.asarray(s + (1 - s) * np.bincount(which, size**2) / np.bincount(which, size))


def _tied(pings: Pings, graph: FactorGraph, estimate: Estimate, apart: Index, tie: Between) -> Estimate:
    """An estimate whose sightings `apart` leave their landmarks (q,) for those that these are tied to."""
    tracks, dim = estimate.tracks, pings.group.point_dim
    sightings, *apertures = estimate.graph.factors[len(graph.factors) :]
    chosen, targets = np.flatnonzero(partition.sizes(tracks) > 1), tracks.copy()
    targets[apart] += len(tracks)
    numbers = np.unique(targets[chosen])
    values = without(estimate.values, pings.kind)
    values.add(pings.kind, R(dim), estimate.values[pings.kind[numbers % len(tracks)]], numbers)
    sightings = replaced(sightings, [sightings.keys[0], pings.kind[targets[chosen]]])
    whole = FactorGraph([*graph.factors, sightings, tie, *apertures], graph.fixed)
    return replace(estimate, graph=whole, values=values)


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
