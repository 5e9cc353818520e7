"""A world under the sea whose landmarks and poses are numbered from 0, both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import sim
from factors import BearingRange, Isotropic, Landmark
from models.sensors import point_from_direction_range
from nls import FactorGraph
from sim.landmark_world import LandmarkWorld


def charted() -> LandmarkWorld:
    """The world, its landmarks seen as points."""
    world = sim.subsea(np.random.default_rng(3), laps=1)
    (sightings,) = (f for f in world.graph.factors if isinstance(f, BearingRange))
    points = Landmark(*sightings.keys, point_from_direction_range(sightings.z), Isotropic(0.1))
    return replace(world, graph=FactorGraph([*(f for f in world.graph.factors if f is not sightings), points]))
