"""How far around a guess a match is searched."""

from __future__ import annotations

import numpy as np

from nls import FactorGraph, Marginals, kinds
from nls.missions.scans import Drift, dead_reckoning
from nls.missions.scans.candidates import LIMITS, half_widths
from tests.factors.evaluated import same
from tests.nls.missions.scans.rooms import drive, laps

(x,) = kinds("x")
TRUTH = laps()
ROOM = drive(TRUTH)


def test_windows_are_three_sigmas_of_the_relative_pose_within_their_limits() -> None:
    graph, values = dead_reckoning(ROOM.reckoned)
    middle = np.array([4, 8, 60, 100])
    a, b = np.array([0, 0, 0, 2]), np.array([1, 2, 3, 3])
    pair = x[middle[a]], x[middle[b]]
    width = half_widths(Marginals(graph, values, pairs=[pair]).relative(*pair))
    assert width.shape == (4, 2)
    for k in range(2):
        assert (width[:, k] >= LIMITS[k][0]).all()
        assert (width[:, k] <= LIMITS[k][1]).all()
    assert width[0, 0] < width[1, 0] < width[2, 0]


def test_a_window_is_that_of_the_later_pose_where_the_earlier_is_fixed() -> None:
    """Steps alone: which pose is fixed does not matter to the relative pose, and one that is fixed has no errors."""
    drift = Drift(mean=0.1, stretch=0.1, yaw=0.008, heading=None)
    graph, values = dead_reckoning(TRUTH[:51], drift)
    pair = x[[20]], x[[50]]
    ((position, yaw),) = half_widths(Marginals(graph, values, pairs=[pair]).relative(*pair))
    C = Marginals(FactorGraph(graph.factors, [x[20]]), values).covariance(x[50], frame="body")
    same(position, 3 * np.sqrt(np.linalg.eigvalsh(C[:2, :2])[-1]), rtol=1e-6)
    same(yaw, 3 * np.sqrt(C[2, 2]), rtol=1e-6)
    assert LIMITS[0][0] < position < LIMITS[0][1]
    assert LIMITS[1][0] < yaw < LIMITS[1][1]
