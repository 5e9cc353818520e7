"""A chart as GeoJSON, which QGIS and other programs for maps open: track, points and 95 % ellipses.

Longitude, latitude (deg, WGS 84) and height (m, minus the depth: sea level is taken to be the ellipsoid). Coordinates
have 10 decimals, 0.01 mm. Across 180 deg longitudes go on beyond it, so that no line goes around the Earth.

Source: H. Butler et al., "The GeoJSON format", RFC 7946, 2016.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from models.algebra import Array
from models.finite import finite_or_none
from models.geodesy import LocalPlane
from nls.missions.charts.chart import Chart
from nls.missions.charts.crs import DECIMALS, MILLIMETERS, near


def geojson_text(chart: Chart) -> bytes:
    """A FeatureCollection: the track (LineString), points (Point), ellipses (Polygon); `kind` says which.

    Parameters
    ----------
    chart : with an origin.

    Examples
    --------
    >>> from models.geodesy import LocalPlane
    >>> from nls.missions.charts import Points
    >>> track = Points("pose", np.arange(2), np.array([[0.0, 0, 5], [0, 100, 6]]), np.full((2, 3, 3), np.nan))
    >>> text = geojson_text(Chart("dive", track, None, (), LocalPlane(54.1, 10.2)))
    >>> json.loads(text)["features"][0]["geometry"]["coordinates"]
    [[10.2, 54.1, -5.0], [10.2015286193, 54.0999999903, -6.0]]
    """
    assert chart.plane is not None
    track, plane = chart.track, chart.plane
    features = [_feature("LineString", positions(plane, track.p), _track(chart))]
    for points in chart.points:
        sigmas = np.round(points.sigmas, MILLIMETERS).tolist()
        for place, number, sigma in zip(positions(plane, points.p), points.numbers.tolist(), sigmas, strict=True):
            about = {"kind": points.name, "number": number, "depth_m": -place[2], **_named(sigma)}
            features.append(_feature("Point", place, about))
    for name, number, ring in chart.ellipses:
        about = {"kind": "ellipse", "of": name, "number": number, "probability": 0.95}
        features.append(_feature("Polygon", [positions(plane, _counterclockwise(ring))], about))
    return (json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False) + "\n").encode()


def positions(plane: LocalPlane, p: Array) -> list[list[float]]:
    """Longitude, latitude and, of points of space, height of points (n, 2) or (n, 3) north, east and down."""
    lat, lon = near(plane, p)
    height = -p[:, 2:]
    degrees = np.round(np.column_stack([lon, lat]), DECIMALS)
    return np.column_stack([degrees, np.round(height, MILLIMETERS) + 0.0]).tolist()  # type: ignore[no-any-return]


def _track(chart: Chart) -> dict[str, Any]:
    """Properties of the track: lists have one entry per pose."""
    return {
        "kind": "track",
        "name": chart.name,
        "length_m": round(float(chart.way[-1]), MILLIMETERS),
        "i": chart.track.numbers.tolist(),
        **({} if chart.times is None else {"time_s": chart.times.tolist()}),
        **_named(np.round(chart.track.sigmas, MILLIMETERS).T.tolist()),
    }


def _named(sigma: list[Any]) -> dict[str, Any]:
    """Three standard deviations, or three lists of them, by name; null where there is none."""
    return dict(zip(("sigma_north_m", "sigma_east_m", "sigma_depth_m"), finite_or_none(sigma), strict=True))


def _counterclockwise(ring: Array) -> Array:
    """A closed outline (k, 2) north and east, counterclockwise on a map with north up, as the format asks for."""
    north, east = ring.T
    area = np.sum(east[:-1] * np.diff(north) - north[:-1] * np.diff(east))
    return ring if area > 0 else ring[::-1]


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}
