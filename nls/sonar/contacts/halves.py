"""Halves of a long mission: pings that follow one another, and the measurements between their poses alone.

Dead reckoning drifts with the way. Within a half it has drifted less, and a target has fewer others beside it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from factors.keys import Keys, Kind
from factors.sighting import Sighting
from models.algebra import Index
from nls.gauge import by_number, component_labels
from nls.graph import FactorGraph
from nls.sonar.contacts.estimate import without
from nls.sonar.contacts.places import Pings
from nls.sparse.components import firsts
from nls.starts.parts import Parts
from nls.values import Stack, Values

__all__ = ["halves"]


def halves(pings: Pings, graph: FactorGraph, values: Values) -> Iterator[tuple[Index, Pings, FactorGraph, Values]]:
    """The first and the second half of the pings, each with the poses up to the other.

    Parameters
    ----------
    pings : of a mission.
    graph, values : its other measurements, and their optimum.

    Yields
    ------
    sightings (k,) of a half by their place among all, the same as pings, and a graph with values. Held are its first
    pose, or the first of every component, and all that is no pose.
    """
    parts, poses, number = Parts(graph, values), values.stack(pings.poses.kind), pings.poses.numbers
    middle = number[len(number) // 2]
    for inside, of_half in ((poses.numbers < middle, number < middle), (poses.numbers >= middle, number >= middle)):
        within, across = {poses.kind: inside}, {poses.kind: ~inside}
        measurements = [parts.any(k, within) & ~parts.any(k, across) for k in range(len(graph.factors))]
        held = {kind: np.full(len(stack), kind != poses.kind) for kind, stack in values.stacks.items()}
        part, touched = parts.take(measurements, held, values)
        mine = inside.copy()
        if poses.kind in touched.stacks:  # an opaque factor comes with all of its poses
            mine[poses.index(Keys(poses.kind, touched.stack(poses.kind).numbers))] = True
        own = Stack(poses.kind, poses.manifold, poses.X[mine], poses.numbers[mine])
        start = Values.of([own, *without(touched, Kind(poses.kind)).stacks.values()])
        part.fix(_first_poses(part, start, own))
        rows = np.flatnonzero(of_half[pings.ping])
        sightings = pings.sightings[rows]
        assert isinstance(sightings, Sighting)
        yield rows, Pings.of(sightings, start, pings.kind, 2 * pings.limit or None), part, start


def _first_poses(graph: FactorGraph, values: Values, poses: Stack) -> Keys:
    """The pose of lowest number in every component of a graph."""
    pattern = graph.pattern(values)
    rows = firsts(component_labels(pattern), by_number(pattern, poses.kind))
    return Keys(poses.kind, poses.numbers[rows - pattern.offsets[poses.kind]])
