r"""The files of a chart: GeoJSON, KML, a grid of depths as ESRI ASCII, and points as PLY.

**GeoJSON**, which QGIS and other programs for maps open: track, points and 95 % ellipses.
Longitude, latitude (deg, WGS 84) and height (m, minus the depth: sea level is taken to be the ellipsoid). Coordinates
have 10 decimals, 0.01 mm. Across 180 deg longitudes go on beyond it, so that no line goes around the Earth.

**KML**, which Google Earth opens: a folder each for the track, the points of a kind, and the 95 % ellipses.
Longitude, latitude (deg, WGS 84) and altitude over the sea level (m), minus the depth, with the altitude mode absolute.
Ellipses lie on the surface, so that the sea floor hides none.

**A grid of depths**: the median of the points in every cell, NODATA where there are none.

    column = floor((east - xllcorner) / cell),   row from the north

Corners lie on multiples of the cell, so that grids of several missions fit on each other.

**PLY**, which CloudCompare, MeshLab and others open: points, binary, x, y and z as 64-bit floats.

Sources: H. Butler et al., "The GeoJSON format", RFC 7946, 2016; OGC KML 2.3, 12-007r2, 2015; ESRI, "ASCII raster
format", ArcGIS documentation; G. Turk, "The PLY polygon file format", 1994.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from models.algebra import Array, Numbers
from models.errors import GraphError
from models.finite import finite_or_none
from models.geodesy import LocalPlane
from models.listing import several
from nls.graph import FactorGraph
from nls.io.report import LoadReport
from nls.missions.charts.chart import DECIMALS, MILLIMETERS, Chart, MapProjection, near
from nls.values import Values


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


STYLES = (  # colors are alpha, blue, green, red
    ("track", "<LineStyle><color>ff6c4f0b</color><width>3</width></LineStyle>"),
    (
        "point",
        "<IconStyle><scale>0.6</scale><color>ff4f8f3f</color></IconStyle><LabelStyle><scale>0.7</scale></LabelStyle>",
    ),
    ("ellipse", "<LineStyle><color>ff803a8e</color></LineStyle><PolyStyle><color>40803a8e</color></PolyStyle>"),
)


def kml_text(chart: Chart) -> bytes:
    """A KML document of a chart with an origin.

    Examples
    --------
    >>> from models.geodesy import LocalPlane
    >>> from nls.missions.charts import Points
    >>> track = Points("pose", np.arange(2), np.array([[0.0, 0, 5], [0, 100, 6]]), np.full((2, 3, 3), np.nan))
    >>> text = kml_text(Chart("dive", track, None, (), LocalPlane(54.1, 10.2))).decode()
    >>> [line for line in text.splitlines() if "coordinates" in line]
    ['<coordinates>10.2,54.1,-5.0 10.2015286193,54.0999999903,-6.0</coordinates>']
    """
    return ("\n".join(_lines(chart)) + "\n").encode()


def _lines(chart: Chart) -> Iterator[str]:
    assert chart.plane is not None
    plane = chart.plane
    yield '<?xml version="1.0" encoding="UTF-8"?>'
    yield f'<kml xmlns="http://www.opengis.net/kml/2.2"><Document><name>{escape(chart.name)}</name>'
    for name, style in STYLES:
        yield f'<Style id="{name}">{style}</Style>'
    yield "<Placemark><name>track</name><styleUrl>#track</styleUrl><LineString><altitudeMode>absolute</altitudeMode>"
    yield _coordinates(positions(plane, chart.track.p))
    yield "</LineString></Placemark>"
    for points in chart.points:
        yield f"<Folder><name>{escape(points.name)}s</name>"
        for number, place, sigma in zip(points.numbers, positions(plane, points.p), points.sigmas, strict=True):
            sigmas = "; sigmas {:.3g} m north, {:.3g} m east, {:.3g} m down".format(*sigma)
            known = "" if np.isnan(sigma).any() else sigmas
            yield f"<Placemark><name>{escape(points.name)} {number}</name><styleUrl>#point</styleUrl>"
            yield f"<description>depth {-place[2]:.2f} m{known}</description>"
            yield "<Point><altitudeMode>absolute</altitudeMode>"
            yield _coordinates([place])
            yield "</Point></Placemark>"
        yield "</Folder>"
    yield "<Folder><name>95 % ellipses</name>"
    for name, number, ring in chart.ellipses:
        yield f"<Placemark><name>{escape(name)} {number}</name><styleUrl>#ellipse</styleUrl>"
        yield "<Polygon><altitudeMode>clampToGround</altitudeMode><outerBoundaryIs><LinearRing>"
        yield _coordinates(positions(plane, ring))
        yield "</LinearRing></outerBoundaryIs></Polygon></Placemark>"
    yield "</Folder></Document></kml>"


def _coordinates(places: list[list[float]]) -> str:
    return f"<coordinates>{' '.join(','.join(map(repr, place)) for place in places)}</coordinates>"


CELLS = 100  # along the longer side, at most
NODATA = -9999.0


def depths_text(chart: Chart, projection: MapProjection | None = None) -> bytes:
    """The grid of the depths of a chart: of its landmarks, and of the bottom below the vehicle; it has one of them."""
    p = chart.depths
    return grid_text(p[:, [1, 0]] if projection is None else projection.east_north(p), p[:, 2])


def cell_of(east_north: Array) -> float:
    """The side of a cell, m: the least of 1, 2, 5 times a power of ten with `CELLS` or fewer along the longer side."""
    longest = max(float(np.ptp(east_north, axis=0).max(initial=0.0)) / CELLS, 0.01)
    steps = [m * 10.0**k for k in range(-2, 9) for m in (1, 2, 5)]
    return next(step for step in steps if step >= longest * (1 - 1e-9))


def grid_text(east_north: Array, depth: Array) -> bytes:
    """The grid of points.

    Parameters
    ----------
    east_north : (n, 2) m, at least one.
    depth : (n,) m, positive down.

    Examples
    --------
    >>> text = grid_text(np.array([[0.5, 0.5], [0.6, 0.6], [99.5, 1.5]]), np.array([5.0, 7.0, 9.0]))
    >>> print(*text.decode().splitlines()[:6], sep="\\n")
    ncols 100
    nrows 2
    xllcorner 0.0
    yllcorner 0.0
    cellsize 1.0
    NODATA_value -9999.0
    """
    cell = cell_of(east_north)
    index = np.floor(east_north / cell).astype(np.int64)
    low = index.min(axis=0)
    columns, rows = (index.max(axis=0) - low + 1).tolist()
    flat = (rows - 1 - (index[:, 1] - low[1])) * columns + index[:, 0] - low[0]
    order = np.lexsort((depth, flat))
    filled, begin, count = np.unique(flat[order], return_index=True, return_counts=True)
    rising = depth[order]
    grid = np.full(rows * columns, NODATA)
    grid[filled] = (rising[begin + (count - 1) // 2] + rising[begin + count // 2]) / 2
    x, y = np.round(low * cell, 4).tolist()
    head = (
        f"ncols {columns}\nnrows {rows}\nxllcorner {x!r}\nyllcorner {y!r}\ncellsize {cell!r}\nNODATA_value {NODATA!r}\n"
    )
    body = "".join(" ".join(map(repr, row)) + "\n" for row in np.round(grid, 4).reshape(rows, columns).tolist())
    return (head + body).encode()


def points_text(chart: Chart, projection: MapProjection | None = None) -> bytes:
    """The points of a chart: north, east and down, or easting, northing and up in a projection of the Earth."""
    parts = [(points.name, points.numbers, points.p) for points in chart.points]
    if len(chart.bottom):
        parts.append(("bottom", np.arange(len(chart.bottom)), chart.bottom))
    if projection is None or projection.plane is None:
        return ply_text(parts, "x north, y east, z down, m")
    parts = [(name, numbers, np.column_stack([projection.east_north(p), -p[:, 2]])) for name, numbers, p in parts]
    return ply_text(parts, f"x easting, y northing of {projection.name}, z up, m")


def cloud_text(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None
) -> tuple[bytes, list[str]]:
    """Positions of all poses and points, those of the plane at z = 0, and what is left out.

    Raises
    ------
    GraphError
        Nothing has a position; more kinds than the 256 a file has numbers for.
    """
    stacks = [s for s in values.stacks.values() if s.manifold.position(s.X).shape[1] in (2, 3) and len(s)]
    if not stacks or len(stacks) > 256:
        expected = "a ply file holds poses and points, of 1 to 256 kinds"
        raise GraphError(f"{path}: {expected}; these values have {len(stacks)}")
    parts = [(stack.kind, stack.numbers, np.asarray(stack.manifold.position(stack.X))) for stack in stacks]
    left = len(values) - sum(map(len, stacks))
    notes = [f"a ply file holds positions: {several(left, 'variable')} without left out"] if left else []
    return ply_text(parts, "m"), notes


def ply_text(parts: Sequence[tuple[str, Numbers, Array]], axes: str, remark: str = "") -> bytes:
    """The bytes of a PLY file.

    Parameters
    ----------
    parts : points of one kind each: its name; (n,) the numbers of the variables, property ``number``, -1 from 2^31 on,
        which a file cannot hold; (n, 3) places, m, or (n, 2) at z = 0.
    axes, remark : of the places, and of the kinds, whose names are a comment and their numbers a property ``kind``.

    Examples
    --------
    >>> text = ply_text([("pose", np.array([7, 8]), np.eye(3)[:2])], "x north")
    >>> text.split(b"end_header\\n")[0].decode().splitlines()[3:5]
    ['comment kind: 0 pose', 'element vertex 2']
    """
    kinds = np.repeat(np.arange(len(parts)), [len(p) for _, _, p in parts])
    numbers = np.concatenate([numbers for _, numbers, _ in parts])
    names = ", ".join(f"{k} {name}" for k, (name, _, _) in enumerate(parts))
    head = ["ply", "format binary_little_endian 1.0", f"comment {axes}", f"comment kind: {names}{remark}"]
    head += [f"element vertex {len(kinds)}", *(f"property double {axis}" for axis in "xyz")]
    head += ["property uchar kind", "property int number", "end_header"]
    table = np.empty(len(kinds), dtype=[("p", "<f8", 3), ("kind", "u1"), ("number", "<i4")])
    table["p"] = np.concatenate([np.pad(p, ((0, 0), (0, 3 - p.shape[1]))) for _, _, p in parts])
    table["kind"] = kinds
    table["number"] = np.where(np.abs(numbers) < 2**31, numbers, -1)
    return ("\n".join(head) + "\n").encode("ascii", "backslashreplace") + table.tobytes()
