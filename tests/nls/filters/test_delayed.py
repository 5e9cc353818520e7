"""Landmarks that no single sighting locates: the EKF waits for more, and then is what the graph is."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import nls
import sim
from factors import Bearing, BearingRange, Between, Diagonal, Factor, Isotropic, Prior, Projection, Range, RangeAzimuth
from models import SE2, SE3, R, euler
from models.algebra import Array
from models.errors import GraphError
from models.sensors import Camera, direction, distance, point_in_frame, range_azimuth
from nls import FactorGraph, Values, kinds
from nls.filters.base import steps
from nls.filters.consistency import nees_bounds
from nls.filters.delayed import COPIES
from nls.filters.ekf import EKF
from tests.nls.filters.test_ekf import agrees
from tests.sim.scenes import thinned

x, l = kinds("x", "l")
Scene = tuple[FactorGraph, Values]
SENSORS: dict[str, tuple[Callable[..., Factor], Callable[..., Any], list[float]]] = {
    "contact": (RangeAzimuth, range_azimuth, [0.01, 0.005]),
    "range": (Range, distance, [0.02]),
    "bearing": (Bearing, direction, [0.005, 0.005]),
}


def seen_by(world: sim.LandmarkWorld, sensor: str) -> FactorGraph:
    """A subsea scene with its sightings cut to ranges or bearings; mixed: one of either in turn, later both."""
    both = world.sightings
    assert isinstance(both, BearingRange)
    step = both.keys[0].numbers
    ranges = Range(*both.keys, both.z[:, 1], Isotropic(0.2))
    bearings = Bearing(*both.keys, both.z[:, 0], Isotropic(np.radians(0.2)))
    mixed = [ranges[step % 3 == 0], bearings[step % 3 == 1], both[(step % 3 == 2) & (step > 12)]]
    sightings = {"range": [ranges], "bearing": [bearings], "mixed": mixed}[sensor]
    return FactorGraph([world.first, world.odometry, *sightings])


def floor(seed: int, sensor: str, noise_scale: float = 1.0, n: int = 60, m: int = 6) -> Scene:
    """A vehicle circles above a floor and heaves; a sensor pitched down sees points within its aperture."""
    sight, sense, sigma = SENSORS[sensor]
    rng, turn = np.random.default_rng(seed), 3 * np.pi * np.arange(n) / n
    roll, pitch, heave = 0.03 * np.sin(turn * 3), 0.03 * np.cos(turn * 2), 1 + 0.5 * np.sin(0.35 * np.arange(n))
    X = euler.to_se3(np.stack([roll, pitch, turn + np.pi, 4 * np.cos(turn), 4 * np.sin(turn), heave], axis=1))
    L = np.column_stack([rng.uniform(-2, 2, (m, 2)), rng.uniform(2, 3.5, m)])
    offset, drift = euler.to_se3([0, -0.4, 0, 0.3, 0, 0.1]), np.array([0.01, 0.01, 0.01, 0.002, 0.002, 0.004])
    i, k = np.divmod(np.arange(n * m), m)
    p = point_in_frame(SE3, SE3.compose(X[i], offset), L[k])[0]
    seen = (np.abs(np.arctan2(p[:, 1], p[:, 0])) < 0.5) & (np.abs(np.arctan2(p[:, 2], p[:, 0])) < 0.3)
    z = sense(p[seen])[0] + noise_scale * rng.normal(size=(seen.sum(), len(sigma))) * sigma
    step = SE3.retract(SE3.between(X[:-1], X[1:]), noise_scale * rng.normal(size=(n - 1, 6)) * drift)
    walk = Between(x[0 : n - 1], x[1:n], step, Diagonal(drift))
    sightings = sight(x[i[seen]], l[k[seen]], z, Diagonal(sigma), offset)
    return FactorGraph([Prior(x[0], X[:1], Isotropic(1e-3)), walk, sightings]), Values({x: (SE3, X), l: (R(3), L)})


def straight(n: int, target: Array, turns: bool = False) -> Scene:
    """Ranges of one landmark along a straight line, 1 m a step; the last fifth of it to the side where it turns."""
    step = np.tile([1.0, 0.0, 0.0], (n - 1, 1))
    if turns:
        step[4 * n // 5, 2] = np.pi / 2
    X = sim.chain(SE2, np.zeros(3), step)
    walk = Between(x[0 : n - 1], x[1:n], step, Diagonal([0.02, 0.02, 0.005]))
    ranges = Range(x[0:n], l[0], np.linalg.norm(X[:, :2] - target, axis=1), Isotropic(0.1))
    graph = FactorGraph([Prior(x[0], [0, 0, 0], Isotropic(1e-3)), walk, ranges])
    return graph, Values({x: (SE2, X), l: (R(2), target)})


@pytest.mark.parametrize("sensor", ["range", "bearing", "mixed", *(f"{name} in space" for name in SENSORS)])
def test_it_is_the_graph_where_noise_is_small(sensor: str) -> None:
    if "space" in sensor:
        graph, start = floor(0, sensor.split()[0], noise_scale=1e-4)
    else:
        world = sim.subsea(np.random.default_rng(0), laps=1, known_start=True, noise_scale=1e-4)
        graph, start = seen_by(world, sensor), world.start
    ekf = EKF("delayed")
    track = ekf.run(graph, start)
    assert sorted(track.landmarks.numbers.tolist()) == [0, 1, 2, 3, 4, 5]
    assert (len(ekf.waiting), len(ekf.state.copies)) == (0, 0)
    assert ekf.given_up == 0 or "space" in sensor
    agrees(track, graph, start, rtol=0.01, relative=0.01)


@pytest.mark.parametrize("sensor", ["range", "bearing"])
def test_it_is_as_good_as_it_says_and_ends_where_the_graph_does(sensor: str) -> None:
    nees, off = [], []
    for seed in range(4):
        world = thinned(sim.subsea(np.random.default_rng(seed), laps=1, known_start=True))
        graph, truth, ekf = seen_by(world, sensor), world.truth, EKF("delayed")
        track = ekf.run(graph, world.start)
        assert len(ekf.waiting) == 0
        nees.append(track.nees(truth)[-1])
        last, best = track.x[[len(track.x) - 1]], graph.optimize(truth).values
        e = track.manifold.position(np.stack([track.X[-1], best[last][0], truth[last][0]]))
        off.append(np.linalg.norm(e[:2] - e[2], axis=1))
    assert np.mean(nees) < nees_bounds(track.manifold.dim, 4)[1]
    filtered, optimal = np.sqrt(np.mean(np.square(off), axis=0))
    assert filtered < 1.3 * optimal


def test_a_mirror_waits_and_copies_are_bounded() -> None:
    """Ranges along a straight line say nothing of the side."""
    graph, values = straight(60, np.array([30.0, 20.0]))
    ekf = EKF("delayed")
    track = ekf.run(graph, values)
    assert (len(track.landmarks), ekf.waiting) == (0, l[[0]])
    assert (len(ekf.state.copies), ekf.given_up) == (COPIES, 60 - COPIES)
    np.testing.assert_allclose(ekf.joint.matrix[:2, :2], ekf.pose[1][:2, :2], atol=1e-12)  # the heading is 0
    assert ekf.joint.matrix.shape == (3, 3)
    kept = np.sort(ekf.state.copies[:, 0])
    assert kept[0] < 1 < 58 < kept[-1]  # thinned, and not cut off
    assert np.diff(kept).max() < 4
    blind = EKF().run(FactorGraph(graph.factors[:2]), values)
    np.testing.assert_array_equal(track.P[-1], blind.P[-1])


def test_a_wrong_sighting_among_those_that_wait_locates_nothing() -> None:
    graph, values = straight(30, np.array([12.0, 20.0]), turns=True)
    ranges = graph.factors[2]
    wrong = ranges.z + 5.0 * (np.arange(30) == 10)
    ekf = EKF("delayed")
    ekf.run(FactorGraph([*graph.factors[:2], Range(*ranges.keys, wrong, ranges.noise)]), values)
    assert ekf.waiting == l[[0]]


@pytest.mark.parametrize("scene", [sim.subsea, sim.lines])
def test_where_every_sighting_locates_it_is_the_correlated_filter_to_the_bit(scene: Callable[..., Any]) -> None:
    world = scene(np.random.default_rng(2), laps=1)
    plain, delayed = (EKF(how).run(world.graph, world.start) for how in ("correlated", "delayed"))  # type: ignore[arg-type]
    np.testing.assert_array_equal(plain.X, delayed.X)
    np.testing.assert_array_equal(plain.P, delayed.P)
    np.testing.assert_array_equal(plain.P_landmarks, delayed.P_landmarks)


def test_a_prior_that_comes_late_lets_what_waits_be_used() -> None:
    graph, values = straight(8, np.array([4.0, 3.0]))
    chart = Prior(l[0], [4.001, 3.001], Isotropic(0.05))
    ekf = EKF("delayed")
    for step in steps(graph, values):
        if step.pose == x[5]:
            assert (ekf.waiting, len(ekf.state.copies)) == (l[[0]], 5)
            step.observations.insert(0, chart)
        ekf.start(step, values) if step.pose == x[0] else ekf.step(step)
    assert (len(ekf.waiting), len(ekf.state.copies)) == (0, 0)
    whole = FactorGraph([*graph.factors, chart])
    P = nls.Marginals(whole, whole.optimize(values).values).covariance(x[7], frame="body")
    np.testing.assert_allclose(ekf.pose[1], P, rtol=1e-3, atol=1e-3 * np.abs(P).max())


def test_the_refusal_names_the_cure_and_the_cure_works() -> None:
    graph, values = straight(30, np.array([12.0, 20.0]), turns=True)
    with pytest.raises(GraphError, match=r"Range\(x0, l0\) is the first of l0") as refused:
        EKF().run(graph, values)
    cure = re.search(r"EKF\(landmarks='delayed'\)", str(refused.value))
    assert cure is not None
    track = eval(cure[0], {"EKF": EKF}).run(graph, values)
    assert track.landmarks == l[[0]]
    with pytest.raises(GraphError, match=r"is the first of l0.*or a Prior of l0$"):  # no cure that the options refuse
        EKF(first_estimates=True).run(graph, values)


def test_a_camera_does_not_wait() -> None:
    pixels: Factor = Projection(x[0], l[0], [[10.0, 0.0]], Isotropic(1.0), Camera(focal=(600.0, 600.0)))
    graph = FactorGraph([Prior(x[0], SE3.identity(), Isotropic(0.1)), pixels])
    values = Values({x: (SE3, SE3.identity()), l: (R(3), [0.0, 0.0, 5.0])})
    for how in ("correlated", "delayed"):
        with pytest.raises(GraphError, match=r"Projection\(x0, l0\) is the first of l0.*or a Prior of l0$"):
            EKF(how).run(graph, values)  # type: ignore[arg-type]
