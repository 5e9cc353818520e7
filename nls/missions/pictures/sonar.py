"""Images and contacts of a sonar: by beam and range, as a fan, with the arcs of possible landmarks, and in space.

A contact of range r and azimuth az is one place in the fan, r (cos az, sin az), whatever its elevation. Seen from the
same pose the whole arc of elevations falls onto it. Seen from another pose it does not. There an arc is drawn from the
lower to the upper edge of the aperture. The landmark must lie where its other contacts cross it.

In space the sonar sees its frustum: the range window, the fan in azimuth and the aperture in elevation. All points of
the arc over the aperture, r (cos az cos el, sin az cos el, sin el), give the same image.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from factors.range_azimuth import RangeAzimuth
from models import SE3
from models.errors import GraphError
from models.sensors import ImagingSonar, cartesian, plane_projection, range_azimuth
from nls.plot.picture import add_lines, axes_or_new, figure_of
from nls.plot.style import ARC, CONTACT, ECHO, ESTIMATE, LANDMARK
from nls.plot.trajectory import space_box

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

    from factors.keys import Keys
    from models.algebra import Array
    from nls.values import Values

ALONG = 33  # points an arc is drawn through
RIMS = ((0,), (-1,), (slice(None), 0), (slice(None), -1))  # of a face: at the ends of the fan, of the aperture
CORNERS = ((0, 0), (0, -1), (-1, 0), (-1, -1))  # of the fan and of the aperture
DARKEST = -40.0  # dB below the strongest echo: a hundredth of its amplitude is black
SHADES: dict[str, Any] = {"cmap": "gray", "vmin": DARKEST, "vmax": 0.0}


def polar_image(image: Array, sonar: ImagingSonar, axes: Axes | None = None) -> Figure:
    """The image as the sonar delivers it: a column a beam, a row a range bin, near at the bottom.

    Parameters
    ----------
    image : (beams, bins) amplitudes.
    sonar : its fan and window.
    axes : where; a new figure when omitted.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> import numpy as np
    >>> from models.sensors import DIDSON_LOW
    >>> polar_image(np.zeros((48, 512)), DIDSON_LOW).axes[0].get_ylabel()
    'range [m]'
    """
    axes = axes_or_new(axes, (5, 5.5))
    half = np.degrees(sonar.fan) / 2
    extent = (-half, half, *sonar.window)
    shades = axes.imshow(_decibels(image, sonar).T, **SHADES, origin="lower", aspect="auto", extent=extent)
    axes.set(xlabel="azimuth [deg]", ylabel="range [m]")
    return _with_bar(axes, shades)


def fan_image(image: Array, sonar: ImagingSonar, axes: Axes | None = None) -> Figure:
    """The image as a map: every cell where it lies in the plane of the sonar, ahead upwards, starboard to the right.

    Parameters
    ----------
    image : (beams, bins) amplitudes.
    sonar : its fan and window.
    axes : where; a new figure when omitted.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> import numpy as np
    >>> from models.sensors import DIDSON_LOW
    >>> fan_image(np.zeros((48, 512)), DIDSON_LOW).axes[0].get_ylabel()
    'ahead [m]'
    """
    wide = 2 * np.sin(min(sonar.fan, np.pi) / 2)  # of the farthest range, which is the height
    # a fan is at most 5.5 inches wide
    side = 5.5 / max(wide, 1.0)
    axes = axes_or_new(axes, (side * wide + 2.5, side + 0.8))
    azimuth = np.linspace(-sonar.fan / 2, sonar.fan / 2, sonar.beams + 1)  # edges of the beams
    r = np.linspace(*sonar.window, sonar.bins + 1)
    ahead, starboard = r * np.cos(azimuth)[:, None], r * np.sin(azimuth)[:, None]
    shades = axes.pcolormesh(starboard, ahead, _decibels(image, sonar), **SHADES, rasterized=True)
    _as_map(axes)
    return _with_bar(axes, shades)


def arcs(contacts: RangeAzimuth, values: Values, pose: Keys, sonar: ImagingSonar, axes: Axes | None = None) -> Figure:
    """In the fan of one pose: its contacts, the landmarks, and each landmark's arc of another pose.

    Every landmark with a contact here has a contact of the pose farthest from here. That one is spread over the
    aperture, to the arc on which the landmark must lie. The arc is seen from here. An inset shows the longest one.

    Parameters
    ----------
    contacts : what the sonar measured, with a fixed offset or none.
    values : poses and landmarks.
    pose : one pose, ``x[17]``.
    sonar : its fan, window and aperture.
    axes : where, such as those of `fan_image`; a new figure when omitted.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    GraphError
        The pose has no contact.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls import kinds
    >>> (x,) = kinds("x")
    >>> mission = sim.hauv_floor(np.random.default_rng(0), legs=2, per_leg=8)
    >>> axes = arcs(mission.contacts, mission.truth, x[5], mission.sonar).axes[0]
    >>> [text.get_text() for text in axes.get_legend().get_texts()]
    ['measured here: range and azimuth', 'estimate', 'where it may be, says its farthest other contact']
    """
    of, target = contacts.keys[:2]
    own = np.flatnonzero(of.numbers == pose.numbers[0])
    if not len(own):
        raise GraphError(f"{pose!r} has no contact among {contacts!r}", [pose])
    _, X = values.gather(contacts)
    S = np.asarray(contacts.sensor_pose(SE3, X[0], *X[2:]))
    away = np.linalg.norm(SE3.position(S) - SE3.position(S[own[:1]]), axis=1)
    order = np.lexsort((away, target.numbers))
    last = np.append(target.numbers[order][1:] != target.numbers[order][:-1], True)  # of each landmark the farthest
    farthest = order[last]
    farthest = farthest[np.isin(target.numbers[farthest], target.numbers[own]) & (away[farthest] > 0)]

    from_here = SE3.inverse(S[own[:1]])
    elevation = np.linspace(-sonar.aperture / 2, sonar.aperture / 2, ALONG)
    repeated = np.repeat(farthest, ALONG)
    p = cartesian(np.column_stack([contacts.z[repeated], np.tile(elevation, len(farthest))]))[0]
    arc = plane_projection(SE3.act(from_here, SE3.act(S[repeated], p))).reshape(-1, ALONG, 2)
    landmark = plane_projection(SE3.act(from_here, X[1][own]))
    r, azimuth = contacts.z[own].T

    alone = axes is None
    axes = axes_or_new(axes, (6, 6))
    at = np.column_stack([r * np.sin(azimuth), r * np.cos(azimuth)])
    arc, landmark = arc[:, :, ::-1], landmark[:, ::-1]
    panels = [(axes, at, landmark, arc, 7)]
    if alone:
        edge = np.linspace(-sonar.fan / 2, sonar.fan / 2, ALONG)
        around, rim = np.append(edge, edge[::-1]), np.repeat(sonar.window, ALONG)  # near rim, then far rim
        edges = rim * np.sin(around), rim * np.cos(around)
        axes.fill(*edges, facecolor="none", edgecolor="0.7", linewidth=0.8)
        axes.set_xlim(1.6 * edges[0].min(), 1.6 * edges[0].max())
    if alone and len(farthest):
        longest = [int(np.argmax(np.linalg.norm(np.diff(arc, axis=1), axis=2).sum(axis=1)))]
        k = np.flatnonzero(target.numbers[own] == target.numbers[farthest[longest]])[:1]
        inset = axes.inset_axes((0.6, 0.03, 0.38, 0.38), xticks=[], yticks=[], aspect="equal", xmargin=0.3, ymargin=0.3)
        inset.set_title(f"{target[farthest[longest]]!r}, seen from {of[farthest[longest]]!r}, too", fontsize=8)
        panels.append((inset, at[k], landmark[k], arc[longest], 12))
    for panel, measured, estimated, possible, size in panels:
        label = "measured here: range and azimuth"
        panel.plot(*measured.T, "o", markerfacecolor="none", color=CONTACT, markersize=size, label=label)
        panel.plot(*estimated.T, "+", color=LANDMARK, markersize=size, label="estimate")
        label = "where it may be, says its farthest other contact"
        add_lines(panel, possible, color=ARC, linewidth=size / 5, label=label)
    for inset, *_ in panels[1:]:
        axes.indicate_inset_zoom(inset, edgecolor="0.3")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=5, fontsize=8)  # 40 points below the axes
    return _as_map(axes)


def frustum(
    sonar: ImagingSonar, pose: npt.ArrayLike | None = None, points: npt.ArrayLike = (), axes: Axes | None = None
) -> Figure:
    """The frustum of a sonar in a world with z down; points in it with their arcs of the same range and azimuth.

    Parameters
    ----------
    sonar : its fan, aperture and window.
    pose : (7,) of the sonar in the world, SE3; at the origin when omitted.
    points : (n, 3) of the world, m. What is not in view is gray.
    axes : where, with ``projection="3d"``; a new figure when omitted.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> from dataclasses import replace
    >>> from models.sensors import DIDSON_HIGH
    >>> from nls.plot import frustum
    >>> figure = frustum(replace(DIDSON_HIGH, window=(1.0, 6.0)), points=[[4.0, 0.5, 0.2], [4.0, 3.0, 0.0]])
    >>> [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    ['sonar', 'frustum', 'in view', 'same range and azimuth', 'place in the image, at elevation 0', 'out of view']
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    axes = axes_or_new(axes, (7, 5.5), projection="3d")
    T = SE3.identity(1) if pose is None else SE3.stack(np.atleast_2d(np.asarray(pose, dtype=float)))
    p = np.asarray(points, dtype=float).reshape(-1, 3)
    inside = sonar.sees(SE3.act(SE3.inverse(T), p)) if len(p) else np.zeros(0, dtype=bool)
    # an edge of the frustum is drawn through 25 points
    azimuth, elevation = (np.linspace(-a / 2, a / 2, 25) for a in (sonar.fan, sonar.aperture))
    near, far = sonar.window

    def placed(r: npt.ArrayLike, azimuth: npt.ArrayLike, elevation: npt.ArrayLike) -> Array:
        polar = np.stack(np.broadcast_arrays(r, azimuth, elevation), axis=-1)
        return np.asarray(SE3.act(T, cartesian(polar.reshape(-1, 3))[0])).reshape(polar.shape)

    front = placed(far, azimuth[:, None], elevation)  # (fan, aperture, 3)
    back = placed(near, azimuth[:, None], elevation)
    rims = [face[rim] for face in (front, back) for rim in RIMS]
    position = SE3.position(T)[0]
    rims += [np.stack([position, front[corner]]) for corner in CORNERS]
    sides = [np.concatenate([back[rim], front[rim][::-1]]) for rim in RIMS]
    axes.plot(*position[:, None], "o", color=ESTIMATE, markersize=7, label="sonar")
    axes.plot([], [], color=ESTIMATE, linewidth=1.0, label="frustum")
    faces = [*sides, np.concatenate([front[:, 0], front[::-1, -1]])]
    axes.add_collection3d(Poly3DCollection(faces, facecolors=ESTIMATE, alpha=0.10, linewidths=0))  # type: ignore[attr-defined]
    add_lines(axes, rims, color=ESTIMATE, linewidth=1.0)
    if inside.any():
        r, az = range_azimuth(SE3.act(SE3.inverse(T), p[inside]))[0].T
        arcs = placed(r[:, None], az[:, None], elevation)
        axes.plot(*p[inside].T, "o", color=LANDMARK, markersize=6, label="in view")
        add_lines(axes, list(arcs), color=ARC, linewidth=2.0, label="same range and azimuth")
        axes.plot(*placed(r, az, 0.0).T, "x", color=CONTACT, markersize=6, label="place in the image, at elevation 0")
    if not inside.all():
        axes.plot(*p[~inside].T, "o", color=ECHO, markersize=5, label="out of view")
    space_box(axes, np.concatenate([front.reshape(-1, 3), back.reshape(-1, 3), position[None], p]), down=True)
    axes.legend(loc="upper left", fontsize=9)
    return figure_of(axes)


def _decibels(image: npt.ArrayLike, sonar: ImagingSonar) -> Array:
    """Decibels of amplitudes below the largest; without any echo all are the darkest. Refuses images of others."""
    if np.shape(image) != (sonar.beams, sonar.bins):
        made = f"{sonar.name} makes ({sonar.beams}, {sonar.bins}): beams, bins"
        raise GraphError(f"an image of shape {np.shape(image)}; {made}")
    amplitude = np.asarray(image, dtype=float)
    largest = float(amplitude.max(initial=0.0)) or 1.0
    return np.asarray(20 * np.log10(np.maximum(amplitude / largest, 10 ** (DARKEST / 20))))


def _with_bar(axes: Axes, shades: ScalarMappable) -> Figure:
    figure = figure_of(axes)
    figure.colorbar(shades, ax=axes, label="dB below the strongest echo", extend="min", shrink=0.8)
    return figure


def _as_map(axes: Axes) -> Figure:
    axes.set(xlabel="starboard [m]", ylabel="ahead [m]")
    axes.set_aspect("equal")
    return figure_of(axes)
