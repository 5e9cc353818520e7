r"""Loops of a long mission: stretches whose landmarks are the same, by all of their landmarks together.

A single landmark has several others in its gate after a long way. A local map has the landmarks of either half of a
stretch, as an anchor sees them, the pose in its middle. All landmarks of a local map together have one place
(`nls.missions.contacts.alignment`). An alignment that is sure measures the motion between two anchors. A graph of all
other measurements and these motions brings the poses back, and says how well other motions are known. Maps are aligned
first where their motion is known best. It goes on until no loop is new. A loop that does not fit the others is taken
back, and not tried again.

Beside its anchor a landmark is known well, wherever dead reckoning has gone. The landmarks of a map share the errors
of the poses between them, so their covariance is a joint one. Landmarks i of map a are landmarks j of map b. The motion
G = X_a^-1 X_b between both anchors is then that of least squares with both joint covariances:

    r = p_i - G p_j,    J = R_G [I, -[p_j]x],    C = C_a + R_G C_b R_G',    Omega = J' C^-1 J

A match that all others contradict is left out. With M = W - W J Omega^-1 J' W and W = C^-1, the others predict r_k with
the error M_kk^-1 (M r)_k, whose covariance is M_kk^-1.

Sources: J. D. Tardos, J. Neira, P. Newman, J. Leonard, "Robust mapping and localization in indoor environments using
sonar data", International Journal of Robotics Research 21, 2002, for local maps with joint covariances; S. Julier,
J. Uhlmann, "A non-divergent estimation algorithm in the presence of unknown correlations", American Control Conference
1997, for the information of loops that share a map.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from factors import Between, Information, Robust
from factors.keys import Keys
from factors.noise import square
from models import LieGroup
from models.algebra import Array, Index, Mask, congruence
from models.chi_squared import chi2_gate
from models.sensors import point_in_frame
from nls.analysis.leave_one_out import UNCHECKED, left_out
from nls.covariance import Marginals
from nls.covariance.frames import of_motions
from nls.graph import FactorGraph
from nls.missions.contacts import partition
from nls.missions.contacts.alignment import LEAST_MATCHES, Points, aligned
from nls.missions.contacts.estimate import FIRST_KERNEL, Estimate, largest_variances, quadratic
from nls.missions.contacts.pings import Pings, bounds, middles, stretch_of_ping
from nls.stages import announce
from nls.values import Values


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
        """Covariances (k, d, d) of single landmarks."""
        k = np.arange(len(self.p))
        return np.asarray(self.C[k, k])


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

    None agrees where no motion is found that fits `LEAST_MATCHES` of them.

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
    for _ in range(20):  # steps of least squares, at most
        use = np.flatnonzero(agree)
        if len(use) < LEAST_MATCHES:
            break
        n, R, of_a, of_b = len(use), group.rotation(G[None])[0], i[use], j[use]
        C = a.C[of_a[:, None], of_a] + R @ b.C[of_b[:, None], of_b] @ R.T
        W, J = np.linalg.inv(C.swapaxes(1, 2).reshape(n * d, n * d)), (R @ H[use]).reshape(n * d, -1)
        r = (a.p[of_a] - group.act(G[None], b.p[of_b])).reshape(-1)
        Omega = congruence(J.T, W)
        P = np.linalg.pinv(Omega, hermitian=True)
        delta = P @ (J.T @ W @ r)
        G = group.compose(G[None], group.exp(delta[None]))[0]
        if delta @ Omega @ delta > 1e-2:  # squared length of a step, in sigmas, after which matches are left out
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


class Loop(NamedTuple):
    """Two maps that were aligned.

    Attributes
    ----------
    motion : (size,) from anchor to anchor.
    Omega : (d, d) its information.
    i, j, d2 : (k,) a sighting of a landmark in one map, one in the other, and their squared distance.
    """

    motion: Array
    Omega: Array
    i: Index
    j: Index
    d2: Array


Loops = dict[tuple[int, int], Loop]


def closed(
    pings: Pings, graph: FactorGraph, values: Values, tracks: Index, stretches: list[list[LocalMap]], probability: float
) -> tuple[Index, Values]:
    """Tracks (n,), joined where loops bring them together, and the poses by these loops.

    Parameters
    ----------
    pings : the sightings.
    graph, values : the other measurements, and poses by them.
    tracks : (n,) of sightings, by stretches alone.
    stretches : the maps of each. Those of one stretch are not aligned: it has compared their landmarks.
    probability : with which a right match, and a right loop, are within their gates.
    """
    maps = [local for stretch in stretches for local in stretch]
    if not maps:
        return tracks, values
    anchors = Keys(pings.poses.kind, np.concatenate([local.anchor.numbers for local in maps]))
    of_stretch = np.arange(len(stretches)).repeat([len(stretch) for stretch in stretches])
    gate = chi2_gate(pings.group.point_dim, probability)
    loops: Loops = {}
    better = 2.0  # times, after which a motion that is known so much better is tried again
    # the width of every motion when it was last tried; 0 of maps that are aligned, or of one stretch
    tried = np.where(of_stretch[:, None] == of_stretch, 0.0, np.inf)
    placed, widest = _Placed(pings.group, maps, anchors, Marginals(graph, values), gate), 0.0
    while True:
        a, b, Sigma, width = placed.near
        fresh = better * width < tried[a, b]
        if not fresh.any():
            break
        widest = max(widest, better * width[fresh].min())
        now = np.flatnonzero(fresh & (width <= widest))
        new = {(int(a[n]), int(b[n])): placed.loop(a[n], b[n], Sigma[n]) for n in now}
        tried[a[now], b[now]] = np.where([*map(bool, new.values())], 0.0, width[now])
        if any(new.values()):
            loops |= {pair: loop for pair, loop in new.items() if loop}
            loops, marginals = _held(graph, values, anchors, loops, probability)
            values, placed = marginals.values, _Placed(pings.group, maps, anchors, marginals, gate)
            announce(f"{len(loops):,} loops between {len(maps):,} local maps")
    if loops:
        i, j, d2 = map(np.concatenate, [*zip(*loops.values(), strict=True)][2:])
        tracks = partition.merged_both_ways(tracks, pings.ping, i, j, d2, gate)
    return tracks, values


def _held(
    graph: FactorGraph, values: Values, anchors: Keys, loops: Loops, probability: float
) -> tuple[Loops, Marginals]:
    """The loops that fit one another, and the poses by them with their covariances.

    All n loops of a map share its errors. With 1/n of its information each, they promise no more than is true.
    """
    while loops:
        a, b = np.array([*loops]).T
        n = np.bincount(np.append(a, b))
        Z, Omega = (np.stack([loop[k] for loop in loops.values()]) for k in range(2))
        shared = Omega / np.maximum(n[a], n[b])[:, None, None]
        between = Between(anchors[a], anchors[b], Z, Robust(Information(shared), FIRST_KERNEL))
        whole = FactorGraph([*graph.factors, between], graph.fixed)
        poses = whole.optimize(values).values
        marginals, (model, X) = Marginals(whole, poses), poses.gather(between)
        C = congruence(square(model.W), marginals.relative(anchors[a], anchors[b]))
        t, _ = left_out(model.error(*X), C, between.weights(poses))
        wrong = t > max(chi2_gate(len(Omega[0]), probability), t.max() / 2)  # it makes others look wrong
        if not wrong.any():
            return loops, marginals
        loops = {pair: loop for (pair, loop), out in zip(loops.items(), wrong, strict=True) if not out}
    return loops, Marginals(graph, graph.optimize(values).values)


@dataclass(frozen=True)
class _Placed:
    """Local maps where a graph has their anchors, and the gate of a match.

    The marginals are those of the graph; X (s, size) are the anchors there.
    """

    group: LieGroup
    maps: list[LocalMap]
    anchors: Keys
    marginals: Marginals
    gate: float

    @cached_property
    def X(self) -> Array:
        return self.marginals.values[self.anchors]

    @cached_property
    def near(self) -> tuple[Index, Index, Array, Array]:
        """Pairs a, b (n,) that may share landmarks, the covariance (n, d, d) of their motion, its width (n,) in m."""
        group, X, joint = self.group, self.X, self.marginals.joint(self.anchors, frame="body")
        Sigma = joint.matrix.reshape((len(X), group.dim) * 2).swapaxes(1, 2)
        middle = np.stack([local.p.mean(axis=0) for local in self.maps])
        radius = np.array([_farthest(local.p - p) for local, p in zip(self.maps, middle, strict=True)])
        arm, middle = np.array([_farthest(local.p) for local in self.maps]), group.act(X, middle)
        a, b = np.triu_indices(len(X), 1)
        motions = of_motions(group, group.between(X[a], X[b]), Sigma[a, a], Sigma[a, b], Sigma[b, b])
        position, turn = map(np.sqrt, largest_variances(motions, middle.shape[1]))
        width = position + arm[b] * turn
        near = np.linalg.norm(middle[a] - middle[b], axis=1) < radius[a] + radius[b] + np.sqrt(self.gate) * width
        return a[near], b[near], motions[near], width[near]

    def loop(self, a: int, b: int, Sigma: Array) -> Loop | None:
        """The loop of maps a and b, where their alignment is sure; Sigma (d, d) is the covariance of their motion."""
        group, first, second = self.group, self.maps[a], self.maps[b]
        G = group.between(self.X[[a]], self.X[[b]])
        back = group.inverse(G)
        a_in_b = Points(group.act(back, first.p), congruence(group.rotation(back), first.covariances))
        alignment = aligned(group, a_in_b, Points(second.p, second.covariances), Sigma, self.gate)
        if alignment is None or not alignment.sure:
            return None
        i, j = alignment.i, alignment.j
        start = group.compose(G, group.exp(alignment.delta[None]))[0]
        motion, Omega, agree = measured_motion(group, first, second, i, j, start, self.gate)
        if not agree.any():
            return None
        return Loop(motion, Omega, first.sightings[i[agree]], second.sightings[j[agree]], alignment.d2[agree])


def _farthest(p: Array) -> float:
    """The largest length of vectors (k, d)."""
    return float(np.linalg.norm(p, axis=1).max())
