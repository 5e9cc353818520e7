"""Which pose a row is of, and what poses that share a row may say."""

from __future__ import annotations

import numpy as np
import pytest

from nls.missions.folder.timeline import poses_of_rows


def test_poses_denser_than_the_rows_of_a_sensor_know_no_more_than_the_rows() -> None:
    rows, poses = np.arange(0.0, 100.0), np.arange(0.0, 99.0, 0.25)
    grown = poses_of_rows(rows, poses)
    assert (1 / grown**2).sum() == pytest.approx(99, rel=0.05)  # of 396 poses
    assert poses_of_rows(rows, rows).tolist() == [1.0] * 100
    near = np.sort(np.append(np.arange(0.0, 9.0), 4.05))  # two poses between two of many rows
    assert poses_of_rows(np.arange(0.0, 10.0, 0.1), near).tolist() == [1.0] * 10
