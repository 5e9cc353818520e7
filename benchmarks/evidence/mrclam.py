"""MRCLAM dataset 6 as a graph: one robot, its commands integrated between sightings, landmarks that are known by name.

The first pose is the true one; nothing else of the truth is used, but for the sigmas, which are those found in
the logs of these robots: see the constants.
"""

from __future__ import annotations

import numpy as np
from logs import Mrclam

from factors import BearingRange, Between, Covariance, Diagonal, Prior
from models import SE2, R
from models.dead_reckoning import integrate_plane
from nls import FactorGraph, Values, kinds
from nls.starts import locate_points
from sim import LandmarkWorld
from sim.landmark_world import KNOWN_START

x, l = kinds("x", "l")
# m/s, m/s, rad/s, each per sqrt(Hz): legs of 1 to 4 s are off by 0.011-0.015, 0.002-0.008 and 0.03-0.06 times sqrt(s)
DENSITY = np.diag([0.02, 0.005, 0.05])
BEARING, RANGE = 0.01, 0.04  # rad, and of the range: 0.08 m at 1.5 m, 0.25 m at 6 m
TOGETHER = 0.005  # s; sightings less than this after the first of a pose are of that pose: below 0.5 mm and 0.2 deg


def mrclam(log: Mrclam, name: str, seconds: float = np.inf) -> LandmarkWorld:
    """The graph of a robot, or of its first seconds; landmarks have their numbers as subjects.

    A pose is where the odometry begins, and at every time at which a landmark was seen.
    """
    seen = np.isin(log.subject, log.landmarks) & (log.t_seen > log.t[0]) & (log.t_seen < log.t[0] + seconds)
    t_seen, z, subject = log.t_seen[seen], log.z[seen], log.subject[seen]
    begins = np.concatenate([[True], np.diff(t_seen) > TOGETHER])
    t = np.concatenate([log.t[:1], t_seen[begins]])
    pose = np.cumsum(begins)

    twist = np.column_stack([log.u[:, 0], np.zeros(len(log.t)), log.u[:, 1]])
    legs = integrate_plane(log.t, twist, DENSITY, boundaries=t)
    truth, n = log.true_poses(t), len(t)
    graph = FactorGraph(
        [
            Prior(x[0], truth[0], Diagonal(KNOWN_START)),
            Between(x[: n - 1], x[1:n], legs.z, Covariance(legs.Sigma)),
            BearingRange(x[pose], l[subject], z, Diagonal(bearing=BEARING, range=RANGE * z[:, 1])),
        ]
    )
    found = np.isin(log.landmarks, subject)
    places, numbers = log.places[found], log.landmarks[found]
    start = Values({x: (SE2, legs.track(truth[0])), l: (R(2), np.zeros_like(places), numbers)})
    answer = Values({x: (SE2, truth), l: (R(2), places, numbers)})
    return LandmarkWorld(name, answer, graph, locate_points(graph, start), 0, "correlated", None, "")
