"""Which pose a row is of, and what poses that share a row may say."""

from __future__ import annotations

import numpy as np

from nls.io.mission.timeline import poses_of_rows


def test_poses_denser_than_the_rows_of_a_sensor_know_no_more_than_the_rows() -> None:
    rows, poses = np.arange(0.0, 10.0), np.arange(0.0, 9.0, 0.25)
    grown = poses_of_rows(rows, poses)
    assert grown.tolist() == [2.0] * len(poses)  # four poses a row
    assert (1 / grown**2).sum() == 9
    assert poses_of_rows(np.arange(0.0, 10.0, 0.1), np.arange(0.05, 9.0)).tolist() == [1.0] * 9
