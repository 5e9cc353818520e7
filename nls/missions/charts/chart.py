"""Charts of a solution: the track, landmarks and beacons, each with its covariance, and 95 % ellipses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from factors.keys import Keys, Kind
from models import R
from models.algebra import Array, Index, Numbers, distance_along
from models.geodesy import LocalPlane
from models.visible import visible
from nls.covariance import Marginals
from nls.covariance.frames import outlines
from nls.missions.determination import covariances
from nls.missions.folder.report import MissionReport
from nls.missions.landmarks import Elevations
from nls.values import Values

NAMES = {"l": "landmark", "b": "beacon"}  # of the kinds of points in a mission
ELLIPSES = 60  # along a track: as many as can be told apart


@dataclass(frozen=True)
class Points:
    """Positions north, east and down of the origin, with their covariances.

    Attributes
    ----------
    name : of one of them, such as ``landmark``.
    numbers : (n,) of the variables.
    p : (n, 3) m, or (n, 2) where nothing measures the depth.
    Sigma : (n, 3, 3) covariances along the axes of the world, m^2; nan where there is none.
    """

    name: str
    numbers: Numbers = field(repr=False)
    p: Array = field(repr=False)
    Sigma: Array = field(repr=False)

    @property
    def sigmas(self) -> Array:
        """Standard deviations (n, 3) north, east and down, m; nan where there are none."""
        return np.asarray(np.sqrt(np.diagonal(self.Sigma, axis1=1, axis2=2)))

    def ellipses(self, rows: Index) -> tuple[Index, Array]:
        """Which of some rows have an ellipse (k,), and the outlines (k, 48, 2) of these, 95 %, m; none that is held."""
        level = self.Sigma[rows, :2, :2]
        rows = rows[np.isfinite(level).all(axis=(1, 2)) & (level != 0).any(axis=(1, 2))]
        return rows, self.p[rows, None, :2] + outlines(self.Sigma[rows, :2, :2])


@dataclass(frozen=True)
class Chart:
    """A solution of a mission.

    Attributes
    ----------
    name : of the mission.
    track : its poses, in the order of time.
    times : (n,) of them, s; None where they have none.
    points : by kind.
    bottom : (n, 3) points of the bottom below the vehicle, where it measured its height over it, m.
    plane : where its origin is on the Earth; None where no file says it.
    """

    name: str
    track: Points
    times: Array | None
    points: tuple[Points, ...]
    plane: LocalPlane | None
    bottom: Array = field(default_factory=lambda: np.zeros((0, 3)), repr=False)

    @property
    def way(self) -> Array:
        """(n,) distance travelled up to every pose, m."""
        return distance_along(self.track.p)

    @property
    def intervals(self) -> Index:
        """Poses at equal distances along the track, the first and the last among them: those with an ellipse."""
        way = self.way
        at = np.searchsorted(way, np.linspace(0, way[-1], ELLIPSES))
        return np.unique(np.append(at, len(way) - 1))

    @property
    def ellipses(self) -> Iterator[tuple[str, int, Array]]:
        """The 95 % ellipses: what each is of, its number and its outline (48, 2), m; of the track at its intervals."""
        for points, rows in ((self.track, self.intervals), *((p, np.arange(len(p.p))) for p in self.points)):
            rows, outlines_of_rows = points.ellipses(rows)
            for number, outline in zip(points.numbers[rows].tolist(), outlines_of_rows, strict=True):
                yield points.name, number, outline


def chart_of(
    values: Values, marginals: Marginals | None, report: MissionReport, elevations: Elevations | None = None
) -> Chart:
    """The chart of a solution.

    Parameters
    ----------
    values : poses ``x``, and any points of space.
    marginals : their covariances; what has none in them has none here.
    report : of the mission: its name, times and origin.
    elevations : of its landmarks, whose covariances take the aperture of the sonar into account.
    """
    stack = values.stack("x")
    times = report.vertex_times.get("x")
    order = np.argsort(stack.numbers if times is None else times, kind="stable")
    points = tuple(
        Points(NAMES.get(kind, kind), s.numbers, np.asarray(s.X), _covariances(values, marginals, kind, elevations))
        for kind, s in values.stacks.items()
        if s.manifold == R(3) and len(s)
    )
    Sigma = _covariances(values, marginals, "x", None)[order]
    p = np.asarray(stack.manifold.position(stack.X))[order]
    if "z" in report.unmeasured:
        p, Sigma[:, 2], Sigma[:, :, 2] = p[:, :2], np.nan, np.nan
    track = Points("pose", stack.numbers[order], p, Sigma)
    times = None if times is None else times[order]
    bottom = _bottom(track.p, times, report.soundings)
    return Chart(visible(Path(report.path).name or report.path), track, times, points, report.plane, bottom)


def _bottom(p: Array, times: Array | None, soundings: Array | None) -> Array:
    """Points (n, 3) at the depth of the vehicle plus its height over the bottom, at the times within the track."""
    if times is None or soundings is None:
        return np.zeros((0, 3))
    t, height = soundings[(soundings[:, 0] >= times[0]) & (soundings[:, 0] <= times[-1])].T
    below = np.column_stack([np.interp(t, times, axis) for axis in p.T])
    below[:, 2] += height
    return below


def _covariances(values: Values, marginals: Marginals | None, kind: str, elevations: Elevations | None) -> Array:
    """Covariances (n, 3, 3) of positions, nan where there are none."""
    Sigma = covariances(values, marginals, Kind(kind), "position")
    if marginals is not None and kind == "l" and elevations is not None:
        rows = values.stack(kind).index(Keys(kind, elevations.landmarks))
        Sigma[rows] = elevations.covariances(marginals)
    return Sigma
