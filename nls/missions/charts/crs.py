"""Coordinates of the plane for a chart: local, or a projection of the Earth by the package pyproj, an extra.

The zone of UTM is that of the origin, 6 deg wide; the exceptions off Norway and Svalbard have their EPSG numbers.

Source: D. W. Hager et al., "The universal grids", DMA technical manual 8358.2, 1989.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from models.algebra import Array
from models.errors import OptionError
from models.geodesy import LocalPlane

if TYPE_CHECKING:
    from pyproj import Transformer

DECIMALS = 10  # of a degree: 0.01 mm
MILLIMETERS = 4  # decimals of a meter: 0.1 mm


@dataclass(frozen=True)
class Projection:
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


def projection(name: str, plane: LocalPlane | None) -> Projection:
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
        return Projection(name)
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
        made = Projection(code, plane, Transformer.from_crs("EPSG:4326", system, always_xy=True))
    except ProjError as error:
        raise OptionError("--crs", name, f"a system that pyproj knows: {error}") from error
    if not np.isfinite(made.east_north(np.zeros((1, 2)))).all():
        raise OptionError("--crs", name, f"a system that covers the origin {plane.lat!r}, {plane.lon!r}")
    return made


def extra(
    p: Array, plane: LocalPlane | None, projection: Projection | None = None, times: Array | None = None
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
