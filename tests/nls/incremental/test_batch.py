"""Batches that grow: what measurements have of their own stays theirs, in arrays, in pairs and in factors within."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from factors import Between, BetweenSensors, DriftingStep, Factor, Isotropic, Position, Prior, Shifted
from models import SE2, R
from models.algebra import Index
from nls import FactorGraph, Incremental, Values, kinds

x, c = kinds("x", "c")
NOISE = Isotropic(0.1)
OFFSETS = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.3], [0.5, 0.0, -1.0]])
Z = np.array([[1.0, 0.1, 0.3], [0.9, 0.0, 0.1], [1.1, -0.1, 0.0]])

MADE: dict[str, Callable[[Index], Factor]] = {
    "numbers": lambda k: DriftingStep(x[k], x[k + 1], c[0], Z[k], NOISE, k + 1.0),
    "pairs": lambda k: BetweenSensors(x[k], x[k + 1], Z[k], NOISE, (OFFSETS[k], OFFSETS[k - 1])),
    "within": lambda k: Shifted(Position(x[k + 1], Z[k, :2], NOISE, offset=OFFSETS[k, :2]), np.eye(2), c[0]),
}


def start(n: int) -> Values:
    return Values({x: (SE2, 0.1 * np.random.default_rng(0).normal(size=(n, 3))), c: (R(2), np.zeros((1, 2)))})


@pytest.mark.parametrize("name", MADE)
@pytest.mark.parametrize("sizes", [(1, 1, 1), (2, 1), (1, 2)])
def test_what_is_of_one_measurement_stays_with_it(name: str, sizes: tuple[int, ...]) -> None:
    """However many arrive at once, the optimum is that of all in one graph."""
    held = [Prior(x[np.arange(4)], start(4)[x], Isotropic(1.0)), Prior(c[0], [0.1, 0.2], Isotropic(0.5))]
    smoother = Incremental(tol=1e-9)
    smoother.update(held, start(4))
    parts = [MADE[name](k) for k in np.split(np.arange(3), np.cumsum(sizes)[:-1])]
    for part in parts:
        smoother.update(part)
    whole = FactorGraph([*held, *parts]).optimize(start(4)).values
    for kind in (x, c):
        np.testing.assert_allclose(smoother.values[kind], whole[kind], atol=2e-3)


def test_rows_of_a_follow_the_values_after_measurements_left() -> None:
    """Whatever part of its memory a batch uses: steps are taken with the A of where the variables are."""
    smoother, k = Incremental(), np.arange(40)
    smoother.update([Between(x[k], x[k + 1], [1.0, 0.0, 0.1], NOISE), Prior(x[0], [0, 0, 0], NOISE)], start(1))
    batch = smoother._system.batches[0]
    batch.drop(k < 35)
    A, At = batch.A(200)
    batch.variables[0].X[...] += [0.0, 1.0, 0.5]
    batch.linearize()
    expected = np.concatenate(batch.blocks(), axis=2).sum(axis=2).reshape(-1)
    assert np.abs(expected).max() > 1
    for rows in (A, At.T):
        np.testing.assert_allclose(rows.sum(axis=1), expected, atol=1e-12)
