"""Dead reckoning with drifts as variables: its uncertainty in closed form, its optimum, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factors import Isotropic, Prior
from models import SE2
from models.errors import GraphError, OptionError
from nls import FactorGraph, Marginals, kinds
from nls.missions.scans import Drift, dead_reckoning
from tests.combinations import for_all
from tests.factors.evaluated import Array, refused, same

x, d, m = kinds("x", "d", "m")
DRIFT = Drift(mean=0.2, stretch=0.15, length=10.0, step=0.1, yaw=1e-5, heading=None)


def straight(length: float, step: float = 1.0) -> Array:
    s = np.arange(0.0, length + step / 2, step)
    return np.column_stack([s, 0 * s, 0 * s])


def sigmas(drift: Drift, way: Array) -> Array:
    """(n, 2) of x and y of the poses after the first."""
    graph, values = dead_reckoning(way, drift)
    C = Marginals(graph, values).all(x, frame="world")[1:]
    return np.sqrt(C[:, [0, 1], [0, 1]])


@for_all(step=[0.5, 1.0, 2.5])
def test_the_sigma_of_a_position_grows_with_the_way(step: float) -> None:
    r"""sigma^2 = mean^2 s^2 + stretch^2 (sum of squares of the ways in each stretch) + step^2 s."""
    s = np.arange(step, 100 + step / 2, step)
    whole, rest = np.floor(s / 10 + 1e-9), s - 10 * np.floor(s / 10 + 1e-9)
    expected = np.sqrt(0.2**2 * s**2 + 0.15**2 * (whole * 10**2 + rest**2) + 0.1**2 * s)
    same(sigmas(DRIFT, straight(100, step)), np.column_stack([expected, expected]), rtol=1e-3)


def test_a_wrong_compass_swings_the_way() -> None:
    """Yaws of a random walk: to the side yaw^2 s^3 / 3; a compass holds it at its own sigma and less."""
    drift = Drift(mean=1e-3, stretch=1e-3, step=1e-3, yaw=0.02, heading=None)
    side = sigmas(drift, straight(100))
    k = np.arange(1, 101)
    same(side[:, 1], 0.02 * np.sqrt((k - 1) * k * (2 * k - 1) / 6), rtol=0.02, atol=0.02)
    with_compass = sigmas(replace(drift, heading=0.05), straight(100))
    assert with_compass[-1, 1] < 0.2 * side[-1, 1]


def test_a_return_to_the_start_cancels_the_mean() -> None:
    """There and back with the same heading: the body moves backwards, and the drift is for every meter of the way."""
    there = straight(50)
    ahead_and_back = np.vstack([there, there[-2::-1]])
    turned = np.vstack([there, there[-2::-1] + np.array([0, 0, np.pi])])
    drift = replace(DRIFT, stretch=1e-3, step=1e-3)
    same(sigmas(drift, ahead_and_back)[-1], 0.2 * 100, rtol=1e-3)
    assert sigmas(drift, turned)[-1].max() < 0.5


def test_the_reckoned_track_is_its_own_optimum_and_fixes_determine_the_drift() -> None:
    rng = np.random.default_rng(0)
    yaw = np.cumsum(rng.normal(0, 0.3, 60))
    truth = np.column_stack([np.vstack([[0, 0], np.cumsum(np.column_stack([np.cos(yaw), np.sin(yaw)]), 0)[:-1]]), yaw])
    step = SE2.between(truth[:-1], truth[1:])
    off = step + np.array([0.15, -0.1, 0.0])
    reckoned = truth[:1]
    for one in off:
        reckoned = np.vstack([reckoned, SE2.compose(reckoned[-1:], one[None])])
    graph, values = dead_reckoning(reckoned)
    assert graph.chi2(values) < 1e-18
    held = Prior(x[[20, 40, 59]], truth[[20, 40, 59]], Isotropic(0.05))
    result = FactorGraph([*graph.factors, held], graph.fixed).optimize(values)
    length = np.linalg.norm(off[:, :2], axis=1).mean()
    same(result.values[m[0]], np.array([0.15, -0.1]) / length, atol=0.05)
    assert np.abs(result.values[x] - truth)[:, :2].max() < 1.0
    assert np.abs(reckoned - truth)[:, :2].max() > 4.0


def test_a_vehicle_that_stands_or_turns_on_the_spot() -> None:
    spot = np.zeros((5, 3))
    spot[:, 2] = [0, 0.5, 1.0, 1.0, 1.5]
    graph, values = dead_reckoning(spot)
    assert len(values[d]) == 1
    C = Marginals(graph, values).all(x, frame="world")[1:]
    same(np.sqrt(C[:, 0, 0]), 0.1 * np.sqrt(0.3 * np.arange(1, 5)), rtol=1e-6)


def test_stretches_are_numbered_without_gaps() -> None:
    """A step of 35 m is one of its stretch; the next stretch is the next drift."""
    way = np.array([[0.0, 0, 0], [35, 0, 0], [36, 0, 0], [37, 0, 0], [80, 0, 0]])
    _, values = dead_reckoning(way)
    assert len(values[d]) == 2
    assert values[m].shape == (1, 2)


def test_what_does_not_fit() -> None:
    for poses in (np.zeros((1, 3)), np.zeros((4, 2)), np.zeros(3), [[0, 0, 0], [1, np.nan, 0]]):
        refused(lambda p=poses: dead_reckoning(p), GraphError, r"dead.reckoning: poses of shape .*; expected \(n, 3\)")
    for name in ("mean", "stretch", "length", "step", "yaw", "heading"):
        for value in (0.0, -0.1, np.nan):
            refused(lambda n=name, v=value: Drift(**{n: v}), OptionError, name)
    assert Drift(heading=None).heading is None
