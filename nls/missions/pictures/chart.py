"""A chart of a mission: depths in color and as contours, the track, a graticule, a scale bar and north."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nls.missions.charts.chart import Chart, near
from nls.plot.picture import figure_of, full_legend, new_figure
from nls.plot.style import ESTIMATE, LANDMARK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from models.algebra import Array

LONG = 8.0  # inches of the longer side of the map
CELLS = 30  # along the longer side, each with the mean of its depths
GAP = 0.25  # of the longer side: so wide a gap between depths stays white


def depth_chart(chart: Chart) -> Figure:
    """The chart from above, north up, east to the right.

    Depths are those of the landmarks and of the bottom below the vehicle, linear between them. The graticule has
    latitudes and longitudes where the mission has an origin on the Earth, and meters where it has none.

    Parameters
    ----------
    chart : of `nls.missions.charts.chart_of`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    places = [chart.track.p[:, :2], chart.depths[:, :2], *(points.p[:, :2] for points in chart.points)]
    p = np.concatenate(places)[:, ::-1]
    wide = max(float(np.ptp(p, axis=0).max()), 1e-3)
    middle, half = (p.min(axis=0) + p.max(axis=0)) / 2, np.maximum(np.ptp(p, axis=0) / 2 + 0.05 * wide, 0.3 * wide)
    low, high = middle - half, middle + half
    width, height = LONG * half / half.max() + [3.0, 1.4]
    figure = new_figure(width, height)
    axes = figure.add_subplot(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]), title=chart.name)
    _depths(axes, chart.depths, wide)
    axes.plot(*chart.track.p[:, 1::-1].T, color=ESTIMATE, linewidth=1.6, label="track")
    for points in chart.points:
        axes.plot(*points.p[:, 1::-1].T, "^" if points.name == "beacon" else ".", color=LANDMARK, label=points.name)
    _graticule(axes, chart, low, high)
    _scale_and_north(axes, wide, (p - low) / (high - low))
    full_legend(axes, 4)
    return figure


def _depths(axes: Axes, p: Array, wide: float) -> None:
    """Depths of points (n, 3) in color and as contours, linear between the means of the cells."""
    from matplotlib.tri import Triangulation

    cells, cell = np.unique(np.floor(p[:, :2] * CELLS / wide), axis=0, return_inverse=True)
    if np.linalg.matrix_rank(cells - cells[:1]) < 2:  # on one line, or none
        return
    count = np.bincount(cell.ravel())
    north, east, depth = (np.bincount(cell.ravel(), column) / count for column in p.T)
    triangulation = Triangulation(east, north)
    corners = np.stack([east, north], axis=1)[triangulation.triangles]
    gap = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    triangulation.set_mask(gap > max(GAP * wide, gap.min()))
    # numbers can be read on the darkest
    dark = float(depth.max() + 0.4 * np.ptp(depth))
    shades = axes.tricontourf(triangulation, depth, levels=12, cmap="Blues", vmax=dark)
    levels = np.asarray(shades.levels)
    lines = axes.tricontour(triangulation, depth, levels=levels, colors="0.2", linewidths=0.6)
    axes.clabel(lines, levels[::2], fmt="%g", fontsize=8)
    figure_of(axes).colorbar(shades, ax=axes, label="depth [m]", shrink=0.8).ax.invert_yaxis()


def _graticule(axes: Axes, chart: Chart, low: Array, high: Array) -> None:
    """Latitudes and longitudes in minutes; north and east in meters where the mission has no origin on the Earth."""
    from matplotlib.ticker import MaxNLocator

    axes.grid(color="0.5", linewidth=0.5, alpha=0.6)
    if chart.plane is None:
        axes.set(xlabel="y, east [m]", ylabel="x, north [m]")
        return
    north, east = (60 * degrees for degrees in near(chart.plane, np.stack([low, high])[:, ::-1]))
    for axis, k, ends, letters in ((axes.xaxis, 0, east, "WE"), (axes.yaxis, 1, north, "SN")):
        minutes = MaxNLocator(4, steps=[1, 2, 5, 10]).tick_values(*ends)
        minutes = minutes[(minutes > ends[0]) & (minutes < ends[1])].round(6)
        names = [f"{abs(m) // 60:.0f}°{abs(m) % 60:.6g}′{letters[int(m > 0)]}" for m in minutes]
        axis.set_ticks(np.interp(minutes, ends, [low[k], high[k]]), names)


def _scale_and_north(axes: Axes, wide: float, p: Array) -> None:
    """A bar of 1, 2 or 5 times a power of ten meters, at most a quarter of the map, and an arrow to the north.

    The bar is in the corner with the fewest of the points p (n, 2), parts of the map from the lower left; the arrow is
    in the upper right.
    """
    from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar  # type: ignore[import-untyped]

    power = 10.0 ** np.floor(np.log10(wide / 4))
    length = power * max(m for m in (1, 2, 5) if m * power <= wide / 4)
    corners = {"lower left": [0, 0], "lower right": [1, 0], "upper left": [0, 1]}
    corner = min(corners, key=lambda name: int((np.abs(p - corners[name]) < 0.3).all(axis=1).sum()))
    bar = AnchoredSizeBar(axes.transData, length, f"{length:g} m", corner, borderpad=1, size_vertical=length / 30)
    axes.add_artist(bar)
    arrow = {"arrowstyle": "-|>", "facecolor": "black", "mutation_scale": 20}
    axes.annotate("", (0.95, 0.95), (0.95, 0.86), xycoords="axes fraction", arrowprops=arrow)
    axes.text(0.95, 0.95, "N", transform=axes.transAxes, ha="center", fontsize=13)
