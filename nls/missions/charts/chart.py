r"""Charts of a solution: the track, landmarks and beacons, each with its covariance, and 95 % ellipses.

**Coordinates** of the plane: local, or a projection of the Earth by the package pyproj, an extra.

The zone of UTM is that of the origin, 6 deg wide; the exceptions off Norway and Svalbard have their EPSG numbers.

Source: D. W. Hager et al., "The universal grids", DMA technical manual 8358.2, 1989.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from factors.keys import Keys, Kind
from models import R
from models.algebra import Array, Index, Numbers, distance_along
from models.errors import OptionError
from models.geodesy import LocalPlane
from models.visible import visible
from nls.covariance import Marginals
from nls.covariance.frames import outlines
from nls.missions.determination import covariances
from nls.missions.folder.folder import MissionReport
from nls.missions.sonar.elevation import Elevations
from nls.values import Values

if TYPE_CHECKING:
    from pyproj import Transformer

DECIMALS = 10  # of a degree: 0.01 mm
MILLIMETERS = 4  # decimals of a meter: 0.1 mm
NAMES = {"l": "landmark", "b": "beacon"}  # of the kinds of points in a mission
ELLIPSES = 60  # along a track: as many as can be told apart


@dataclass(frozen=True)
class MapProjection:
    """Eastings and northings of points in the local frame.

    Attributes
    ----------
    name : ``local``, or ``EPSG:32632``.
    plane, transformer : of a projection of the Earth; None for ``local``.
    """

    name: str
    plane: LocalPlane | None = field(default=None, repr=False)
    transformer: Transformer | None = field(default=None, repr=False)

    def east_north(self, p: Array) -> Array:
        """Easting and northing (n, 2), m, of points (n, 2) or (n, 3) north and east of the origin."""
        if self.plane is None or self.transformer is None:
            return p[:, [1, 0]]
        lat, lon = self.plane.geodetic(p[:, :2])
        return np.column_stack(self.transformer.transform(lon, lat))


def projection(name: str, plane: LocalPlane | None) -> MapProjection:
    """The projection of a name.

    Parameters
    ----------
    name : ``local``: east and north of the origin; ``utm``: the zone of the origin, WGS 84; or ``EPSG:n``, a projected
        system in meters.
    plane : the origin; a projection needs one.

    Raises
    ------
    OptionError
        Another name, no origin, a system that is not projected or not in meters; pyproj is not installed.

    Examples
    --------
    >>> projection("utm", LocalPlane(54.1, 10.2)).name  # doctest: +SKIP
    'EPSG:32632'
    >>> projection("local", None).east_north(np.array([[3.0, 4.0, 5.0]]))
    array([[4., 3.]])
    """
    if name == "local":
        return MapProjection(name)
    if not (name == "utm" or re.fullmatch(r"(?i:epsg):\d{1,9}", name)):
        raise OptionError("--crs", name, "local, utm or EPSG:n, such as EPSG:25832")
    if plane is None:
        raise OptionError("--crs", name, "local: the mission has no origin.csv, which says where x = y = 0 is")
    try:
        from pyproj import CRS, Transformer
        from pyproj.exceptions import ProjError
    except ImportError as error:
        install = 'pip install "leadline[geo]"'
        needed = f"local: others need the package pyproj, which is missing; {install}"
        raise OptionError("--crs", name, needed) from error
    code = name.upper()
    if name == "utm":
        zone = int((plane.lon + 180) % 360 // 6) + 1
        code = f"EPSG:{32600 + zone if plane.lat >= 0 else 32700 + zone}"
    try:
        system = CRS.from_user_input(code)
        if not system.is_projected or any(axis.unit_conversion_factor != 1.0 for axis in system.axis_info):
            raise OptionError("--crs", name, f"a projected system in meters: {code} is {system.name}")
        made = MapProjection(code, plane, Transformer.from_crs("EPSG:4326", system, always_xy=True))
    except ProjError as error:
        raise OptionError("--crs", name, f"a system that pyproj knows: {error}") from error
    if not np.isfinite(made.east_north(np.zeros((1, 2)))).all():
        raise OptionError("--crs", name, f"a system that covers the origin {plane.lat!r}, {plane.lon!r}")
    return made


def extra(
    p: Array, plane: LocalPlane | None, projection: MapProjection | None = None, times: Array | None = None
) -> dict[str, Array]:
    """Columns of a table for positions (n, 3) in the local frame.

    Parameters
    ----------
    p : (n, 3) m.
    plane : the origin: lat_deg and lon_deg, where there is one.
    projection : easting_m and northing_m, where it is one of the Earth.
    times : (n,) time_s, s.
    """
    columns: dict[str, Array] = {} if times is None else {"time_s": times}
    if plane is not None:
        columns["lat_deg"], columns["lon_deg"] = (np.round(c, DECIMALS) for c in near(plane, p))
    if projection is not None and projection.plane is not None:
        columns["easting_m"], columns["northing_m"] = np.round(projection.east_north(p), MILLIMETERS).T
    return columns


def near(plane: LocalPlane, p: Array) -> tuple[Array, Array]:
    """Latitudes and longitudes (n,), deg, of points north and east; across 180 deg longitudes go on beyond it."""
    lat, lon = plane.geodetic(p[:, :2])
    middle = (plane.lon + 180) % 360 - 180
    return lat, middle + (lon - middle + 180) % 360 - 180


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
    def depths(self) -> Array:
        """(n, 3) points whose depth a map shows: landmarks, and the bottom below the vehicle, m."""
        return np.concatenate([*(points.p for points in self.points if points.name == "landmark"), self.bottom])

    @property
    def way(self) -> Array:
        """(n,) distance travelled up to every pose, m."""
        return distance_along(self.track.p)

    @property
    def intervals(self) -> Index:
        """Poses at equal distances along the track, the first and the last among them: those with an ellipse."""
        way = self.way
        return np.unique(np.append(np.searchsorted(way, np.linspace(0, way[-1], ELLIPSES)), len(way) - 1))

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
    name = visible(Path(report.path).name or report.path)
    return Chart(name, track, times, points, report.plane, bottom(values, report)[1])


def bottom(values: Values, report: MissionReport) -> tuple[Array, Array]:
    """Times (n,) within the track, s, and points (n, 3) at the depth of the vehicle plus its height over the bottom."""
    times, soundings, stack = report.vertex_times.get("x"), report.soundings, values.stack("x")
    if times is None or soundings is None:
        return np.zeros(0), np.zeros((0, 3))
    order = np.argsort(times, kind="stable")
    p, times = np.asarray(stack.manifold.position(stack.X))[order], times[order]
    t, height = soundings[(soundings[:, 0] >= times[0]) & (soundings[:, 0] <= times[-1])].T
    below = np.column_stack([np.interp(t, times, axis) for axis in p.T])
    below[:, 2] += height
    return t, below


def _covariances(values: Values, marginals: Marginals | None, kind: str, elevations: Elevations | None) -> Array:
    """Covariances (n, 3, 3) of positions, nan where there are none."""
    Sigma = covariances(values, marginals, Kind(kind), "position")
    if marginals is not None and kind == "l" and elevations is not None:
        rows = values.stack(kind).index(Keys(kind, elevations.landmarks))
        Sigma[rows] = elevations.covariances(marginals)
    return Sigma
