r"""What the sightings of a ping say together.

A pairing p of a sighting with a landmark has the innovation b_p and the Jacobians A_p of pose and landmark. Pairings of
one ping share the error of its pose, and their landmarks are correlated:

    nu = (b_1, ..., b_k),   S_pq = A_p P A_q' + [p = q] I,      a set is compatible with  nu' S^-1 nu  within its gate

with P the joint covariance.

Source: J. Neira, J. D. Tardos, "Data association in stochastic mapping using the joint compatibility test", IEEE
Transactions on Robotics and Automation 17, 2001.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Index
from models.errors import ResourceLimitError
from nls.analysis.chi_squared import chi2_gate
from nls.filters.association import jcbb
from nls.missions.contacts import tracks as of
from nls.missions.contacts.anchors import Anchored
from nls.missions.contacts.estimate import Estimate, measured_numbers
from nls.missions.contacts.gates import landmark_distances, ping_innovations
from nls.missions.contacts.merging import superfluous
from nls.missions.contacts.places import Pings

__all__ = ["resolved"]


def resolved(
    pings: Pings,
    estimate: Estimate,
    anchored: Anchored,
    d: Index,
    landmarks: Index,
    least: int,
    probability: float,
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
    tracks, m = estimate.tracks, measured_numbers(pings)
    every = np.arange(len(tracks))
    d2, _ = landmark_distances(pings, estimate, anchored, d, landmarks)
    near = d2 < chi2_gate(m, probability)
    d, landmarks, d2 = d[near], landmarks[near], d2[near]
    needless = superfluous(tracks, d, landmarks, d2, m, probability)
    undecided = needless | (of.sizes(tracks) < least)
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
    return of.renamed(groups)
