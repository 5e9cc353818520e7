"""What a sensor can see: the sector up to its largest range, and the area that was in it from some poses.

A sensor at (x, y, yaw) sees a point that is (r, a) in its own polar coordinates if

    r <= r_max,      a_min <= a <= a_max

Nothing hides anything here: what lies behind a wall counts as seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models import SE2
from models.algebra import Array, Mask

__all__ = ["Observed", "View"]

RIM = 33  # points of the arc of a sector, of which the corners are taken


@dataclass(frozen=True)
class View:
    """The sector that a sensor sees.

    Attributes
    ----------
    far : largest range, m.
    low, high : least and largest azimuth, rad.

    Examples
    --------
    >>> import numpy as np
    >>> view = View.of(np.array([[3.0, 0.0], [2.0, 2.0], [1.0, -1.0]]))
    >>> view.far, np.degrees([view.low, view.high]).round(1).tolist()
    (3.0, [-45.0, 45.0])
    """

    far: float
    low: float
    high: float

    @classmethod
    def of(cls, points: Array) -> View:
        """The sector that points (n, 2) in the frame of the sensor span, m; all around, and no range, without any."""
        if not len(points):
            return cls(0.0, -np.pi, np.pi)
        azimuth = np.arctan2(points[:, 1], points[:, 0])
        return cls(float(np.hypot(*points.T).max()), float(azimuth.min()), float(azimuth.max()))


@dataclass(frozen=True, eq=False)
class Observed:
    """The area that a sensor saw from some poses.

    Attributes
    ----------
    poses : (k, 3) of the sensor: x, y, m, and yaw, rad.
    view : what it sees.

    Examples
    --------
    >>> import numpy as np
    >>> ahead = Observed(np.zeros((1, 3)), View(far=10.0, low=-np.pi / 4, high=np.pi / 4))
    >>> ahead.grid(np.array([-5.0, 5.0, 9.0]), np.array([0.0, 6.0]))
    array([[False, False],
           [ True, False],
           [ True, False]])
    """

    poses: Array
    view: View

    @property
    def corners(self) -> Array:
        """Least and largest x and y (2, 2) of the area, m."""
        azimuth = np.linspace(self.view.low, self.view.high, RIM)
        rim = np.vstack([np.zeros(2), self.view.far * np.column_stack([np.cos(azimuth), np.sin(azimuth)])])
        q = SE2.act(np.repeat(self.poses, len(rim), axis=0), np.tile(rim, (len(self.poses), 1)))
        return np.array([q.min(axis=0), q.max(axis=0)])

    def grid(self, x: Array, y: Array) -> Mask:
        """Which points of a grid (len(x), len(y)) are in the area."""
        seen = np.zeros((len(x), len(y)), dtype=bool)
        low, high = self.view.low, self.view.high
        for px, py, yaw in self.poses.tolist():  # the few keyframes of a submap
            dx, dy = (x - px)[:, None], (y - py)[None, :]
            above = np.cos(yaw + low) * dy >= np.sin(yaw + low) * dx
            below = np.cos(yaw + high) * dy <= np.sin(yaw + high) * dx
            within = above & below if high - low <= np.pi else above | below
            seen |= within & (dx**2 + dy**2 <= self.view.far**2)
        return seen
