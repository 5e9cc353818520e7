"""Calibrations that are off: named with their size, together where nothing tells them apart, and no other mistake."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from factors import XYH, Between, Diagonal, Factor, Isotropic, Prior
from factors.replaced import replaced
from factors.rescaled import rescaled
from factors.sighting import Sighting
from models import SE2, SE3, euler
from models.algebra import Array
from nls import FactorGraph, Values, kinds
from nls.analysis.calibrations import Calibration, calibrations
from tests.combinations import for_all
from tests.nls.misreadings import clean, misread, optimum, wrong_closure

x, l = kinds("x", "l")
PLAIN = sim.hauv_floor(np.random.default_rng(4), legs=2, per_leg=12)


def moved(step: Array) -> FactorGraph:
    """The mission with its sonar a step (6,) along the axes of the vehicle from where it was."""
    turn = euler.to_se3(np.append(step[3:], [0, 0, 0]))
    wrong = np.append(PLAIN.offset[:3] + step[:3], SE3.compose(turn, PLAIN.offset)[3:])
    return FactorGraph([f.mounted(wrong) if isinstance(f, Sighting) else f for f in PLAIN.graph.factors])


@for_all(case=[("x", 0.5), ("pitch", 0.1)])
def test_the_mounting_of_a_sonar(case: tuple[str, float]) -> None:
    name, off = case
    graph = moved(off * (np.array(SE3.components) == name))
    (wrong,) = calibrations(graph, optimum(graph, PLAIN.start))
    assert (wrong.kind, wrong.quantity, wrong.components) == ("RangeAzimuth", "mounting", (name,))
    assert wrong.correction[0] == pytest.approx(-off, abs=4 * wrong.sigma[0])
    assert wrong.sigma[0] < 0.2 * abs(wrong.correction[0])


def odometry_off(graph: FactorGraph, values: Values, kind: type) -> tuple[Calibration, ...]:
    """Steps 20 % too long."""
    long = [replaced(f, z=f.z * [1.2, 1.2, 1]) if isinstance(f, kind) else f for f in graph.factors]
    other = FactorGraph(long, graph.fixed)
    return calibrations(other, optimum(other, values))


def test_the_scale_of_odometry() -> None:
    """Of steps in the plane, and of steps in the horizontal; closures of the same type stay as they are."""
    graph, start, _ = clean("subsea", 0)
    for wrong in (odometry_off(graph, start, Between), odometry_off(PLAIN.graph, PLAIN.start, XYH)):
        assert wrong[0].quantity == "odometry"
        assert wrong[0].components == ("scale",)
        assert wrong[0].correction[0] == pytest.approx(1.2, abs=0.02)


def turned() -> tuple[FactorGraph, Values]:
    """A vehicle whose sensor is turned by 0.1 rad, and the optimum."""
    graph, start, _ = clean("subsea", 0)
    first, odometry, sightings = graph.factors
    other = FactorGraph([first, odometry, replaced(sightings, z=sightings.z + np.array([0.1, 0]))])
    return other, optimum(other, start)


def test_a_turned_sensor_and_turned_odometry_are_named_together() -> None:
    mounting, steps = sorted(calibrations(*turned()), key=lambda wrong: wrong.quantity)
    assert (mounting.components, steps.components) == (("yaw",), ("yaw",))
    np.testing.assert_allclose([mounting.correction[0], steps.correction[0]], [-0.1, -0.1], atol=0.02)


def test_a_function_of_a_free_landmark_is_left_out_as_a_whole() -> None:
    """A function of the ranges of two landmarks, one of which has no other measurement."""
    graph, values = turned()
    values = values.extended(l[[99]], np.array([[30.0, 4.0]]))
    ranges = Factor.from_function(
        lambda X, L: np.linalg.norm(L - X[:, :2], axis=1)[:, None] - 30, [x[[0, 1]], l[[0, 99]]], 1, Isotropic(10.0)
    )
    assert len(calibrations(FactorGraph([*graph.factors, ranges]), values)) == 2


def test_steps_no_longer_than_their_noise_are_not_too_long() -> None:
    """Scaled down they fit better, with less noise: by the rates of the measured steps they were twice as long."""
    rng, n, noise = np.random.default_rng(1), 200, np.array([0.1, 0.1, 0.05])
    yaw = np.cumsum(rng.normal(0, 0.3, n))
    X = np.column_stack([*np.cumsum(0.1 * np.array([np.cos(yaw), np.sin(yaw)]), axis=1), yaw])
    graph = FactorGraph([Prior(x[0], X[0], Isotropic(0.01))])
    for lag in (1, 7):
        z = SE2.between(X[:-lag], X[lag:])
        z = SE2.retract(z, noise * rng.normal(size=z.shape))
        graph.add(Between(x[np.arange(n - lag)], x[np.arange(lag, n)], z, Diagonal(noise)))
    assert calibrations(graph, optimum(graph, Values({x: (SE2, X)}))) == ()


def test_other_mistakes_are_no_calibration() -> None:
    """Odometry with a flipped axis, sigmas that are too small, a wrong closure."""
    graph, start, values = clean("subsea", 0)
    flipped = misread(graph, start, 1, "y flipped")
    assert calibrations(flipped, optimum(flipped, start)) == ()
    models = [values.gather(factor)[0] for factor in graph.factors]
    small = FactorGraph([rescaled(model, np.full((1, model.dim), 0.5)) for model in models])
    assert calibrations(small, values) == ()
    graph, start, _ = clean("ring", 0)
    wrong = wrong_closure(graph, np.random.default_rng(1))
    assert calibrations(wrong, optimum(wrong, start)) == ()
