r"""Local maps: the landmarks of either half of a stretch, as an anchor sees them, the pose in its middle.

Beside its anchor a landmark is known well, wherever dead reckoning has gone. The landmarks of a map share the errors
of the poses between them, so their covariance is a joint one. Landmarks i of map a are landmarks j of map b. The motion
G = X_a^-1 X_b between both anchors is then that of least squares with both joint covariances:

    r = p_i - G p_j,    J = R_G [I, -[p_j]x],    C = C_a + R_G C_b R_G',    Omega = J' C^-1 J

A match that all others contradict is left out. With M = W - W J Omega^-1 J' W and W = C^-1, the others predict r_k with
the error M_kk^-1 (M r)_k, whose covariance is M_kk^-1.

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
from nls.analysis.leave_one_out import UNCHECKED
from nls.covariance import Marginals
from nls.missions.contacts.alignment import LEAST
from nls.missions.contacts.estimate import Estimate
from nls.missions.contacts.gates import quadratic
from nls.missions.contacts.places import Pings
from nls.missions.contacts.stretches import bounds, middles, stretch_of_ping

__all__ = ["LocalMap", "local_maps", "measured_motion"]

STEPS = 20  # of least squares, at most
NEAR = 1e-2  # squared length of a step, in sigmas, after which matches are left out


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
    def covariances(self) -> Array:
        """Those (k, d, d) of single landmarks."""
        k = np.arange(len(self.p))
        return np.asarray(self.C[k, k])

    def renumbered(self, rows: Index) -> LocalMap:
        """The same map, whose sightings have the numbers rows (n,) among all."""
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
    """The motion (size,) between the anchors of two maps, its information (m, m), and which matches (k,) agree on it.

    None agrees where no motion is found that fits `LEAST` of them.

    Parameters
    ----------
    group : of the motion.
    a, b, i, j : the maps, and landmarks i (k,) of a that are landmarks j (k,) of b.
    G : (size,) a motion to begin with.
    gate : bound on d^2 of a match from what all others predict.
    """
    d, agree = a.p.shape[1], np.ones(len(i), dtype=bool)
    H = -point_in_frame(group, group.identity(len(j)), b.p[j])[1][0]
    Omega = np.zeros((H.shape[2],) * 2)
    for _ in range(STEPS):
        use = np.flatnonzero(agree)
        if len(use) < LEAST:
            break
        n, R, of_a, of_b = len(use), group.rotation(G[None])[0], i[use], j[use]
        C = a.C[of_a[:, None], of_a] + R @ b.C[of_b[:, None], of_b] @ R.T
        W, J = np.linalg.inv(C.swapaxes(1, 2).reshape(n * d, n * d)), (R @ H[use]).reshape(n * d, -1)
        r = (a.p[of_a] - group.act(G[None], b.p[of_b])).reshape(-1)
        Omega = congruence(J.T, W)
        P = np.linalg.pinv(Omega, hermitian=True)
        delta = P @ (J.T @ W @ r)
        G = group.compose(G[None], group.exp(delta[None]))[0]
        if delta @ Omega @ delta > NEAR:
            continue
        WJ, k = W @ J, np.arange(n)
        M = (W - WJ @ P @ WJ.T).reshape(n, d, n, d)[k, :, k]
        checked = np.linalg.pinv(M, UNCHECKED, hermitian=True)  # along what the others say nothing of, nothing is wrong
        d2 = quadratic((W @ (r - J @ delta)).reshape(n, d), checked)
        wrong = d2 > max(gate, d2.max() / 2)  # it makes others look wrong
        if not wrong.any():
            return G, Omega, agree
        agree[use[wrong]] = False
    return G, Omega, np.zeros_like(agree)
