"""Local maps: the landmarks of every stretch of pings, as its anchor sees them, the pose in its middle.

Beside its anchor a landmark is known well, wherever dead reckoning has gone. How well two maps are known beside each
other is the covariance of the motion between their anchors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from factors.keys import Keys
from models import LieGroup
from models.algebra import Array, Index, congruence
from nls.covariance import Marginals
from nls.covariance.frames import of_motions
from nls.sonar.contacts.anchors import of_points
from nls.sonar.contacts.estimate import Estimate
from nls.sonar.contacts.places import Pings
from nls.sonar.contacts.stretches import bounds, middles, stretch_of_ping

__all__ = ["Maps", "Points", "local_maps"]


class Points(NamedTuple):
    """Points p (k, d) in one frame, m, and their covariances C (k, d, d) beside the anchor of their map, m^2."""

    p: Array
    C: Array


@dataclass(frozen=True)
class Maps:
    """Local maps of stretches.

    Attributes
    ----------
    group : of the poses.
    anchors, X : (s,) poses and (s, size) where they are.
    Sigma : (s, s, d, d) their joint covariance, in the axes of the bodies.
    sightings, stretch : (k,) the first sighting of each landmark in its stretch.
    points : (k,) landmarks in the world.
    """

    group: LieGroup
    anchors: Keys
    X: Array
    Sigma: Array
    sightings: Index
    stretch: Index
    points: Points

    def seen_from(self, anchor: int, stretch: int) -> Points:
        """The landmarks of a stretch in the frame of an anchor."""
        which, X = self.stretch == stretch, self.X[[anchor]]
        p, R = self.group.act(self.group.inverse(X), self.points.p[which]), self.group.rotation(X)
        return Points(p, congruence(R.mT, self.points.C[which]))

    def motions(self, a: Index, b: Index) -> Array:
        """Covariances (n, d, d) of the motions from anchors a (n,) to b (n,), in the axes of b."""
        Sigma = self.Sigma
        return of_motions(self.group, self.group.between(self.X[a], self.X[b]), Sigma[a, a], Sigma[a, b], Sigma[b, b])


def local_maps(pings: Pings, estimate: Estimate, longest: int, least: int) -> Maps:
    """Maps of stretches of so many pings at most: landmarks with at least so many sightings in the stretch."""
    begin, n = bounds(len(pings.poses), longest), len(pings)
    anchors = pings.poses[middles(begin)]
    names = stretch_of_ping(begin)[pings.ping] * n + estimate.tracks
    _, first, count = np.unique(names, return_index=True, return_counts=True)
    sightings = first[count >= least]
    stretch, landmarks = np.divmod(names[sightings], n)
    keys = anchors[stretch], pings.kind[landmarks]
    marginals = Marginals(estimate.graph, estimate.values, pairs=[keys])
    shape = (len(anchors), pings.group.dim) * 2
    Sigma = marginals.joint(anchors, frame="body").matrix.reshape(shape)
    points = Points(estimate.values[keys[1]], of_points(pings.group, marginals, *keys))
    return Maps(pings.group, anchors, estimate.values[anchors], Sigma.swapaxes(1, 2), sightings, stretch, points)
