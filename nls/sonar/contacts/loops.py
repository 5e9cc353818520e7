"""Loops of a long mission: stretches whose landmarks are the same, by all of their landmarks together.

A single landmark has several others in its gate after a long way. All landmarks of a stretch together have one place
(`nls.sonar.contacts.alignment`). Each alignment that is sure joins tracks, and measures the motion between two anchors.
These motions bring the poses back. Then the joined tracks say how well other motions are known. The alignment itself
would promise too much, because its matches share the errors of both maps. It goes on until no loop is new. A loop whose
landmarks the other ones draw apart is taken back, and not tried again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from factors import Between, Information, Robust
from factors.keys import Keys
from models.algebra import Array, Index
from nls.analysis.chi_squared import chi2_gate
from nls.graph import FactorGraph
from nls.sonar.contacts import tracks as of
from nls.sonar.contacts.alignment import WIDE, aligned
from nls.sonar.contacts.estimate import FIRST, estimated, without
from nls.sonar.contacts.maps import Maps, local_maps
from nls.sonar.contacts.merging import merged_both_ways
from nls.sonar.contacts.pairs import largest_variances
from nls.sonar.contacts.places import Pings
from nls.stages import announce
from nls.values import Values

__all__ = ["closed"]

PINGS = 100  # of a stretch, at most
BETTER = 2.0  # times; a motion that is known so much better is tried again


class Loop(NamedTuple):
    """Two stretches with landmarks in common.

    Attributes
    ----------
    motion : (size,) from the anchor of the one to that of the other.
    Omega : (d, d) its information.
    i, j, d2 : (k,) sightings of the one and of the other whose landmarks match, and the squared distance of these.
    """

    motion: Array
    Omega: Array
    i: Index
    j: Index
    d2: Array


def closed(
    pings: Pings, graph: FactorGraph, values: Values, tracks: Index, least: int, probability: float
) -> tuple[Index, Values]:
    """Tracks (n,), joined where loops bring them together, and the poses by these loops.

    Parameters
    ----------
    pings : the sightings.
    graph, values : the other measurements, and poses by them.
    tracks : (n,) of sightings, by stretches alone.
    least : sightings of a landmark that is matched.
    probability : with which a right match is within its gate.
    """
    if of.sizes(tracks).max() < least:
        return tracks, values
    loops: dict[tuple[int, int], Loop] = {}
    tried: dict[tuple[int, int], float] = {}
    gate = chi2_gate(pings.group.point_dim, probability)
    joined, estimate = tracks, estimated(pings, graph, values, tracks, FIRST)
    while True:
        misfit = np.bincount(tracks, estimate.d2)[tracks] / of.sizes(tracks)
        held = {pair: loop for pair, loop in loops.items() if _holds(misfit, loop, gate)}
        maps = local_maps(pings, estimate, PINGS, least)
        new = _new_loops(maps, tried, gate)
        if not new and len(held) == len(loops):
            return joined, without(estimate.values, pings.kind)
        loops = held | new
        joined, poses = tracks, values
        if loops:
            i, j, d2 = map(np.concatenate, [*zip(*loops.values(), strict=True)][2:])
            joined = merged_both_ways(tracks, pings.ping, i, j, d2, gate)
            poses = _looped(graph, values, maps.anchors, loops)
        estimate = estimated(pings, graph, poses, joined, FIRST)
        announce(f"{len(loops):,} loops between {len(maps.anchors):,} stretches of the mission")


def _looped(graph: FactorGraph, values: Values, anchors: Keys, loops: dict[tuple[int, int], Loop]) -> Values:
    """Poses by the motions between anchors that loops measure, from those by all other measurements."""
    a, b = np.array([*loops]).T
    Z, Omega, *_ = zip(*loops.values(), strict=True)
    between = Between(anchors[a], anchors[b], np.stack(Z), Robust(Information(np.stack(Omega)), FIRST))
    return FactorGraph([*graph.factors, between], graph.fixed).optimize(values).values


def _holds(misfit: Array, loop: Loop, gate: float) -> bool:
    """Whether the landmarks of a loop fit on both sides, by the mean d2 of the track of every sighting (n,)."""
    return all(float(np.median(misfit[side])) < WIDE * gate for side in (loop.i, loop.j))


def _new_loops(maps: Maps, tried: dict[tuple[int, int], float], gate: float) -> dict[tuple[int, int], Loop]:
    """Loops between pairs of stretches whose alignment is sure.

    Pairs that were `tried` have the width of their motion then, and 0 where they had a loop. New ones are noted there.
    """
    group, X = maps.group, maps.X
    new = {}
    for (a, b), Sigma, width in _near(maps, gate):
        if BETTER * width > tried.get((a, b), np.inf):
            continue
        first, second = maps.seen_from(b, a), maps.seen_from(b, b)
        alignment = aligned(group, first, second, Sigma, gate)
        tried[a, b] = width
        if alignment is not None and alignment.sure:
            motion = group.between(X[[a]], group.compose(X[[b]], group.exp(alignment.delta[None])))[0]
            i, j = maps.sightings[maps.stretch == a][alignment.i], maps.sightings[maps.stretch == b][alignment.j]
            new[a, b], tried[a, b] = Loop(motion, alignment.Omega, i, j, alignment.d2), 0.0
    return new


def _near(maps: Maps, gate: float) -> Iterator[tuple[tuple[int, int], Array, float]]:
    """Pairs of stretches that may have landmarks in common, the covariance (d, d) of their motion, its width in m."""
    p, count = maps.points.p, len(maps.anchors)
    k = p.shape[1]
    middle, radius = np.zeros((count, k)), np.zeros(count)
    np.add.at(middle, maps.stretch, p)
    middle /= np.maximum(np.bincount(maps.stretch, minlength=count), 1)[:, None]
    np.maximum.at(radius, maps.stretch, np.linalg.norm(p - middle[maps.stretch], axis=1))
    a, b = np.triu_indices(count, 1)
    Sigma = maps.motions(a, b)
    position, turn = map(np.sqrt, largest_variances(Sigma, k))
    width = position + 2 * radius[b] * turn
    reach = radius[a] + radius[b] + np.sqrt(gate) * width
    for n in np.flatnonzero(np.linalg.norm(middle[a] - middle[b], axis=1) < reach):
        yield (int(a[n]), int(b[n])), Sigma[n], float(width[n])
