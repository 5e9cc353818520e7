"""The solution of a mission for charts: GeoJSON, KML, a grid of depths, points, and their coordinates on the Earth."""

from nls.missions.charts.chart import Chart as Chart, Points as Points, chart_of as chart_of
from nls.missions.charts.crs import Projection as Projection, extra as extra, projection as projection
from nls.missions.charts.geojson import geojson_text as geojson_text
from nls.missions.charts.grid import depths_text as depths_text, grid_text as grid_text
from nls.missions.charts.kml import kml_text as kml_text
from nls.missions.charts.ply import ply_text as ply_text, points_text as points_text
