"""Likelihood fields: against the formula, the gradient, rigid motions, what is refused."""

from __future__ import annotations

import numpy as np

from models.errors import GraphError, OptionError
from nls.missions.scans import Field
from tests.factors.evaluated import Array, refused, same

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-8, 8, (25, 2))


def by_formula(points: Array, q: Array, sigma: float) -> Array:
    """L with a share of 0.05 of strays."""
    d = np.linalg.norm(q[:, None] - points, axis=2).min(axis=1)
    return np.log(0.05 + 0.95 * np.exp(-(d**2) / (2 * sigma**2))) - np.log(0.05)


def test_the_formula_at_any_place() -> None:
    """Points lie in cells: a distance is off by half a diagonal at most, and L by no more than it changes there."""
    q = RNG.uniform(-9, 9, (500, 2))
    for sigma, resolution in ((0.5, 0.05), (1.5, 0.1)):
        L, _ = Field(POINTS, sigma, resolution).at(q)
        steepest = 1.43 / sigma  # of L, over all distances
        same(L, by_formula(POINTS, q, sigma), atol=1.5 * resolution * steepest)
    assert Field(POINTS).L.dtype == np.float32


def test_distances_are_exact_where_points_are_at_centers_of_cells() -> None:
    """Up to four sigmas, along the axes and across them; L is next to 0 beyond."""
    points = 0.25 * RNG.integers(-20, 21, (6, 2)) * [1.0, 3.0]
    for sigma, resolution in ((0.5, 0.25), (0.25, 0.125), (2.0, 0.0625)):
        field = Field(points, sigma, resolution)
        q = field.origin + resolution * np.indices(field.L.shape).reshape(2, -1).T[::7]
        d = np.linalg.norm(q[:, None] - points, axis=2).min(axis=1)
        L = field.L.reshape(-1)[::7]
        near = d <= 4 * sigma
        assert near.any()
        assert not near.all()
        same(L[near], by_formula(points, q[near], sigma), atol=1e-6)
        assert (L[~near] < 0.007).all()
        assert not L[d > 4 * sigma + 1.5 * resolution].any()


def test_the_gradient_is_that_of_L_within_a_cell() -> None:
    field = Field(POINTS, 0.5, 0.2)
    q = field.origin + 0.2 * (RNG.integers(0, 80, (200, 2)) + RNG.uniform(0.1, 0.9, (200, 2)))
    _, slope = field.at(q)
    for axis in range(2):
        step = 1e-3 * np.eye(2)[axis]
        difference = (field.at(q + step)[0] - field.at(q - step)[0]) / 2e-3
        same(slope[:, axis], difference, atol=1e-3)
    assert np.abs(slope).max() > 1


def test_zero_far_from_all_points_and_the_most_on_one() -> None:
    field = Field(POINTS, 0.5, 0.2)
    L, slope = field.at([[100.0, 0.0], [-1e6, 3.0], [0.0, 30.0]])
    assert not L.any()
    assert not slope.any()
    assert field.L.max() == np.float32(-np.log(0.05))
    assert max(field.L[0].max(), field.L[-1].max(), field.L[:, 0].max(), field.L[:, -1].max()) < 0.01


def test_what_does_not_fit() -> None:
    for points in (np.empty((0, 2)), [1.0, 2.0], np.zeros((3, 3))):
        refused(lambda points=points: Field(points), GraphError, r"Field: points of shape .*; expected \(n, 2\)")
    refused(lambda: Field([[0, 0], [np.nan, 1]]), GraphError, "point 1 is not finite")
    refused(
        lambda: Field([[0, 0], [1e5, 1e5]]), GraphError, "cells of 0.2 m; expected at most 40,000,000: take a larger"
    )
    for sigma, resolution in ((0.0, 0.2), (-1.0, 0.2), (0.5, 0.0), (0.5, np.nan)):
        refused(lambda s=sigma, r=resolution: Field(POINTS, s, r), OptionError, "sigma|resolution")
