r"""How well poses and landmarks are known beside each other: the covariances of motions between any two pings.

An anchor a is a pose in the middle of a stretch of pings. The motion between two pings goes by their anchors:

    X_i^-1 X_j = (a_i^-1 X_i)^-1 (a_i^-1 a_j) (a_j^-1 X_j)

Each of the three has a covariance from the graph; their errors count as independent. So only poses and landmarks beside
their own anchors are asked for, and anchors beside near ones. They are about as many as the pings. The pairs of
sightings are many times more, and would fill the factor of the graph.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from factors.keys import Keys
from models import LieGroup
from models.algebra import Array, Index, congruence, product
from models.sensors import point_in_frame
from nls.covariance import Marginals
from nls.missions.contacts.estimate import Estimate
from nls.missions.contacts.places import Pings
from nls.missions.contacts.stretches import bounds, middles, stretch_of_ping

__all__ = ["Anchored", "Motions"]

PINGS = 10  # of a stretch, at most


class Motions(NamedTuple):
    """Covariances Sigma (q, d, d) of motions, in the axes of the later pose, and which (k,) is that of each pair."""

    Sigma: Array
    which: Index


class Anchored:
    """Covariances of motions between pings, and of landmarks beside their anchors, at an estimate.

    Parameters
    ----------
    pings, estimate : the sightings, and poses and landmarks by them. Landmarks may be cut (`splitting.Cuts`).
    pairs : (c, d) of sightings (k,), whose motions are asked for. A landmark has the number of its first sighting.

    Attributes
    ----------
    marginals : of the estimate, with what the motions need.
    """

    def __init__(self, pings: Pings, estimate: Estimate, *pairs: tuple[Index, Index]) -> None:
        self._pings, begin = pings, bounds(len(pings.poses), PINGS)
        self._anchor = middles(begin)[stretch_of_ping(begin)]  # (m,) place of that of every ping
        poses, anchors = pings.poses, pings.poses[self._anchor]
        moved = np.flatnonzero(poses.numbers != anchors.numbers)
        near = [_once(len(poses), *(self._anchor[pings.ping[of]] for of in pair))[0] for pair in pairs]
        apart = [(poses[a[a != b]], poses[b[a != b]]) for a, b in near]
        values = estimate.values
        numbers = values.stack(pings.kind).numbers if pings.kind.name in values.stacks else np.zeros(0, dtype=np.intp)
        numbers = numbers[numbers < len(pings)]  # above are parts of these (`splitting.Cuts`)
        self._landmarks = anchors[pings.ping[numbers]], pings.kind[numbers]
        beside = [(anchors[moved], poses[moved]), self._landmarks, *apart]
        self.marginals = Marginals(estimate.graph, values, pairs=beside)
        d = pings.group.dim
        self._own = np.zeros((len(poses), d, d))  # of the motions from anchors to their pings
        self._own[moved] = self.marginals.relative(*beside[0])

    def of_sightings(self, c: Index, d: Index) -> Motions:
        """From the pings of sightings c (k,) to those of d (k,), for `pairs`."""
        return self._motions(self._pings.ping[c], self._pings.ping[d])

    def of_landmarks(self, landmarks: Index, d: Index) -> Motions:
        """From the anchors of landmarks (k,) to the pings of sightings d (k,), for `pairs`."""
        return self._motions(self._anchor[self._pings.ping[landmarks]], self._pings.ping[d])

    def _motions(self, i: Index, j: Index) -> Motions:
        group, poses, values = self._pings.group, self._pings.poses, self.marginals.values
        (i, j), which = _once(len(poses), i, j)
        a, b = self._anchor[i], self._anchor[j]
        X_j, apart = values[poses[j]], np.flatnonzero(a != b)
        Sigma = self._own[j] + congruence(_adjoint(group, values[poses[i]], X_j), self._own[i])
        between = self.marginals.relative(poses[a[apart]], poses[b[apart]])
        Sigma[apart] += congruence(_adjoint(group, values[poses[b[apart]]], X_j[apart]), between)
        return Motions(Sigma, which)

    def landmarks(self) -> Array:
        """Covariances (q, d, d) of all landmarks as their anchors see them, in the axes of the world."""
        return _of_points(self._pings.group, self.marginals, *self._landmarks)


def _once(count: int, i: Index, j: Index) -> tuple[tuple[Index, Index], Index]:
    """Pairs of pings i and j (k,), of so many, each pair once, and the place (k,) of each among these."""
    pairs, which = np.unique(i * count + j, return_inverse=True)
    return np.divmod(pairs, count), which


def _of_points(group: LieGroup, marginals: Marginals, a: Keys, l: Keys) -> Array:
    """Covariances (q, d, d) of landmarks l (q,) as their anchors a see them, in the axes of the world."""
    X = marginals.values[a]
    _, (H_a, H_l) = point_in_frame(group, X, marginals.values[l])
    half = product(product(H_a, marginals.cross(a, l, "body")), H_l.mT)
    C = congruence(H_a, marginals.covariance(a, "body")) + congruence(H_l, marginals.covariance(l)) + half + half.mT
    return congruence(group.rotation(X), C)


def _adjoint(group: LieGroup, X: Array, Y: Array) -> Array:
    """Ad (n, d, d) of the motions from Y to X: errors at X, as Y sees them."""
    return group.adjoint_inverse(group.between(X, Y))
