r"""Bounds on how well a pose and a landmark are known beside each other, before their joint covariance.

An anchor a is a pose in the middle of a stretch of pings. A ping of that stretch has seen the landmark. Beside a, an
innovation has two errors:

    b = A_X u + A_l R_a v,      u that of the motion X_a^-1 X,    v that of the point X_a^-1 l

They grow with the way between the two poses, not with the way from the start. A_X u has the covariance U, A_l R_a v has
V. Whatever their correlation, the two bound the covariance of the sum along every axis:

    (sqrt(U_ii) - sqrt(V_ii))^2 <= cov_ii,        cov <= 2 (U + V)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from factors.keys import Keys
from models import LieGroup
from models.algebra import Array, Index, congruence, product
from models.sensors import point_in_frame
from nls.analysis.chi_squared import mahalanobis
from nls.covariance import Marginals
from nls.sonar.contacts.estimate import Estimate
from nls.sonar.contacts.places import Pings

__all__ = ["Pairings", "anchored", "bounded", "of_points", "of_sums"]

ANCHORS = 48
AT_ONCE = 1 << 15  # pairings, so that memory does not grow with their number


class Pairings(NamedTuple):
    """Sightings d (k,) with landmarks (k,) by number; anchors with poses and with points, and which (k,) is whose."""

    d: Index
    landmarks: Index
    poses: tuple[Keys, Keys]
    motion: Index
    points: tuple[Keys, Keys]
    point: Index

    @property
    def pairs(self) -> list[tuple[Keys, Keys]]:
        """The pairs of variables whose covariances `bounded` needs."""
        return [self.poses, self.points]


def anchored(pings: Pings, d: Index, landmarks: Index) -> Pairings:
    """Pairings of sightings d (k,) with landmarks (k,), with their anchors."""
    m, n = len(pings.poses), len(pings)
    numbers, point = np.unique(landmarks, return_inverse=True)
    stretch = -(-m // ANCHORS)
    anchor = np.minimum(pings.ping[numbers] // stretch * stretch + stretch // 2, m - 1)
    motions, motion = np.unique(pings.ping[d] * n + anchor[point], return_inverse=True)
    i, j = pings.poses[motions % n], pings.poses[motions // n]
    return Pairings(d, landmarks, (i, j), motion, (pings.poses[anchor], pings.kind[numbers]), point)


def bounded(pings: Pings, estimate: Estimate, marginals: Marginals, pairings: Pairings) -> tuple[Array, Array, Array]:
    """Of the innovations of pairings (k,), bounds on their joint covariances.

    The marginals of the estimate have the pairs of the pairings.

    Returns
    -------
    d2 (k,) by the bound from above, the largest sigma (k,) of independent errors, and a bound (k,) from below on it.
    """
    d, landmarks, poses, motion, points, point = pairings
    C_u, C_v = marginals.relative(*poses), of_points(pings.group, marginals, *points)
    d2, width, least = np.empty(len(d)), np.empty(len(d)), np.empty(len(d))
    for begin in range(0, len(d), AT_ONCE):
        span = slice(begin, begin + AT_ONCE)
        (A_X, A_l), b = estimate.linearized(pings, d[span], landmarks[span])[2:]
        U, V = congruence(A_X, C_u[motion[span]]), congruence(A_l, C_v[point[span]])
        I = np.eye(b.shape[1])
        d2[span] = mahalanobis(b, I + 2 * (U + V))
        width[span] = np.sqrt(np.linalg.eigvalsh(I + U + V)[:, -1])
        least[span] = np.sqrt(1 + ((_deviations(U) - _deviations(V)) ** 2).max(axis=1))
    return d2, width, least


def of_sums(J: Array, C_ii: Array, C_ij: Array, K: Array, C_jj: Array) -> Array:
    """Covariances (k, m, m) of J delta_i + K delta_j from the joint ones of two variables."""
    half = product(product(J, C_ij), K.mT)
    return np.asarray(congruence(J, C_ii) + congruence(K, C_jj) + half + half.mT)


def of_points(group: LieGroup, marginals: Marginals, a: Keys, l: Keys) -> Array:
    """Covariances (q, d, d) of landmarks l (q,) as their anchors a see them, in the axes of the world."""
    X = marginals.values[a]
    _, (H_a, H_l) = point_in_frame(group, X, marginals.values[l])
    C_aa, C_al, C_ll = marginals.covariance(a, "body"), marginals.cross(a, l, "body"), marginals.covariance(l)
    return congruence(group.rotation(X), of_sums(H_a, C_aa, C_al, H_l, C_ll))


def _deviations(C: Array) -> Array:
    """Standard deviations (k, m) along the axes; a motion of nothing may have rounding errors below zero."""
    return np.sqrt(np.maximum(np.diagonal(C, axis1=1, axis2=2), 0.0))
