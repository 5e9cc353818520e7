r"""Latitude and longitude as meters north, east and down of an origin, and back: the local tangent plane of WGS 84.

    N = a / sqrt(1 - e^2 sin^2 lat),   e^2 = f (2 - f)
    X = ((N + h) cos lat cos lon, (N + h) cos lat sin lon, (N (1 - e^2) + h) sin lat)         Earth-centered
    p = R' (X - X_0),   R = the directions north, east and down at the origin                  north, east, down

Both ways are exact: the way back finds the latitude by Bowring's formula, iterated to rounding. Down is the direction
at the origin. So at sea level a point at the distance s lies s^2 / (2 a) below the plane: 8 cm after a kilometer.
Depths are kept apart. A position (lat, lon, depth) becomes north, east and the depth itself (`local`), the convention
of a chart.

Source: B. Hofmann-Wellenhof et al., GNSS, 2008, section 8.2; B. Bowring, "Transformation from spatial to geographical
coordinates", Survey Review 23(181), 1976.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import OptionError
from models.finite import numbers

__all__ = ["LocalPlane", "earth_centered", "geodetic"]

SEMI_MAJOR, FLATTENING = 6378137.0, 1 / 298.257223563  # m; WGS 84
E2 = FLATTENING * (2 - FLATTENING)
PASSES = 6  # of Bowring's formula: rounding after two below 10 km of height


def earth_centered(lat: npt.ArrayLike, lon: npt.ArrayLike, height: npt.ArrayLike = 0.0) -> Array:
    """Earth-centered coordinates (n, 3), m, of latitudes and longitudes, deg, and heights above the ellipsoid, m.

    Examples
    --------
    >>> earth_centered(0.0, [0.0, 90.0]).round(3) + 0.0
    array([[6378137.,       0.,       0.],
           [      0., 6378137.,       0.]])
    """
    phi, lam, h = np.broadcast_arrays(np.radians(lat), np.radians(lon), np.asarray(height, dtype=float))
    N = SEMI_MAJOR / np.sqrt(1 - E2 * np.sin(phi) ** 2)
    ring = (N + h) * np.cos(phi)
    return np.stack([ring * np.cos(lam), ring * np.sin(lam), (N * (1 - E2) + h) * np.sin(phi)], axis=-1)


def geodetic(X: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """Latitude and longitude, deg, and height, m, of Earth-centered coordinates (n, 3), m.

    Examples
    --------
    >>> lat, lon, height = geodetic(earth_centered(54.1, 10.2, -30.0))
    >>> round(float(lat), 9), round(float(lon), 9), round(float(height), 6)
    (54.1, 10.2, -30.0)
    """
    x, y, z = np.moveaxis(np.asarray(X, dtype=float), -1, 0)
    ring = np.hypot(x, y)
    polar = SEMI_MAJOR * (1 - FLATTENING)
    beta = np.arctan2(SEMI_MAJOR * z, polar * ring)  # reduced latitude
    for _ in range(PASSES):
        phi = np.arctan2(
            z + E2 / (1 - E2) * polar * np.sin(beta) ** 3,
            ring - E2 * SEMI_MAJOR * np.cos(beta) ** 3,
        )
        beta = np.arctan2((1 - FLATTENING) * np.sin(phi), np.cos(phi))
    N = SEMI_MAJOR / np.sqrt(1 - E2 * np.sin(phi) ** 2)
    # along the normal: no division by cos phi, which is 0 at a pole
    height = ring * np.cos(phi) + z * np.sin(phi) - SEMI_MAJOR**2 / N
    return np.degrees(phi), np.degrees(np.arctan2(y, x)), height


class LocalPlane:
    """The plane that touches WGS 84 at an origin: north, east and down of it.

    Parameters
    ----------
    lat, lon : of the origin, deg.

    Raises
    ------
    OptionError
        A latitude beyond a pole, a longitude beyond 360 deg, numbers that are not finite.

    Examples
    --------
    >>> plane = LocalPlane(54.1, 10.2)
    >>> p = plane.local([54.101, 54.1], [10.2, 10.202])
    >>> p.round(2)
    array([[111.31,   0.  ],
           [  0.  , 130.84]])
    >>> lat, lon = plane.geodetic(p)
    >>> lat.round(9), lon.round(9)
    (array([54.101, 54.1  ]), array([10.2  , 10.202]))
    """

    def __init__(self, lat: float, lon: float) -> None:
        lat, lon = (float(numbers("LocalPlane", name, value)) for name, value in (("lat", lat), ("lon", lon)))
        if not abs(lat) <= 90:
            raise OptionError("lat", lat, "degrees, -90 to 90")
        if not abs(lon) <= 360:
            raise OptionError("lon", lon, "degrees, -360 to 360")
        self.lat, self.lon = lat, lon
        phi, lam = np.radians(lat), np.radians(lon)
        s, c, sl, cl = np.sin(phi), np.cos(phi), np.sin(lam), np.cos(lam)
        self.X_0 = earth_centered(lat, lon)
        self.R = np.array([[-s * cl, -sl, -c * cl], [-s * sl, cl, -c * sl], [c, 0.0, -s]])

    def __repr__(self) -> str:
        return f"LocalPlane({self.lat!r}, {self.lon!r})"

    def local(self, lat: npt.ArrayLike, lon: npt.ArrayLike) -> Array:
        """Meters (n, 2) north and east of the origin, of points at sea level at these latitudes and longitudes, deg."""
        return np.asarray(((earth_centered(lat, lon) - self.X_0) @ self.R)[..., :2])

    def geodetic(self, p: npt.ArrayLike) -> tuple[Array, Array]:
        """Latitudes and longitudes, deg, of the points at sea level north and east (n, 2) of the origin, m.

        Raises
        ------
        OptionError
            A point further from the origin than the plane reaches, 1,000 km.
        """
        ne = np.asarray(p, dtype=float)
        if not (np.linalg.norm(ne, axis=-1) <= REACH).all():
            raise OptionError("p", ne.tolist() if ne.ndim < 2 else "a position", "within 1,000 km of the origin")
        down = np.zeros(ne.shape[:-1])
        for _ in range(PASSES):  # the point of the plane that is below or above it, at sea level
            lat, lon, height = geodetic(self.X_0 + np.concatenate([ne, down[..., None]], axis=-1) @ self.R.T)
            down = down + height
        return lat, lon


REACH = 1e6  # m
