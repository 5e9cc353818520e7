"""Landmarks that may be mirrored: after motion in the plane of the sonar alone, and by a search of our own."""

from __future__ import annotations

import numpy as np

from factors import Diagonal, RangeAzimuth
from models import SE3, R
from models.algebra import Array, Mask
from models.sensors import spherical
from nls import FactorGraph, Values, kinds
from nls.missions import elevations
from nls.missions.sonar.elevation import mirrored
from tests.combinations import for_all

x, l = kinds("x", "l")
ELEVATIONS = np.radians([-6.0, -2.0, 0.05, 1.5, 5.0])
SIGMAS = 0.01, 0.005


def seen_from(steps: Array) -> tuple[FactorGraph, Values, Array]:
    """Points at these elevations, 4 m away, seen exactly from the origin and after steps (n, 3); and their places."""
    p = 4.0 * np.column_stack([np.cos(ELEVATIONS), 0 * ELEVATIONS, np.sin(ELEVATIONS)])
    views = np.vstack([np.zeros((1, 3)), steps])
    poses = np.column_stack([views, np.zeros((len(views), 3)), np.ones(len(views))])
    i, k = (grid.ravel() for grid in np.mgrid[: len(views), : len(p)])
    contacts = RangeAzimuth(x[i], l[k], spherical(p[k] - views[i])[0][:, :2], Diagonal(SIGMAS))
    return FactorGraph([contacts]), Values({x: (SE3, poses), l: (R(3), p)}), p


def doubtful(graph: FactorGraph, values: Values, p: Array) -> Mask:
    S = np.tile(SE3.identity(), (len(p), 1))
    return mirrored(graph, values, l[np.arange(len(p))], S, spherical(p)[0], np.full(len(p), np.radians(0.3)))


@for_all(heave=[0.0, 0.05, 1.0])
def test_against_chi2_on_a_fine_grid(heave: float) -> None:
    """Heave moves the other minimum away from the mirror image before it lifts it."""
    steps = np.array([[0.5, 0.0, heave], [0.0, 1.0, -heave]])
    graph, values, p = seen_from(steps)
    other = -np.sign(ELEVATIONS)[:, None] * np.linspace(0, np.radians(7), 4000)
    q = 4.0 * np.stack([np.cos(other), 0 * other, np.sin(other)], axis=-1)
    chi2 = np.zeros(other.shape)
    for step in steps:
        e = spherical((q - step).reshape(-1, 3))[0][:, :2].reshape(*other.shape, 2)
        chi2 += np.square((e - spherical(p - step)[0][:, None, :2]) / SIGMAS).sum(axis=-1)
    alike = chi2.min(axis=1) < 9
    assert doubtful(graph, values, p).tolist() == (alike & (np.arange(5) != 2)).tolist()  # one is near to its image
    assert alike.all() == (heave < 1)


def test_a_landmark_without_a_sigma_or_held_is_not_doubted() -> None:
    """Nor one near the plane of the sonar: its sigma reaches both places."""
    graph, values, _ = seen_from(np.array([[3.0, 0.0, 0.0], [3.0, 1.0, 0.0]]))
    graph.fix(x[[0, 1, 2]])
    assert elevations(graph, values, sigmas=True).mirrored[[0, 2, 4]].tolist() == [True, False, True]
    assert not elevations(graph, values).mirrored.any()
    graph.fix(l[0])
    assert elevations(graph, values, sigmas=True).mirrored[[0, 2, 4]].tolist() == [False, False, True]
