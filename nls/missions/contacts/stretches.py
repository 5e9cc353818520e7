"""Stretches of a long mission: pings that follow one another, and the measurements between their poses alone.

Dead reckoning drifts with the way. Within a stretch it has drifted little, and a target has few others beside it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from factors.keys import Keys, Kind
from factors.sighting import Sighting
from models.algebra import Index
from nls.gauge import by_number, component_labels
from nls.graph import FactorGraph
from nls.missions.contacts.estimate import without
from nls.missions.contacts.places import Pings
from nls.sparse.elimination import firsts
from nls.starts.parts import Parts
from nls.values import Stack, Values

__all__ = ["bounds", "middles", "stretch_of_ping", "stretches"]


def bounds(pings: int, longest: int) -> Index:
    """Where stretches of so many pings at most begin (n,), as long as one another, and in the end how many pings.

    Examples
    --------
    >>> bounds(7, longest=3)
    array([0, 2, 4, 7])
    """
    count = -(-pings // longest)
    return np.asarray(np.arange(count + 1) * pings // count)


def middles(begin: Index) -> Index:
    """The ping in the middle (n,) of every stretch, its anchor, by where they begin (n + 1,).

    Examples
    --------
    >>> middles(bounds(7, longest=3))
    array([1, 3, 5])
    """
    return (begin[:-1] + begin[1:]) // 2


def stretch_of_ping(begin: Index) -> Index:
    """The number of its stretch, for every ping (m,), by where stretches begin (n + 1,).

    Examples
    --------
    >>> stretch_of_ping(bounds(7, longest=3))
    array([0, 0, 1, 1, 2, 2, 2])
    """
    return np.arange(len(begin) - 1).repeat(np.diff(begin))


def stretches(
    pings: Pings, graph: FactorGraph, values: Values, longest: int
) -> Iterator[tuple[Index, Pings, FactorGraph, Values]]:
    """All stretches of the pings, as long as one another, each with the poses up to the next.

    Parameters
    ----------
    pings : of a mission.
    graph, values : its other measurements, and their optimum.
    longest : pings of a stretch, at most.

    Yields
    ------
    sightings (k,) of a stretch by their place among all, the same as pings, and a graph with values. Held are its first
    pose, or the first of every component, and all that is no pose.
    """
    parts, poses, number = Parts(graph, values), values.stack(pings.poses.kind), pings.poses.numbers
    begin = bounds(len(number), longest)
    first, of_sighting = number[begin[:-1]], stretch_of_ping(begin)[pings.ping]
    of_pose = np.searchsorted(first[1:], poses.numbers, side="right")
    for stretch in range(len(first)):
        inside = of_pose == stretch
        within, across = {poses.kind: inside}, {poses.kind: ~inside}
        measurements = [parts.any(k, within) & ~parts.any(k, across) for k in range(len(graph.factors))]
        held = {kind: np.full(len(stack), kind != poses.kind) for kind, stack in values.stacks.items()}
        part, touched = parts.take(measurements, held, values)
        mine = inside.copy()
        if poses.kind in touched.stacks:  # an opaque factor comes with all of its poses
            mine[poses.index(Keys(poses.kind, touched.stack(poses.kind).numbers))] = True
        own = poses.only(mine)
        start = Values.of([own, *without(touched, Kind(poses.kind)).stacks.values()])
        part.fix(_first_poses(part, start, own))
        rows = np.flatnonzero(of_sighting == stretch)
        sightings = pings.sightings[rows]
        assert isinstance(sightings, Sighting)
        yield rows, Pings.of(sightings, start, pings.kind, 2 * pings.limit or None), part, start


def _first_poses(graph: FactorGraph, values: Values, poses: Stack) -> Keys:
    """The pose of lowest number in every component of a graph."""
    pattern = graph.pattern(values)
    rows = firsts(component_labels(pattern), by_number(pattern, poses.kind))
    return Keys(poses.kind, poses.numbers[rows - pattern.offsets[poses.kind]])
