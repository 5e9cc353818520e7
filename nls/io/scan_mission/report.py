"""The report of the folder of a scan mission: its contents besides the graph."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from models.algebra import Array, Index, Numbers
from nls.io.report import LoadReport
from nls.metrics import TrajectoryError, ate
from nls.sonar.scans import Drift, Scans

__all__ = ["ScanReport", "Truth"]


@dataclass(frozen=True)
class Truth:
    """True poses at the times of keyframes.

    Attributes
    ----------
    rows : (m,) of the keyframes that lie within the times of the truth.
    poses : (m, 3) x, y, m, and yaw, rad; yaw 0 where the file has none.
    """

    rows: Index
    poses: Array = field(repr=False)

    def ate(self, poses: Array) -> TrajectoryError:
        """Absolute trajectory error of keyframes (count, 3) after one rigid motion without scale.

        Raises
        ------
        SingularGeometryError
            All keyframes on one spot.
        """
        return ate(poses[self.rows], self.poses, align="rigid")


@dataclass
class ScanReport(LoadReport):
    """The report of a scan mission; `vertex_times` has the times of its keyframes.

    Attributes
    ----------
    numbers : (count,) of the keyframes as in the file; keyframe k of graph and scans is its row, from 0.
    scans : the points in the frame of the vehicle.
    intensity : (n,) of the points, in their order; None where the file has none.
    drift : how wrong dead reckoning is taken to be.
    truth : None without a file of it.
    """

    numbers: Numbers = field(default_factory=lambda: np.zeros(0, dtype=np.int64), compare=False, repr=False)
    scans: Scans = field(default_factory=lambda: Scans(np.zeros((0, 2)), np.zeros(0, dtype=np.intp), 0), compare=False)
    intensity: Array | None = field(default=None, compare=False, repr=False)
    drift: Drift = field(default_factory=Drift)
    truth: Truth | None = field(default=None, compare=False)

    @property
    def counts(self) -> dict[str, int]:
        """Keyframes, scans with points in them, points, and keyframes within the truth."""
        return {
            "keyframes": len(self.numbers),
            "scans": int(self.scans.with_points.sum()),
            "points": len(self.scans.points),
            "keyframes_with_truth": 0 if self.truth is None else len(self.truth.rows),
        }
