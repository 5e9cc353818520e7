"""Loops of a long mission: stretches whose landmarks are the same, by all of their landmarks together.

A single landmark has several others in its gate after a long way. All landmarks of a stretch together have one place
(`nls.sonar.contacts.alignment`). Each alignment that is sure is a measurement of the motion between two anchors. With
these, the other motions are known better. So it goes on until no loop is new. A loop whose landmarks the other loops
draw apart is taken back, and not tried again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from factors import Between, Information, Robust
from models.algebra import Array, Index
from nls.analysis.chi_squared import chi2_gate, mahalanobis
from nls.graph import FactorGraph
from nls.sonar.contacts import tracks as of
from nls.sonar.contacts.alignment import WIDE, aligned
from nls.sonar.contacts.estimate import FIRST, KERNEL, estimated, without
from nls.sonar.contacts.maps import Maps, local_maps
from nls.sonar.contacts.merging import merged
from nls.sonar.contacts.pairs import largest_variances
from nls.sonar.contacts.places import Pings
from nls.stages import announce
from nls.values import Values

__all__ = ["closed"]

PINGS = 100  # of a stretch, at most


class Loop(NamedTuple):
    """Two stretches with landmarks in common.

    Attributes
    ----------
    motion : (size,) from the anchor of the one to that of the other.
    Omega : (d, d) its information.
    i, j, d2 : (k,) tracks of the one and of the other within the gate, and their squared distance.
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
    tracks : (n,) of sightings, stretch by stretch.
    least : sightings of a landmark that is matched.
    probability : with which a right match is within its gate.
    """
    if of.sizes(tracks).max() < least:
        return tracks, values
    loops: dict[tuple[int, int], Loop] = {}
    tried: set[tuple[int, int]] = set()
    gate = chi2_gate(pings.group.point_dim, probability)
    estimate = estimated(pings, graph, values, tracks, FIRST)
    while True:
        maps = local_maps(pings, estimate, PINGS, least)
        held = {pair: loop for pair, loop in loops.items() if _holds(maps, loop, gate)}
        new = _new_loops(maps, tried, gate)
        settled = not new and len(held) == len(loops)
        loops = held | new
        tried |= new.keys()
        if settled or not loops:
            break
        a, b = np.array([*loops]).T
        Z, Omega, *_ = zip(*loops.values(), strict=True)
        noise = Robust(Information(np.stack(Omega)), KERNEL)
        between = Between(maps.anchors[a], maps.anchors[b], np.stack(Z), noise)
        looped = FactorGraph([*graph.factors, between], graph.fixed)
        poses = looped.optimize(without(estimate.values, pings.kind)).values
        estimate = estimated(pings, looped, poses, tracks)
        announce(f"{len(loops):,} loops between {len(maps.anchors):,} stretches of the mission")
    if loops:
        i, j, d2 = map(np.concatenate, [*zip(*loops.values(), strict=True)][2:])
        both = np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([d2, d2])
        tracks = merged(tracks, pings.ping, *both, gate)
    return tracks, without(estimate.values, pings.kind)


def _holds(maps: Maps, loop: Loop, gate: float) -> bool:
    """Whether landmarks of a loop are still together, with all other loops."""
    p, C = maps.points
    i, j = np.searchsorted(maps.tracks, loop.i), np.searchsorted(maps.tracks, loop.j)
    return bool(np.median(mahalanobis(p[j] - p[i], C[i] + C[j])) < WIDE * gate)


def _new_loops(maps: Maps, tried: set[tuple[int, int]], gate: float) -> dict[tuple[int, int], Loop]:
    """Loops between pairs of stretches whose alignment is sure, without pairs that had one."""
    group = maps.group
    new = {}
    for (a, b), Sigma in _near(maps, gate):
        if (a, b) in tried:
            continue
        first, second = maps.seen_from(b, a), maps.seen_from(b, b)
        alignment = aligned(group, first, second, Sigma, gate)
        if alignment is not None and alignment.sure:
            motion = group.between(maps.X[[a]], group.compose(maps.X[[b]], group.exp(alignment.delta[None])))[0]
            i, j = maps.tracks[maps.stretch == a][alignment.i], maps.tracks[maps.stretch == b][alignment.j]
            new[a, b] = Loop(motion, alignment.Omega, i, j, alignment.d2)
    return new


def _near(maps: Maps, gate: float) -> Iterator[tuple[tuple[int, int], Array]]:
    """Pairs of stretches that may have landmarks in common, and the covariance (d, d) of the motion between them."""
    p, count = maps.points.p, len(maps.anchors)
    k = p.shape[1]
    middle, radius = np.zeros((count, k)), np.zeros(count)
    np.add.at(middle, maps.stretch, p)
    middle /= np.maximum(np.bincount(maps.stretch, minlength=count), 1)[:, None]
    np.maximum.at(radius, maps.stretch, np.linalg.norm(p - middle[maps.stretch], axis=1))
    a, b = np.triu_indices(count, 1)
    Sigma = maps.motions(a, b)
    position, turn = map(np.sqrt, largest_variances(Sigma, k))
    reach = radius[a] + radius[b] + np.sqrt(gate) * (position + 2 * radius[b] * turn)
    for n in np.flatnonzero(np.linalg.norm(middle[a] - middle[b], axis=1) < reach):
        yield (int(a[n]), int(b[n])), Sigma[n]
