"""A chart as KML, which Google Earth opens: a folder each for the track, the points of a kind, and the 95 % ellipses.

Longitude, latitude (deg, WGS 84) and altitude over the sea level (m), minus the depth, with the altitude mode absolute.
Ellipses lie on the surface, so that the sea floor hides none.

Source: OGC KML 2.3, 12-007r2, 2015.
"""

from __future__ import annotations

from collections.abc import Iterator
from xml.sax.saxutils import escape

import numpy as np

from nls.missions.charts.chart import Chart
from nls.missions.charts.geojson import positions

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
