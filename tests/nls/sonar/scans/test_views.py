"""Sectors against polar coordinates, narrow and wide, and the box around them."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2
from models.algebra import Array, Mask
from nls.sonar.scans.views import Observed, View
from tests.factors.evaluated import same

RNG = np.random.default_rng(0)
POSES = RNG.uniform([-5, -5, -3], [5, 5, 3], (4, 3))
X, Y = np.arange(-30.0, 30.0, 0.7), np.arange(-28.0, 31.0, 0.9)
SECTORS = [(-60, 60), (-10, 75), (-90, 90), (-130, 130), (-170, 20), (-180, 180)]


def by_polar(observed: Observed, q: Array) -> Mask:
    """Which points (n, 2) are in the sector of any pose."""
    p = SE2.act(np.repeat(SE2.inverse(observed.poses), len(q), axis=0), np.tile(q, (len(observed.poses), 1)))
    r, a, view = np.hypot(*p.T), np.arctan2(p[:, 1], p[:, 0]), observed.view
    inside = (r <= view.far) & (view.low <= a) & (a <= view.high)
    return np.asarray(inside.reshape(len(observed.poses), -1).any(axis=0))


@pytest.mark.parametrize(("low", "high"), SECTORS)
def test_a_grid_is_in_the_sectors_of_its_poses(low: float, high: float) -> None:
    observed = Observed(POSES, View(18.0, *np.radians([low, high])))
    q = np.stack(np.meshgrid(X, Y, indexing="ij"), axis=-1).reshape(-1, 2)
    seen = observed.grid(X, Y)
    assert seen.shape == (len(X), len(Y))
    np.testing.assert_array_equal(seen.ravel(), by_polar(observed, q))
    assert 0.05 < seen.mean() < 0.9


@pytest.mark.parametrize(("low", "high"), SECTORS)
def test_the_corners_hold_the_area_closely(low: float, high: float) -> None:
    observed = Observed(POSES, View(18.0, *np.radians([low, high])))
    fine = np.arange(-30.0, 30.0, 0.1)
    x, y = np.nonzero(observed.grid(fine, fine))
    around = np.array([[fine[x.min()], fine[y.min()]], [fine[x.max()], fine[y.max()]]])
    same(observed.corners, around, atol=0.3)  # a step of the grid, and the height of an arc over its chord


def test_the_view_spans_the_points() -> None:
    angle = np.radians([-50.0, 10.0, 65.0])
    view = View.of(np.array([[3.0], [12.0], [7.0]]) * np.column_stack([np.cos(angle), np.sin(angle)]))
    same([view.far, view.low, view.high], [12.0, angle[0], angle[2]], rtol=1e-12)
    assert View.of(np.zeros((0, 2))).far == 0
