r"""A grid of depths as ESRI ASCII: the median of the points in every cell, NODATA where there are none.

    column = floor((east - xllcorner) / cell),   row from the north

Corners lie on multiples of the cell, so that grids of several missions fit on each other.

Source: ESRI, "ASCII raster format", ArcGIS documentation.
"""

from __future__ import annotations

import numpy as np

from models.algebra import Array
from nls.missions.charts.chart import Chart
from nls.missions.charts.crs import Projection

CELLS = 100  # along the longer side, at most
NODATA = -9999.0


def depths_text(chart: Chart, projection: Projection | None = None) -> bytes:
    """The grid of the depths of a chart: of its landmarks, and of the bottom below the vehicle; it has one of them."""
    p = np.concatenate([*(points.p for points in chart.points if points.name == "landmark"), chart.bottom])
    east_north = p[:, [1, 0]] if projection is None else projection.east_north(p)
    return grid_text(east_north, p[:, 2])


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
