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
from nls.io.mission import elevations

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


@pytest.mark.parametrize("heave", [0.05, 0.3, 1.0])
def test_the_aperture_stands_in_for_hinges_that_push(heave: float) -> None:
    graph, start = two_views(heave, elevation=LIMIT + 0.02)
    hinge = ElevationHinge(x[[0, 1]], l[[0, 0]], LIMIT, SOFTNESS)
    hinged = FactorGraph([*graph.factors, hinge[[0]]])
    found, before = (elevations(g, start, sigmas=True) for g in (hinged, graph))
    assert (found.pushed.tolist(), before.pushed.tolist()) == ([True], [False])
    assert found.sigma == pytest.approx(1 / np.sqrt(1 / before.sigma**2 + 3 / LIMIT**2), rel=1e-3)
    Sigma = found.widened(Marginals(hinged, start).all(l))[0]
    along = found.along[0]
    assert np.sqrt(along @ Sigma @ along) / 4.0 == pytest.approx(found.sigma[0], rel=0.01)


def test_inside_the_aperture_nothing_changes() -> None:
    graph, start = two_views(0.3, elevation=LIMIT - 0.02)
    hinged = FactorGraph([*graph.factors, ElevationHinge(x[[0, 1]], l[[0, 0]], LIMIT, SOFTNESS)])
    found, before = (elevations(g, start, sigmas=True) for g in (hinged, graph))
    assert not found.pushed.any()
    assert not found.widening.any()
    np.testing.assert_allclose(found.sigma, before.sigma, rtol=1e-9)


def test_errors_of_pushed_elevations_fit_their_sigmas() -> None:
    """Along the hull; as measurements the hinges would know elevations to 1 deg that are 10 deg off."""
    hinges, limits, others = (np.zeros(0) for _ in range(3))
    for seed in range(3):
        mission = sim.hauv_hull(np.random.default_rng(seed))
        values = mission.graph.optimize(mission.start, LevenbergMarquardt()).values
        found = elevations(mission.graph, values, sigmas=True)
        S = SE3.compose(mission.truth[x[found.poses]], mission.offset)
        true = spherical(SE3.act(SE3.inverse(S), mission.truth[l[found.landmarks]]))[0][:, 2]
        error, p = found.elevation - true, found.pushed
        hinges = np.append(hinges, error[p] / np.sqrt(found.sigma**2 - found.widening)[p])
        limits, others = np.append(limits, error[p] / found.sigma[p]), np.append(others, (error / found.sigma)[~p])

    def squared(e: Array) -> float:
        return float(np.mean(e**2))

    assert min(len(limits), len(others)) > 50
    assert squared(hinges) > 10 > 3 > squared(limits)
    assert squared(others) == pytest.approx(1.0, abs=0.25)
    assert np.abs(limits).max() < 4 < 10 < np.abs(hinges).max()
