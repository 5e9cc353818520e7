"""Elevations at the edge of the aperture: a hinge that pushes is a limit, and no measurement."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest

import sim
from factors import Diagonal, ElevationHinge, Isotropic, Prior, RangeAzimuth
from models import SE3, R
from models.algebra import Array
from models.sensors import spherical
from nls import FactorGraph, LevenbergMarquardt, Marginals, Values, kinds
from nls.missions import elevations
from tests.combinations import for_all

x, l = kinds("x", "l")
LIMIT, SOFTNESS = radians(7.0), radians(1.0)


def two_views(heave: float, elevation: float) -> tuple[FactorGraph, Values]:
    """Two poses known to 0.1 mm, and a point at an elevation in the first, seen from both."""
    poses = np.array([[0, 0, 0, 0, 0, 0, 1], [0, 0, heave, 0, 0, 0, 1]], dtype=float)
    p = 4.0 * np.array([[np.cos(elevation), 0.0, np.sin(elevation)]])
    seen = spherical(np.concatenate([p, p - [0, 0, heave]]))[0][:, :2]
    contacts = RangeAzimuth(x[[0, 1]], l[[0, 0]], seen, Diagonal(range=0.01, azimuth=0.005))
    graph = FactorGraph([Prior(x[[0, 1]], poses, Isotropic(1e-4)), contacts])
    return graph, Values({x: (SE3, poses), l: (R(3), p)})


def assert_covariance(graph: FactorGraph, values: Values) -> None:
    """What is said of the place of the landmark has the sigma along its arc; elsewhere it lost nothing, or gained."""
    found, Sigma = elevations(graph, values, sigmas=True), Marginals(graph, values).all(l)
    bounded, along = found.bounded(Sigma)[0], found.along[0]
    assert np.sqrt(along @ bounded @ along) / 4.0 == pytest.approx(found.sigma[0], rel=0.01)
    assert np.linalg.eigvalsh(bounded)[0] > 0
    grown = (found.sigma**2 - found.before**2)[0]
    if grown == 0:
        np.testing.assert_array_equal(bounded, Sigma[0])
        return
    bow = 0.75 * (4.0 * max(grown, 0.0)) ** 2 * np.outer(found.ahead, found.ahead)
    change = np.linalg.eigvalsh(bounded - bow - Sigma[0])
    one = change[2] if grown > 0 else change[0]  # a rank of 1, of one sign
    assert one * grown > 0
    assert np.sort(np.abs(change))[1] < 1e-9 * abs(one)


@for_all(heave=[0.05, 0.3, 1.0])
def test_the_aperture_stands_in_for_hinges_that_push(heave: float) -> None:
    graph, start = two_views(heave, elevation=LIMIT + 0.02)
    hinge = ElevationHinge(x[[0, 1]], l[[0, 0]], LIMIT, SOFTNESS)
    hinged = FactorGraph([*graph.factors, hinge[[0]]])
    found, before = (elevations(g, start, sigmas=True) for g in (hinged, graph))
    assert (found.pushed.tolist(), before.pushed.tolist()) == ([True], [False])
    v = LIMIT**2 / 3 + found.elevation**2
    assert found.sigma == pytest.approx(1 / np.sqrt(1 / before.before**2 + 1 / v), rel=1e-3)
    assert_covariance(hinged, start)


@for_all(heave=[0.3, 0.01])
def test_inside_the_aperture_no_elevation_is_known_less_well_than_by_it(heave: float) -> None:
    better = heave < 0.1
    graph, start = two_views(heave, elevation=LIMIT - 0.02)
    hinged = FactorGraph([*graph.factors, ElevationHinge(x[[0, 1]], l[[0, 0]], LIMIT, SOFTNESS)])
    found, before = (elevations(g, start, sigmas=True) for g in (hinged, graph))
    assert not found.pushed.any()
    np.testing.assert_allclose(found.before, before.sigma, rtol=1e-9)
    by_aperture = np.sqrt(LIMIT**2 / 3 + found.elevation**2)
    assert (before.sigma > by_aperture).all() == better
    np.testing.assert_allclose(found.sigma, by_aperture if better else before.sigma, rtol=1e-9)
    assert_covariance(hinged, start)


@pytest.mark.filterwarnings("error")
def test_landmarks_that_are_held_are_not_pushed() -> None:
    graph, start = two_views(0.3, elevation=LIMIT + 0.02)
    hinged = FactorGraph([*graph.factors, ElevationHinge(x[0], l[0], LIMIT, SOFTNESS)])
    hinged.fix(l[0])
    found = elevations(hinged, start, sigmas=True)
    assert not found.pushed.any()
    assert not found.bounded(Marginals(hinged, start).all(l)).any()  # a place that is given
    hinged.fix(x[0])  # then the elevation is given, too
    assert elevations(hinged, start, sigmas=True).sigma == pytest.approx(0.0, abs=1e-6)


def test_errors_of_pushed_landmarks_fit_their_sigmas() -> None:
    """Along the hull; as measurements the hinges would know elevations to 1 deg that are 10 deg off."""
    parts: list[tuple[Array, ...]] = []
    for seed in range(3):
        mission = sim.hauv_hull(np.random.default_rng(seed))
        values = mission.graph.optimize(mission.start, LevenbergMarquardt()).values
        found = elevations(mission.graph, values, sigmas=True)
        S = SE3.compose(mission.truth[x[found.poses]], mission.offset)
        true = mission.truth[l[found.landmarks]]
        error, p = found.elevation - spherical(SE3.act(SE3.inverse(S), true))[0][:, 2], found.pushed
        away = (values[l[found.landmarks]] - true)[p]
        Sigma = found.bounded(Marginals(mission.graph, values).covariance(l[found.landmarks]))[p]
        places = (away * np.linalg.solve(Sigma, away[..., None])[..., 0]).sum(axis=1)
        parts.append((np.square((error / found.before)[p]), np.square((error / found.sigma)[p]), places))
        parts[-1] += (np.square((error / found.sigma)[~p]),)
    hinges, limits, places, others = map(np.concatenate, zip(*parts, strict=True))
    assert min(len(limits), len(others)) > 50
    assert hinges.mean() > 10 > 1.5 > limits.mean()
    assert others.mean() == pytest.approx(1.0, abs=0.25)
    assert limits.max() < 2.5**2 < 10**2 < hinges.max()
    assert places.mean() == pytest.approx(3.0, abs=1.0)
