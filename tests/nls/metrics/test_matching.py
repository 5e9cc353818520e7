"""Poses matched by time: a steady motion is met exactly, nothing is extrapolated, no long gap is bridged."""

from __future__ import annotations

import numpy as np
import pytest

from models import SE2, SE3, LieGroup
from nls import GraphError, OptionError
from nls.metrics import ate, matched


@pytest.mark.parametrize("group", [SE2, SE3], ids=str)
def test_a_steady_motion_is_met_between_the_rows(group: LieGroup) -> None:
    """Straight ahead with a constant turn rate about the vertical, that wraps around pi."""

    def poses(t: np.ndarray) -> np.ndarray:
        yaw, zero = 0.3 * t, np.zeros_like(t)
        if group is SE2:
            return np.column_stack([2 * t, -t, (yaw + np.pi) % (2 * np.pi) - np.pi])
        return np.column_stack([2 * t, -t, 0.1 * t, zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)])

    times = np.arange(0.0, 30.0, 1.0)
    at = np.array([0.0, 0.25, 7.9, 10.47, 29.0])
    pairs = matched(at, poses(at), times, poses(times))
    assert np.abs(group.local(pairs.truth, poses(at))).max() < 1e-12
    assert ate(pairs.estimate, pairs.truth).rmse < 1e-12


def test_what_has_no_match_is_counted() -> None:
    times = np.array([0.0, 1.0, 2.0, 3.0, 8.0, 9.0])  # a gap of 5 s; the median is 1 s
    truth = np.column_stack([times, 0 * times, 0 * times])
    at = np.array([-0.1, 0.5, 3.0, 5.0, 8.0, 9.0, 9.1, 20.0])
    estimate = np.column_stack([at, 0 * at, 0 * at])
    pairs = matched(at, estimate, times, truth)
    assert (pairs.outside, pairs.gaps, pairs.tolerance) == (3, 1, 2.0)
    assert pairs.rows.tolist() == [1, 2, 4, 5]  # rows of the truth beside the gap are met
    wide = matched(at, estimate, times, truth, tolerance=5.0)
    assert (wide.gaps, wide.truth[wide.times == 5.0, 0].tolist()) == (0, [5.0])
    one = matched([3.0, 4.0], truth[:2], [3.0], truth[:1])
    assert (one.rows.tolist(), one.outside) == ([0], 1)


def test_mistakes() -> None:
    X = np.zeros((3, 3))
    with pytest.raises(GraphError, match=r"none of 3 poses has a match. Their times are 100 to 102 s, those of the"):
        matched([100, 101, 102], X, [0, 1, 2], X)
    with pytest.raises(GraphError, match=r"times_truth\[2\], .*0.5.*, does not rise over .*1.0"):
        matched([0, 1, 2], X, [0, 1, 0.5], X)
    with pytest.raises(GraphError, match=r"times_estimate has shape \(2,\), expected \(3,\)"):
        matched([0, 1], X, [0, 1, 2], X)
    with pytest.raises(GraphError, match="matched: shapes"):
        matched([0, 1, 2], X, [0, 1, 2], np.zeros((3, 7)))
    with pytest.raises(OptionError, match="a time in seconds"):
        matched([0, 1, 2], X, [0, 1, 2], X, tolerance=-1.0)
