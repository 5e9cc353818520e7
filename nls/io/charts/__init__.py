"""The solution of a mission for charts: GeoJSON, KML, a grid of depths, points, and their coordinates on the Earth."""

from nls.io.charts.chart import Chart, Points, chart_of
from nls.io.charts.crs import Projection, extra, projection
from nls.io.charts.geojson import geojson_text
from nls.io.charts.grid import depths_text, grid_text
from nls.io.charts.kml import kml_text
from nls.io.charts.ply import ply_text, points_text

__all__ = [
    "Chart",
    "Points",
    "Projection",
    "chart_of",
    "depths_text",
    "extra",
    "geojson_text",
    "grid_text",
    "kml_text",
    "ply_text",
    "points_text",
    "projection",
]
