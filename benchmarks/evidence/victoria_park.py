"""Victoria Park as a graph: odometry of a truck between the scans of its laser, trees without names, GPS beside it.

The sigmas and the direction of the laser are found from scans 1 s apart, matched tree by tree, beside the odometry; GPS
is used for nothing but the comparison.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from logs import VictoriaPark
from scipy.spatial import cKDTree

from factors import BearingRange, Between, Covariance, Diagonal, Prior
from models import SE2, R
from models.algebra import Array, Index, Mask
from models.dead_reckoning import integrate_plane
from models.sensors import point_from_direction_range
from models.vehicles import ackermann
from nls import FactorGraph, Values, kinds
from nls.filters.association import identified
from nls.metrics import TrajectoryError, ate
from nls.starts import locate_points
from sim.landmark_world import KNOWN_START

x, l = kinds("x", "l")
# of speed and steering, m/s and rad, and of slip ahead, across and in yaw, m/s and rad/s, all per sqrt(Hz): over 1.1 s
# scans and odometry differ by 0.04 m ahead, 0.07 m across and 0.005 rad
SPEED, STEERING, SLIP = 0.05, 0.006, (0.02, 0.04, 0.002)
LASER = (0.0, 0.0, -0.019)  # rad; straight on, trees pass 0.067 m to the left of where they should every 3.5 m
BEARING, RANGE = np.radians(0.5), 0.25  # rad, m; more than the noise: a tree is not round, and seen from all sides
STANDING = 0.02  # m; a scan is left out while the wheel has not rolled over a further one of these
AROUND, NEAR, OFTEN = 5, 1.0, 3  # scans before and after, m, sightings there: what is seen less often is no tree


@dataclass(frozen=True)
class Park:
    """A graph whose sightings name nobody: as many trees as sightings.

    Attributes
    ----------
    log : what it is of.
    t : (n,) times of the poses, s.
    graph : prior of the first pose, odometry, sightings.
    start : dead reckoning.
    scans, seen : scans in the time looked at, and sightings in those that were kept.
    """

    log: VictoriaPark
    t: Array
    graph: FactorGraph
    start: Values
    scans: int
    seen: int

    @property
    def sightings(self) -> BearingRange:
        factor = self.graph.factors[2]
        assert isinstance(factor, BearingRange)
        return factor

    def named(self, found: npt.ArrayLike, X: Array) -> tuple[FactorGraph, Values]:
        """The graph with trees by number for each sighting (-1: left out), and start values from poses X (n, 3)."""
        sightings = identified(self.sightings, found, l)
        graph = FactorGraph([*self.graph.factors[:2], sightings])
        trees = np.unique(sightings.keys[1].numbers)
        values = Values({x: (SE2, X), l: (R(2), np.zeros((len(trees), 2)), trees)})
        return graph, locate_points(graph, values)

    def again(self, values: Values) -> Index:
        """The nearest tree for each sighting where a solution has both, -1 beyond 2 m or for trees seen only once."""
        S = self.sightings.sensor_pose(SE2, values[self.sightings.keys[0]])
        trees = values.stack("l")
        at = cKDTree(trees.X).query(self.sightings.locate(SE2, S, self.sightings.z), distance_upper_bound=2.0)[1]
        found = np.append(trees.numbers, -1)[at]
        once = np.bincount(found[found >= 0], minlength=trees.numbers.max() + 1) < 2
        return np.where(once[found], -1, found)

    def gps_error(self, X: Array) -> TrajectoryError:
        """Distances of GPS from poses X (n, 3), rigidly aligned, at the times of GPS within those of the poses."""
        inside = (self.log.t_gps >= self.t[0]) & (self.log.t_gps <= self.t[-1])
        P = np.zeros((2, int(inside.sum()), 3))
        for k in range(2):
            P[0, :, k] = np.interp(self.log.t_gps[inside], self.t, X[:, k])
        P[1, :, :2] = self.log.gps[inside]
        return ate(P[0], P[1], "rigid")


def victoria_park(log: VictoriaPark, seconds: float = np.inf) -> Park:
    """The graph of the run, or of its first seconds: a pose at every scan, but for those taken while standing."""
    twist, F_u = ackermann(log.u, log.wheelbase, log.encoder, log.laser)
    density = np.concatenate([F_u * [SPEED, STEERING], np.tile(np.diag(SLIP), (len(twist), 1, 1))], axis=2)
    inside = np.flatnonzero((log.t_scan >= log.t[0]) & (log.t_scan <= min(log.t[-1], log.t[0] + seconds)))
    rolled = np.concatenate([[0.0], np.cumsum(np.abs(log.u[:-1, 0]) * np.diff(log.t))])
    further = np.diff(np.interp(log.t_scan[inside], log.t, rolled) // STANDING) > 0
    kept = inside[np.concatenate([[True], further])]
    t, n = log.t_scan[kept], len(kept)
    legs = integrate_plane(log.t, twist, density, boundaries=t)
    X = legs.track([0.0, 0.0, 0.0])

    seen = np.isin(log.scan, kept)
    pose, z = np.searchsorted(kept, log.scan[seen]), log.z[seen]
    tree = confirmed(pose, SE2.act(X[pose], point_from_direction_range(z)))
    pose, z = pose[tree], z[tree]
    graph = FactorGraph(
        [
            Prior(x[0], X[0], Diagonal(KNOWN_START)),
            Between(x[: n - 1], x[1:n], legs.z, Covariance(legs.Sigma)),
            BearingRange(x[pose], l[np.arange(len(z))], z, Diagonal(bearing=BEARING, range=RANGE), LASER),
        ]
    )
    start = Values({x: (SE2, X), l: (R(2), np.zeros((len(z), 2)))})
    return Park(log, t, graph, start, len(inside), int(seen.sum()))


def confirmed(scan: Index, P: Array) -> Mask:
    """Which sightings (n,) at P (n, 2) were also made near there in `OFTEN` of the `AROUND` scans before and after."""
    apart = 1e4 * scan[:, None]  # m, between one scan and the next: one search tree holds them all
    tree = cKDTree(np.hstack([P, apart]))
    around = [k for k in range(-AROUND, AROUND + 1) if k]
    near = [tree.query(np.hstack([P, apart + 1e4 * k]), distance_upper_bound=NEAR)[0] for k in around]
    return np.asarray(np.isfinite(near).sum(axis=0) >= OFTEN)
