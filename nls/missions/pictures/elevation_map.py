r"""How should I fly? One picture: what two views tell about the elevation of a point, for every kind of motion.

Each panel looks out through the aperture of the sonar at one range, as the pilot would: azimuth to the right, down is
down. Its color is the standard deviation of the elevation after a second view (`elevation_sigma`); gray says no
better than the aperture itself, aperture / sqrt(12), and white that the second view does not see the point.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from models import SE3
from models.errors import OptionError
from models.sensors import ImagingSonar, cartesian
from nls.missions.sonar.elevation import elevation_sigma
from nls.plot.picture import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from models.algebra import Array

NOTHING, UNSEEN = "#d4d4d4", "#ffffff"
BEST = 0.1  # of what the aperture says: the darkest shade


def motions(shift: float = 0.3, turn: float = np.radians(5.0)) -> dict[str, Array]:
    """The six simple motions of a sonar, SE3 (7,): by a distance, m, or an angle, rad.

    Examples
    --------
    >>> list(motions(0.5))
    ['surge 0.5 m', 'sway 0.5 m', 'heave 0.5 m', 'roll 5°', 'pitch 5°', 'yaw 5°']
    """
    names = ("surge", "sway", "heave", "roll", "pitch", "yaw")
    steps = np.diag([shift] * 3 + [turn] * 3)
    amounts = [f"{shift:g} m"] * 3 + [f"{np.degrees(turn):.3g}°"] * 3
    return {f"{name} {amount}": SE3.exp(step) for name, amount, step in zip(names, amounts, steps, strict=True)}


def elevation_map(
    sonar: ImagingSonar,
    flown: Mapping[str, npt.ArrayLike] | None = None,
    distance: float | None = None,
    motion_covariance: npt.ArrayLike | None = None,
) -> Figure:
    """Small multiples: how well the elevation is known after each of some motions.

    Parameters
    ----------
    sonar : its fan, aperture and sigmas.
    flown : motions of the sonar by name, SE3 (7,); 0.3 m or 5 deg along and about each axis when omitted.
    distance : of the points, m; the middle of the sonar's window when omitted.
    motion_covariance : (6, 6) of every motion; exactly known when omitted.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        A distance outside of the window; no motions.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from models.sensors import DIDSON_HIGH
    >>> from nls.missions.pictures.elevation_map import elevation_map
    >>> figure = elevation_map(replace(DIDSON_HIGH, window=(1.0, 6.0)))
    >>> [axes.get_title() for axes in figure.axes[:3]]
    ['surge 0.3 m', 'sway 0.3 m', 'heave 0.3 m']
    """
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm

    near, far = sonar.window
    r = (near + far) / 2 if distance is None else distance
    if not near <= r <= far:
        raise OptionError("distance", distance, f"a range in the window of the sonar, {near:g} to {far:g} m")
    flown = motions() if flown is None else flown
    if not flown:
        raise OptionError("flown", flown, "at least one motion")
    # 145 by 141 points in a panel
    azimuth = np.linspace(-sonar.fan / 2, sonar.fan / 2, 145)
    elevation = np.linspace(-sonar.aperture / 2, sonar.aperture / 2, 141)
    points = np.stack(np.broadcast_arrays(r, azimuth, elevation[:, None]), axis=-1)
    known = float(np.degrees(sonar.aperture / np.sqrt(12)))  # by the aperture, without any second view
    maps = {name: _after(sonar, G, points, motion_covariance) for name, G in flown.items()}
    medians = {name: float(np.median(s[~np.isnan(s)])) for name, s in maps.items() if not np.isnan(s).all()}
    good = [name for name, median in medians.items() if median < known]

    columns = min(3, len(flown))
    rows = -(-len(flown) // columns)
    figure = new_figure(3.3 * columns + 1.1, 2.2 * rows + 1.5)
    grid, norm = (np.degrees(azimuth), np.degrees(elevation)), LogNorm(BEST * known, known)
    shades = colormaps["viridis"].with_extremes(over=NOTHING, bad=UNSEEN)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for cell in axes.flat[len(flown) :]:
        cell.set_axis_off()
    for cell, (name, sigma) in zip(axes.flat, maps.items(), strict=False):
        finite = np.minimum(sigma, 100 * known)  # where nothing is learned it is infinite
        image = cell.pcolormesh(*grid, finite, cmap=shades, norm=norm, rasterized=True)
        cell.set_title(name, fontsize=11)
        if name not in medians:
            cell.text(0, 0, "out of sight", ha="center", va="center", fontsize=13)
            continue
        where = [np.degrees(np.median(points[~np.isnan(sigma)][:, k])) for k in (1, 2)]  # in what is seen
        learned = name in good
        verdict = {"s": f"±{medians[name]:.2g}°", "fontsize": 20} if learned else {"s": "nothing", "fontsize": 13}
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "boxstyle": "round,pad=0.15"}
        cell.text(*where, **verdict, ha="center", va="center", bbox=box if learned else None)
    axes[0, 0].invert_yaxis()  # down is down
    figure.suptitle(_answer(good), fontsize=14, fontweight="bold")
    figure.supylabel("elevation [deg], positive below", fontsize=10)
    figure.supxlabel(
        "azimuth [deg]\n\n"
        f"Elevation of a point at {r:g} m after a second view; the aperture alone says ±{known:.1f}°. "
        "White: out of sight of the second view.\n"
        f"Motions along and about the axes of the sonar: {sonar.name}, σ {1e3 * sonar.sigma_range:.1f} mm and "
        f"{np.degrees(sonar.sigma_azimuth):.2g}°.",
        fontsize=9,
    )
    bar = figure.colorbar(image, ax=axes, extend="max", label="elevation known to [deg]")
    ticks = [t for t in (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if BEST * known < t < 0.9 * known]
    bar.set_ticks([*ticks, known], labels=[f"{t:g}" for t in ticks] + ["aperture"], minor=False)
    bar.minorticks_off()
    return figure


def _after(sonar: ImagingSonar, G: npt.ArrayLike, points: Array, motion_covariance: npt.ArrayLike | None) -> Array:
    """Standard deviation of the elevation of points (..., 3), deg; nan where the second view does not see them."""
    p, _ = cartesian(points.reshape(-1, 3))
    visible = sonar.sees(SE3.act(SE3.inverse(SE3.stack(G)), p)).reshape(points.shape[:-1])
    sigma = np.degrees(elevation_sigma(G, points, sonar.noise_sigmas, motion_covariance))
    return np.where(visible, sigma, np.nan)


def _answer(good: list[str]) -> str:
    if not good:
        return "How should I fly? Not like this: the elevation stays unknown"
    return f"How should I fly? {', '.join(good)} {'show' if len(good) > 1 else 'shows'} the elevation"
