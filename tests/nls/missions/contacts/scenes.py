"""Small scenes whose sightings have lost their names, and what is known without these."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

import sim
from factors import BearingRange, Between, Diagonal, Isotropic, Prior
from factors.sighting import Sighting
from models import SE2
from models.algebra import Array, Index
from nls import FactorGraph, Marginals, Values, kinds
from nls.analysis.chi_squared import chi2_gate
from nls.missions.contacts import gates
from nls.missions.contacts.anchors import Anchored, Motions
from nls.missions.contacts.estimate import Estimate
from nls.missions.contacts.places import Pings

__all__ = [
    "GATE",
    "Scene",
    "covariances_of_poses",
    "estimate_of",
    "floor",
    "in_plane",
    "landmark_distances",
    "poor_ranges",
    "poses_of",
    "sighting_distances",
    "true_pairs",
    "unnamed",
]

GATE = chi2_gate(2, 0.999)
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

    @property
    def pings(self) -> Pings:
        """The sightings, ping by ping."""
        return Pings.of(self.sightings, self.values, l, self.aperture)

    def at_the_truth(self) -> Values:
        """The true poses alone."""
        return poses_of(self.truth)

    def truth_of(self, landmarks: Index) -> Values:
        """The true poses, and some of the true landmarks."""
        values, numbers = self.at_the_truth(), np.unique(landmarks)
        values.add(l, self.truth.stack("l").manifold, self.truth[l[numbers]], numbers)
        return values

    def truth_by(self, tracks: Index) -> Values:
        """The true poses, and true landmarks by the names of their tracks, each the number of its first sighting."""
        values, numbers = self.at_the_truth(), np.unique(tracks)
        values.add(l, self.truth.stack("l").manifold, self.truth[l[self.true[numbers]]], numbers)
        return values


def poses_of(values: Values) -> Values:
    """The poses without the landmarks."""
    return Values.of([values.stack("x")])


def unnamed(sightings: Sighting) -> Sighting:
    """The same sightings, all of landmark 0."""
    pose, nothing = sightings.keys[0], np.zeros(len(sightings), dtype=int)
    return type(sightings)(pose, l[nothing], sightings.z, sightings.noise, sightings.offset)


@cache
def floor(seed: int = 1, outliers: float = 0.0, noise_scale: float = 1.0) -> Scene:
    """One leg over the sea floor, there and back."""
    rng = np.random.default_rng(seed)
    mission = sim.hauv_floor(rng, legs=1, per_leg=12, outliers=outliers, noise_scale=noise_scale)
    true = np.where(mission.wrong, -1, mission.contacts.keys[1].numbers)
    known, start = FactorGraph(mission.graph.factors[:4]), poses_of(mission.start)
    return Scene(known, start, unnamed(mission.contacts), mission.sonar.aperture, true, mission.truth)


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


def estimate_of(tracks: Index, graph: FactorGraph, values: Values) -> Estimate:
    """An estimate whose residuals nobody asks for."""
    return Estimate(tracks, graph, values, np.zeros(len(tracks)), np.zeros(len(tracks), dtype=bool), 1.0)


def landmark_distances(pings: Pings, estimate: Estimate, d: Index, landmarks: Index) -> tuple[Array, Array]:
    """As in `nls.missions.contacts.gates`, with covariances of their own."""
    return gates.landmark_distances(pings, estimate, Anchored(pings, estimate, (landmarks, d)), d, landmarks)


def sighting_distances(scene: Scene, c: Index, d: Index) -> tuple[Array, Array]:
    """As in `nls.missions.contacts.gates`, by dead reckoning."""
    pings = scene.pings
    i, j = pings.poses[pings.ping[c]], pings.poses[pings.ping[d]]
    motions = Motions(Marginals(scene.graph, scene.values, pairs=[(i, j)]).relative(i, j), np.arange(len(c)))
    return gates.sighting_distances(pings, scene.values, c, d, motions)


def covariances_of_poses(pings: Pings, estimate: Estimate) -> Array:
    """Covariances (m, d, d) of the poses of an estimate."""
    return pings.covariances_of_poses(Marginals(estimate.graph, estimate.values))


def true_pairs(scene: Scene) -> tuple[Index, Index]:
    """All pairs of sightings of one landmark, the first from the earlier ping."""
    ping, true = scene.pings.ping, scene.true
    return np.nonzero((true[:, None] == true) & (true >= 0) & (ping[:, None] < ping))
