"""Updates of an EKF linearized again: the optimum of a step, the same map where one linearization is enough."""

from __future__ import annotations

import numpy as np
import pytest

import sim
from factors import BearingRange, Between, Diagonal, Isotropic, Prior
from models import SE2, R
from models.errors import OptionError
from nls import FactorGraph, Marginals, Values, kinds
from nls.filters.ekf import EKF
from tests.sim.scenes import thinned

x, l = kinds("x", "l")


def test_an_update_ends_at_the_optimum_of_its_step() -> None:
    """Landmarks charted to 4 m, 20 m away, and a bearing of 0.2 deg: one linearization is many sigma off."""
    rng = np.random.default_rng(4)
    L = np.array([[20.0, 5.0], [-3.0, 18.0], [5.0, -20.0]])
    chart = L + 4.0 * rng.normal(size=L.shape)
    seen = np.stack([np.arctan2(L[:, 1], L[:, 0]), np.hypot(*L.T)], axis=1)
    graph = FactorGraph(
        [
            Prior(x[0], [0.5, -0.4, 0.001], Diagonal([1.0, 1.0, 1e-3])),  # hardly turned: no matter by which chart
            BearingRange(x[0], l[0:3], seen, Diagonal(bearing=np.radians(0.2), range=0.2)),
            Prior(l[0:3], chart, Isotropic(4.0)),
        ]
    )
    values = Values({x: (SE2, np.zeros((1, 3))), l: (R(2), chart)})
    best = graph.optimize(values).values
    marginals = Marginals(graph, best)
    P, P_l = marginals.covariance(x[0], frame="body"), marginals.covariance(l[0:3])
    sigma, sigma_l = np.sqrt(np.diag(P)), np.sqrt(np.diagonal(P_l, axis1=1, axis2=2))
    off = {}
    for iterations in (1, 10):
        track = EKF("independent", iterations=iterations).run(graph, values)
        away = track.values[l[0:3]] - best[l[0:3]]
        off[iterations] = max(np.abs(away / sigma_l).max(), np.abs((track.X[0] - best[x[0]]) / sigma).max())
    assert off[1] > 1.0
    assert off[10] < 5e-3
    np.testing.assert_allclose(track.P[0], P, atol=2e-3 * np.abs(P).max())
    np.testing.assert_allclose(track.P_landmarks, P_l, rtol=2e-3, atol=2e-3 * np.abs(P_l).max())


def test_charts_that_are_far_off_leave_it_as_good_as_it_says() -> None:
    """Over 30 seeds of two laps the mean NEES of the last pose is 74 with one linearization, and 2.6."""
    nees: dict[int, list[float]] = {1: [], 10: []}
    for seed in (2, 3):
        world = sim.subsea(np.random.default_rng(seed), laps=1, landmarks="independent")
        for iterations, found in nees.items():
            track = EKF("independent", iterations=iterations).run(world.graph, world.start)
            found.append(float(track.nees(world.truth)[-1]))
    assert np.mean(nees[1]) > 30
    assert max(nees[10]) < 9.3  # 97.5 %


def test_where_landmarks_begin_where_they_are_seen_it_changes_little() -> None:
    """Nor does it learn where everything is: sigma of the start is 2 m, that of the heading 0.5 deg."""
    world = thinned(sim.subsea(np.random.default_rng(3), laps=1))
    plain, again = (EKF(iterations=n).run(world.graph, world.start) for n in (1, 10))
    e = SE2.local(plain.X[-1:], again.X[-1:])[0]
    assert np.abs(e / np.sqrt(np.diag(plain.P[-1]))).max() < 0.2
    sigma = np.sqrt(np.diag(again.P[-1]))
    assert (sigma[:2] > 1.999).all()
    assert sigma[2] > np.radians(0.5)


def test_a_linear_problem_is_left_alone() -> None:
    graph = FactorGraph(
        [
            Prior(x[0], [1.0, 2.0], Isotropic(0.5)),
            Between(x[0], x[1], [1.0, 0.0], Isotropic(0.3)),
            Prior(x[[1]], [[9.0, 0.0]], Isotropic(0.7), components=("y",)),
        ]
    )
    values = Values({x: (R(2), np.zeros((2, 2)))})
    one, ten = (EKF(iterations=n).run(graph, values) for n in (1, 10))
    np.testing.assert_allclose(one.X, ten.X, atol=1e-12)
    np.testing.assert_allclose(one.P, ten.P, atol=1e-12)


def test_options() -> None:
    assert EKF("independent", iterations=10).method == "EKF (independent, 10 iterations)"
    for given, first in ((0, False), (2.0, False), (True, False), (2, True)):
        with pytest.raises(OptionError, match=r"iterations: .* whole number of at least 1; 1 with first_estimates"):
            EKF(first_estimates=first, iterations=given)  # type: ignore[arg-type]
