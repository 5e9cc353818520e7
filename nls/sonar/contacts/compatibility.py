r"""Which landmarks the open sightings of a ping are of, all of one ping at once.

A pairing p of a sighting with a landmark has the innovation b_p and the Jacobians A_p of pose and landmark. Pairings of
one ping share the error of its pose, and their landmarks are correlated:

    nu = (b_1, ..., b_k),   S_pq = A_p P A_q' + [p = q] I,      the largest set with  nu' S^-1 nu  within its gate

with P the joint covariance. That is the joint compatibility test of `nls.filters.association`.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Index
from nls.analysis.chi_squared import chi2_gate
from nls.filters.association import jcbb
from nls.sonar.contacts import tracks as of
from nls.sonar.contacts.estimate import Estimate, measured_numbers
from nls.sonar.contacts.gates import landmark_distances, ping_innovations
from nls.sonar.contacts.merging import superfluous
from nls.sonar.contacts.pairs import near_landmarks, pose_covariances
from nls.sonar.contacts.places import Pings

__all__ = ["resolved"]


def resolved(pings: Pings, estimate: Estimate, least: int, probability: float) -> Index:
    """The tracks (n,) of an estimate, their open sightings given to landmarks ping by ping.

    Open are the sightings of tracks of fewer than so many, and of tracks that nothing needs. A landmark has one
    sighting in a ping: what is decided stays.
    """
    tracks, m = estimate.tracks, measured_numbers(pings)
    gate = chi2_gate(m, probability)
    every, Sigma = np.arange(len(tracks)), pose_covariances(pings, estimate.graph, estimate.values)
    d, landmarks = near_landmarks(pings, Sigma, estimate.values, tracks, every, gate)
    n = len(pings.poses)
    free = ~np.isin(landmarks * n + pings.ping[d], tracks * n + pings.ping)
    d, landmarks = d[free], landmarks[free]
    d2, _ = landmark_distances(pings, estimate.graph, estimate.values, d, landmarks)
    near = d2 < gate
    d, landmarks, d2 = d[near], landmarks[near], d2[near]
    needless = superfluous(tracks, d, landmarks, d2, m, probability)
    open_ = needless | (of.sizes(tracks) < least)
    possible = open_[d] & ~needless[landmarks]
    d, landmarks = d[possible], landmarks[possible]
    groups = np.where(open_, len(tracks) + every, tracks)
    if len(d):
        sighting, landmark = _jointly(pings, estimate, d, landmarks, probability)
        groups[sighting] = landmark
    return of.renamed(groups)


def _jointly(pings: Pings, estimate: Estimate, d: Index, landmarks: Index, probability: float) -> tuple[Index, Index]:
    """Of pairings (k,) of sightings and landmarks those that are jointly compatible in their ping."""
    order = np.argsort(pings.ping[d], kind="stable")
    d, landmarks = d[order], landmarks[order]
    b, S = ping_innovations(pings, estimate.graph, estimate.values, d, landmarks)
    ends = np.cumsum(np.unique(pings.ping[d], return_counts=True)[1])[:-1]
    chosen = []
    for nu, S_ping, c, l in zip(np.split(b, ends), S, np.split(d, ends), np.split(landmarks, ends), strict=True):
        sightings, i = np.unique(c, return_inverse=True)
        numbers, j = np.unique(l, return_inverse=True)
        at = jcbb(np.column_stack([i, j]), nu, S_ping, len(sightings), probability)
        chosen.append(np.stack([sightings[at >= 0], numbers[at[at >= 0]]]))
    sighting, landmark = np.concatenate(chosen, axis=1)
    return sighting, landmark
