"""A world under the sea whose landmarks and poses are numbered from 0, both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import sim
from factors import BearingRange, Isotropic, Landmark
from models.sensors import point_from_direction_range
from nls import FactorGraph, Values


@dataclass
class Scene:
    """A graph with a start."""

    graph: FactorGraph
    start: Values


def subsea() -> Scene:
    """The world as it is, its landmarks seen by bearing and range."""
    world = sim.subsea(np.random.default_rng(3), laps=1)
    return Scene(world.graph, world.start)


def charted() -> Scene:
    """The world of `subsea`, its landmarks seen as points."""
    scene = subsea()
    graph = FactorGraph([f for f in scene.graph.factors if not isinstance(f, BearingRange)])
    (sightings,) = (f for f in scene.graph.factors if isinstance(f, BearingRange))
    graph.add(Landmark(*sightings.keys, point_from_direction_range(sightings.z), Isotropic(0.1)))
    return Scene(graph, scene.start)
