"""The solution of a mission for charts: GeoJSON, KML, a grid of depths, points, and their coordinates on the Earth."""

from nls.missions.charts.chart import Chart, Points, chart_of
from nls.missions.charts.crs import Projection, extra, projection
from nls.missions.charts.geojson import geojson_text
from nls.missions.charts.grid import depths_text, grid_text
from nls.missions.charts.kml import kml_text
from nls.missions.charts.ply import ply_text, points_text

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
