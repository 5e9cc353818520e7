"""Drop-outs over many legs: their sum is as uncertain as one leg over all, and no combination is better known."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from models import SE3, SO3
from models.algebra import Array
from models.dead_reckoning import Legs, integrate
from tests.combinations import for_all

BETA, GAP = 0.1, (5.0, 15.0)
T = np.linspace(0.0, 20.0, 101)
AHEAD = np.array([1.0, 0.1, 0.05])
STILL = np.zeros((len(T), 3))
ALL_VALID: dict[str, Any] = {"valid": None, "sigma_bridge": None}
NO_GYRO: dict[str, Any] = {**ALL_VALID, "w": None, "sigma_w": None, "v": STILL + np.eye(3)[0]}


def legs_of(boundaries: npt.ArrayLike, **given: Any) -> Legs:
    """A vehicle with a constant velocity, not measured for a while, and a gyro that is all but perfect."""
    gap = {"valid": (T <= GAP[0]) | (T >= GAP[1]), "sigma_bridge": BETA}
    return integrate(
        T, boundaries=boundaries, **{"v": STILL + AHEAD, "w": STILL, "sigma_v": 1e-6, "sigma_w": 1e-9, **gap, **given}
    )


def summed(legs: Legs) -> Array:
    """Covariance (6, 6) of the whole way, were the legs independent: what a graph makes of them."""
    ends = SE3.stack(legs.track([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    M = SE3.adjoint(SE3.between(ends[-1:], ends[1:]))
    return np.asarray((M @ legs.Sigma @ M.mT).sum(axis=0))


def test_the_end_does_not_depend_on_the_number_of_legs() -> None:
    """Bridge, velocities before and after it, and rates that legs share; boundaries on samples and between them."""
    for noise in (
        {"sigma_bridge": 0.1, "sigma_v": 1e-6},
        {"sigma_bridge": 1e-6, "sigma_v": 0.05},
        {"sigma_bridge": 0.05, "sigma_v": [0.02, 0.05, 0.1]},
        {"sigma_bridge": 1e-6, "sigma_v": 1e-6, "sigma_w": 0.01},
    ):
        v = STILL if "sigma_w" in noise else STILL + AHEAD  # or the noise of the turn is part of the way
        one = summed(legs_of([0.0, 20.0], v=v, **noise))
        for boundaries in ([0.0, 9.3, 20.0], [0.0, 5.0, 15.0, 20.0], np.linspace(0, 20, 21), np.linspace(0, 20, 78)):
            many = summed(legs_of(boundaries, v=v, **noise))
            np.testing.assert_allclose(many, one, rtol=0.01, atol=1e-6 * one.max())
    for n in (2, 11, 51):
        assert np.sqrt(summed(legs_of(np.linspace(5.0, 15.0, n)))[0, 0]) == pytest.approx(BETA * 10**1.5 / 12**0.5)


def test_no_combination_of_legs_is_better_known_than_the_bridge_allows() -> None:
    b = np.array([5.0, 6.0, 6.5, 10.0, 13.0, 15.0])
    s = np.linspace(0.0, 10.0, 2001)
    kernel = BETA**2 * (np.minimum.outer(s, s) - np.outer(s, s) / 10)
    part = np.array([(s + 5.0 >= low) & (s + 5.0 < high) for low, high in pairwise(b)]) * s[1]
    C = part @ kernel @ part.T
    D = np.diag(legs_of(b).Sigma[:, 0, 0])
    np.testing.assert_allclose(D.sum(), C.sum(), rtol=1e-3)
    assert np.linalg.eigvalsh(D - C).min() > -1e-4 * C.max()
    assert (np.diagonal(D) > np.diagonal(C)).all()


def walked(sigma: float, boundaries: list[float]) -> Legs:
    """Attitudes at 10 Hz with none between 5 and 15 s, 1 m/s ahead."""
    t_w = np.linspace(0.0, 20.0, 201)
    t_w = t_w[(t_w <= GAP[0]) | (t_w >= GAP[1])]
    level = np.zeros((len(t_w), 3))
    return legs_of(boundaries, t_w=t_w, attitude=level, sigma_attitude=1e-6, sigma_turn=sigma, **NO_GYRO)


@for_all(boundaries=[[0.0, 20.0], [5.0, 15.0], [0.0, 7.3, 7.4, 9.0, 15.0, 20.0]])
def test_an_attitude_that_is_not_measured_wanders(boundaries: list[float]) -> None:
    """Yaw by sigma sqrt(T), the place of the end across the way by what that swings, in any number of legs."""
    sigma = 0.05
    legs = walked(sigma, boundaries)
    S = summed(legs)
    after = boundaries[-1] - 15.0
    assert S[5, 5] == pytest.approx(sigma**2 * 10, rel=1e-3)
    # y = integral of (time to the end) times the white rate
    assert S[1, 1] == pytest.approx(sigma**2 * ((10 + after) ** 3 - after**3) / 3, rel=2e-3)
    assert legs.unturned.sum() == pytest.approx(10.0)
    assert "; the attitude for 10 s, in " in str(legs)
    assert walked(0.0, boundaries).Sigma[:, 5, 5].max() < 1e-9


def test_each_drop_out_and_axis_of_the_attitude_has_its_own_density() -> None:
    t_w = np.delete(np.linspace(0.0, 20.0, 201), [*range(31, 50), *range(101, 140)])  # none in 3-5 s, 10-14 s
    sigma = np.zeros((len(t_w), 3))
    sigma[np.flatnonzero(np.diff(t_w) > 1)] = [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]
    turned = np.concatenate([np.zeros(3), SO3.exp(np.array([0.0, 0.0, np.pi / 2]))])  # DVL to starboard
    given: dict[str, Any] = {"t_w": t_w, "attitude": 0 * sigma, "sigma_attitude": 1e-9, "sigma_turn": sigma}
    legs = legs_of([0.0, 8.0, 20.0], mount=turned, **given, **NO_GYRO)
    found = np.diagonal(legs.Sigma[:, 3:, 3:], axis1=1, axis2=2)
    np.testing.assert_allclose(found, np.square([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]) * [[2.0], [4.0]], rtol=1e-6)
    assert legs.unturned.tolist() == pytest.approx([2.0, 4.0])


def test_rates_that_are_far_apart_are_a_drop_out_too() -> None:
    t_w = np.delete(T, np.arange(30, 40))
    given: dict[str, Any] = {"t_w": t_w, "w": STILL[: len(t_w)], **ALL_VALID}
    gap, whole = legs_of([0.0, 20.0], sigma_turn=0.1, **given), legs_of([0.0, 20.0], longest=3.0, **given)
    assert gap.Sigma[0, 5, 5] == pytest.approx(0.1**2 * 2.2, rel=1e-6)
    assert gap.unturned == pytest.approx([2.2])
    assert whole.Sigma[0, 5, 5] < 1e-12
