"""Loops of a long mission: stretches whose landmarks are the same, by all of their landmarks together.

A single landmark has several others in its gate after a long way. All landmarks of a local map together have one place
(`nls.missions.contacts.alignment`). An alignment that is sure measures the motion between two anchors
(`nls.missions.contacts.maps`). A graph of all other measurements and these motions brings the poses back, and says how
well other motions are known. Maps are aligned first where their motion is known best. It goes on until no loop is new.
A loop that does not fit the others is taken back, and not tried again.

Source: S. Julier, J. Uhlmann, "A non-divergent estimation algorithm in the presence of unknown correlations", American
Control Conference 1997, for the information of loops that share a map.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from factors import Between, Information, Robust
from factors.keys import Keys
from factors.noise import square
from models import LieGroup
from models.algebra import Array, Index, congruence
from nls.analysis.chi_squared import chi2_gate
from nls.analysis.leave_one_out import left_out
from nls.covariance import Marginals
from nls.covariance.frames import of_motions
from nls.graph import FactorGraph
from nls.missions.contacts.alignment import Points, aligned
from nls.missions.contacts.estimate import FIRST
from nls.missions.contacts.maps import LocalMap, measured_motion
from nls.missions.contacts.merging import merged_both_ways
from nls.missions.contacts.pairs import largest_variances
from nls.missions.contacts.places import Pings
from nls.stages import announce
from nls.values import Values

__all__ = ["closed"]

BETTER = 2.0  # times; a motion that is known so much better is tried again


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
    # the width of every motion when it was last tried; 0 of maps that are aligned, or of one stretch
    tried = np.where(of_stretch[:, None] == of_stretch, 0.0, np.inf)
    placed, widest = _placed(pings.group, maps, anchors, Marginals(graph, values), gate), 0.0
    while True:
        a, b, Sigma, width = placed.near
        fresh = BETTER * width < tried[a, b]
        if not fresh.any():
            break
        widest = max(widest, BETTER * width[fresh].min())
        now = np.flatnonzero(fresh & (width <= widest))
        new = {(int(a[n]), int(b[n])): placed.loop(a[n], b[n], Sigma[n]) for n in now}
        tried[a[now], b[now]] = np.where([*map(bool, new.values())], 0.0, width[now])
        if any(new.values()):
            loops |= {pair: loop for pair, loop in new.items() if loop}
            loops, marginals = _held(graph, values, anchors, loops, probability)
            values, placed = marginals.values, _placed(pings.group, maps, anchors, marginals, gate)
            announce(f"{len(loops):,} loops between {len(maps):,} local maps")
    if loops:
        i, j, d2 = map(np.concatenate, [*zip(*loops.values(), strict=True)][2:])
        tracks = merged_both_ways(tracks, pings.ping, i, j, d2, gate)
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
        between = Between(anchors[a], anchors[b], Z, Robust(Information(shared), FIRST))
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

    X (s, size) are the anchors, Sigma (s, s, d, d) is their joint covariance.
    """

    group: LieGroup
    maps: list[LocalMap]
    X: Array
    Sigma: Array
    gate: float

    @cached_property
    def near(self) -> tuple[Index, Index, Array, Array]:
        """Pairs a, b (n,) that may share landmarks, the covariance (n, d, d) of their motion, its width (n,) in m."""
        group, X, Sigma = self.group, self.X, self.Sigma
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


def _placed(group: LieGroup, maps: list[LocalMap], anchors: Keys, marginals: Marginals, gate: float) -> _Placed:
    """Maps with their anchors where the marginals have them."""
    shape = (len(anchors), group.dim) * 2
    Sigma = marginals.joint(anchors, frame="body").matrix.reshape(shape).swapaxes(1, 2)
    return _Placed(group, maps, marginals.values[anchors], Sigma, gate)
