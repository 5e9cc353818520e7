r"""Local maps: the landmarks of either half of a stretch, as an anchor sees them, the pose in its middle.

Beside its anchor a landmark is known well, wherever dead reckoning has gone. The landmarks of a map share the errors
of the poses between them, so their covariance is a joint one. Where landmarks i of map a are landmarks j of map b, the
motion G = X_a^-1 X_b between both anchors is that of least squares with both joint covariances:

    r = p_i - G p_j,    J = R_G [I, -[p_j]x],    C = C_a + R_G C_b R_G',    Omega = J' C^-1 J

A match that all others contradict is left out. With W = C^-1, they predict r_k with the error W_kk^-1 (W r)_k, whose
covariance is W_kk^-1.

Source: J. D. Tardos, J. Neira, P. Newman, J. Leonard, "Robust mapping and localization in indoor environments using
sonar data", International Journal of Robotics Research 21, 2002, for local maps with joint covariances.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from factors.keys import Keys
from models import LieGroup
from models.algebra import Array, Index, Mask, congruence
from models.sensors import point_in_frame
from nls.analysis.chi_squared import mahalanobis
from nls.covariance import Marginals
from nls.sonar.contacts.estimate import Estimate
from nls.sonar.contacts.places import Pings
from nls.sonar.contacts.stretches import bounds, middles, stretch_of_ping

__all__ = ["LocalMap", "local_maps", "measured_motion"]

STEPS = 20  # of least squares, at most
NEAR = 1e-2  # squared length of the last one in sigmas; then matches are left out


class LocalMap(NamedTuple):
    """Landmarks as an anchor sees them.

    Attributes
    ----------
    anchor : the pose (1,).
    sightings : (k,) the first one of each landmark.
    p : (k, d) where they are, m.
    C : (k, k, d, d) their joint covariance, m^2.
    """

    anchor: Keys
    sightings: Index
    p: Array
    C: Array

    @property
    def own(self) -> Array:
        """Covariance (k, d, d) of each landmark."""
        k = np.arange(len(self.p))
        return np.asarray(self.C[k, k])

    def of(self, rows: Index) -> LocalMap:
        """The same map, where its sightings are so numbered (n,) among all."""
        return self._replace(sightings=rows[self.sightings])


def local_maps(pings: Pings, estimate: Estimate, least: int) -> list[LocalMap]:
    """The maps of a stretch, of landmarks with at least so many sightings in a half of it."""
    m, d, maps = len(pings.poses), pings.group.point_dim, []
    begin = bounds(m, -(-m // 2))
    half, marginals = stretch_of_ping(begin)[pings.ping], Marginals(estimate.graph, estimate.values)
    for k, ping in enumerate(middles(begin)):
        anchor, inside = pings.poses[[ping]], np.flatnonzero(half == k)
        names, first, count = np.unique(estimate.tracks[inside], return_index=True, return_counts=True)
        several = count >= least
        if not several.any():
            continue
        n, landmarks = int(np.count_nonzero(several)), pings.kind[names[several]]
        X = estimate.values[anchor].repeat(n, axis=0)
        p, (H_a, H_l) = point_in_frame(pings.group, X, estimate.values[landmarks])
        B = np.concatenate([H_a.reshape(n * d, -1), np.kron(np.eye(n), H_l[0])], axis=1)
        C = B @ marginals.joint([anchor, landmarks], frame="body").matrix @ B.T
        maps.append(LocalMap(anchor, inside[first[several]], p, C.reshape(n, d, n, d).swapaxes(1, 2)))
    return maps


def measured_motion(
    group: LieGroup, a: LocalMap, b: LocalMap, i: Index, j: Index, G: Array, gate: float
) -> tuple[Array, Array, Mask]:
    """The motion (size,) between the anchors of two maps, its information (m, m), and which matches agree on it.

    Parameters
    ----------
    group : of the motion.
    a, b, i, j : the maps, and landmarks i (k,) of a that are landmarks j (k,) of b.
    G : (size,) a motion to begin with.
    gate : bound on d^2 of a match by all others.
    """
    d, agree = a.p.shape[1], np.ones(len(i), dtype=bool)
    H = -point_in_frame(group, group.identity(len(j)), b.p[j])[1][0]
    Omega = np.zeros((H.shape[2],) * 2)
    for _ in range(STEPS):
        use = np.flatnonzero(agree)
        n, R, of_a, of_b = len(use), group.rotation(G[None])[0], i[use], j[use]
        C = a.C[of_a[:, None], of_a] + R @ b.C[of_b[:, None], of_b] @ R.T
        W, J = np.linalg.inv(C.swapaxes(1, 2).reshape(n * d, n * d)), (R @ H[use]).reshape(n * d, -1)
        r = (a.p[of_a] - group.act(G[None], b.p[of_b])).reshape(-1)
        Omega = congruence(J.T, W)
        delta = np.linalg.pinv(Omega, hermitian=True) @ (J.T @ W @ r)
        G = group.compose(G[None], group.exp(delta[None]))[0]
        if delta @ Omega @ delta > NEAR:
            continue
        pull, own = (W @ (r - J @ delta)).reshape(n, d), W.reshape(n, d, n, d)[np.arange(n), :, np.arange(n)]
        d2 = mahalanobis(pull, own)
        worst = d2 > max(gate, d2.max(initial=0.0) / 2)  # a wrong match makes others look wrong
        if not worst.any():
            break
        agree[use[worst]] = False
    return G, Omega, agree
