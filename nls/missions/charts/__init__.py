"""The solution of a mission for charts: GeoJSON, KML, a grid of depths, points, and their coordinates on the Earth."""

from nls.missions.charts.chart import Chart as Chart, Points as Points, chart_of as chart_of
from nls.missions.charts.chart import MapProjection as MapProjection, extra as extra, projection as projection
from nls.missions.charts.writers import depths_text as depths_text, geojson_text as geojson_text, grid_text as grid_text
from nls.missions.charts.writers import kml_text as kml_text, ply_text as ply_text, points_text as points_text
