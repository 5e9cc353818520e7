"""Small scenes whose sightings have lost their names, and what is known without these."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

import sim
from factors import XYH, BearingRange, Between, Diagonal, Isotropic, Prior
from factors.sighting import Sighting
from models import SE2
from models.algebra import Index
from nls import FactorGraph, Values, kinds
from sim.mission import Mission

__all__ = ["Scene", "drifted", "floor", "in_plane", "poor_ranges"]

x, l = kinds("x", "l")


@dataclass(frozen=True)
class Scene:
    """Measurements without contacts, poses by them, contacts without names, and the answer.

    Attributes
    ----------
    graph, values : what is known without the contacts.
    sightings : all of landmark 0.
    aperture : of the sonar, rad; None where a sighting locates its target.
    true : (n,) landmark of each sighting, -1 of a false one.
    truth : poses and landmarks.
    """

    graph: FactorGraph
    values: Values
    sightings: Sighting
    aperture: float | None
    true: Index
    truth: Values


def poses_of(values: Values) -> Values:
    """The poses without the landmarks."""
    return Values.of([values.stack("x")])


def unnamed(sightings: Sighting) -> Sighting:
    """The sightings, all of landmark 0."""
    pose, nothing = sightings.keys[0], np.zeros(len(sightings), dtype=int)
    return type(sightings)(pose, l[nothing], sightings.z, sightings.noise, sightings.offset)


def scene_of(mission: Mission, graph: FactorGraph) -> Scene:
    true = np.where(mission.wrong, -1, mission.contacts.keys[1].numbers)
    start, seen = poses_of(mission.start), unnamed(mission.contacts)
    return Scene(graph, start, seen, mission.sonar.aperture, true, mission.truth)


@cache
def floor(seed: int = 1, outliers: float = 0.0, noise_scale: float = 1.0) -> Scene:
    """One leg over the sea floor, there and back."""
    rng = np.random.default_rng(seed)
    mission = sim.hauv_floor(rng, legs=1, per_leg=12, outliers=outliers, noise_scale=noise_scale)
    return scene_of(mission, FactorGraph(mission.graph.factors[:4]))


@cache
def drifted() -> Scene:
    """Two legs there and back, by a vehicle that hardly knows its heading."""
    mission = sim.hauv_floor(np.random.default_rng(3), legs=2, per_leg=16)
    odometry, *others = mission.graph.factors[:4]
    assert isinstance(odometry, XYH)
    z = odometry.z + 0.02 * np.random.default_rng(0).normal(size=len(odometry))[:, None] * [0, 0, 1]
    return scene_of(mission, FactorGraph([XYH(*odometry.keys, z, Diagonal([0.01, 0.01, 0.02])), *others]))


@cache
def in_plane() -> Scene:
    """A lap of an underwater vehicle in the plane: bearings and ranges of six landmarks."""
    world = sim.subsea(np.random.default_rng(1), laps=1, known_start=True)
    sightings = world.graph.factors[2]
    assert isinstance(sightings, BearingRange)
    known, start = FactorGraph(world.graph.factors[:2]), poses_of(world.start)
    return Scene(known, start, unnamed(sightings), None, sightings.keys[1].numbers, world.truth)


@cache
def poor_ranges() -> Scene:
    """A straight way by good odometry, past targets whose range is measured to 0.3 m."""
    rng, n = np.random.default_rng(0), 20
    X = np.column_stack([np.arange(n), np.zeros((n, 2))])
    sigmas = np.array([1e-3, 1e-3, 1e-4])
    step = SE2.between(X[:-1], X[1:]) + rng.normal(size=(n - 1, 3)) * sigmas
    steps = Between(x[np.arange(n - 1)], x[np.arange(1, n)], step, Diagonal(sigmas))
    points = rng.uniform([-5, -15], [25, 15], (12, 2))
    i, k = np.nonzero(np.linalg.norm(X[:, None, :2] - points, axis=2) < 12)
    d = points[k] - X[i, :2]
    z = np.column_stack([np.arctan2(d[:, 1], d[:, 0]), np.hypot(*d.T)]) + rng.normal(size=(len(i), 2)) * [0.003, 0.3]
    sightings = BearingRange(x[i], l[np.zeros(len(i), dtype=int)], z, Diagonal(bearing=0.003, range=0.3))
    values = Values({x: (SE2, X)})
    return Scene(FactorGraph([Prior(x[0], X[0], Isotropic(1e-3)), steps]), values, sightings, None, k, values)
