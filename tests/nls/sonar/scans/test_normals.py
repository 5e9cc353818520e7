"""The direction along which points do not show their place."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2
from nls.sonar.scans import Field
from nls.sonar.scans.matching import match
from nls.sonar.scans.normals import hidden_direction
from nls.sonar.scans.submaps import bent, match_submap
from tests.factors.evaluated import same

RNG = np.random.default_rng(0)
WALL = np.column_stack([np.arange(0.0, 60.0, 0.25), np.zeros(240)])


@pytest.mark.parametrize("yaw", [0.0, 0.6, 2.0])
@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_a_straight_wall_hides_its_own_direction(yaw: float, noise: float) -> None:
    points = SE2.act(np.array([[3.0, -20.0, yaw]]), WALL + noise * RNG.standard_normal(WALL.shape))
    along = hidden_direction(points)
    assert along is not None
    same(abs(along @ [np.cos(yaw), np.sin(yaw)]), 1.0, atol=2e-3)


def test_corners_piles_and_few_points_show_both() -> None:
    corner = np.concatenate([WALL, WALL[:80, ::-1]])
    boulders = (20 * RNG.standard_normal((30, 1, 2)) + 0.3 * RNG.standard_normal((30, 6, 2))).reshape(-1, 2)
    for points in (corner, boulders, np.zeros((1, 2)), np.zeros((50, 2)), 100 * WALL[:20]):
        assert hidden_direction(points) is None


def test_a_match_along_a_wall_is_as_wide_as_the_window() -> None:
    """The ends of the view lie on each other 5 m off the guess, and the scores have their peak there."""
    scan = WALL[:200] - [25.0, 10.0]
    guess, window = np.array([30.0, 10.0, 0.0]), (6.0, 0.05)
    fit, alone = match_submap(Field(WALL), scan, guess, window), bent(match(Field(WALL), scan, guess, window))
    same(fit.pose, alone.pose)
    same(fit.covariance - alone.covariance, np.diag([12.0, 0.0, 0.0]), atol=1e-6)  # 6^2 / 3
    assert fit.spread > np.sqrt(12.0)
    assert np.sqrt(fit.covariance[1, 1]) < 0.6


def test_a_match_of_a_corner_is_as_the_scores_say() -> None:
    corner = np.concatenate([WALL, WALL[:80, ::-1]])
    fit, alone = (f(Field(corner), corner, np.zeros(3), (3.0, 0.05)) for f in (match_submap, match))
    same(fit.covariance, bent(alone).covariance)
