r"""What an imaging sonar sees of the world, in space: its frustum, and the arcs that it does not tell apart.

The frustum is the range window, the fan in azimuth and the aperture in elevation. A point in it is measured as a range
and an azimuth. All points of the arc over the aperture, r (cos az cos el, sin az cos el, sin el), give the same image.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from models import SE3
from models.sensors import ImagingSonar, cartesian, range_azimuth
from nls.plot.axes import axes_or_new, figure_of
from nls.plot.style import ARC, CONTACT, ECHO, ESTIMATE, LANDMARK
from nls.plot.trajectory import space_box

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from models.algebra import Array

__all__ = ["frustum"]

ALONG = 25  # points along an arc
FACE = 0.10  # opacity of a face
CORNERS = ((0, 0), (0, -1), (-1, 0), (-1, -1))  # of the fan and of the aperture


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
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection  # type: ignore[import-untyped]

    axes = axes_or_new(axes, (7, 5.5), projection="3d")
    T = SE3.identity(1) if pose is None else SE3.stack(np.atleast_2d(np.asarray(pose, dtype=float)))
    p = np.asarray(points, dtype=float).reshape(-1, 3)
    inside = sonar.sees(SE3.act(SE3.inverse(T), p)) if len(p) else np.zeros(0, dtype=bool)
    azimuth, elevation = (np.linspace(-a / 2, a / 2, ALONG) for a in (sonar.fan, sonar.aperture))
    near, far = sonar.window

    def placed(r: npt.ArrayLike, azimuth: npt.ArrayLike, elevation: npt.ArrayLike) -> Array:
        polar = np.stack(np.broadcast_arrays(r, azimuth, elevation), axis=-1)
        return np.asarray(SE3.act(T, cartesian(polar.reshape(-1, 3))[0])).reshape(polar.shape)

    front = placed(far, azimuth[:, None], elevation)  # (fan, aperture, 3)
    back = placed(near, azimuth[:, None], elevation)
    rims = [face[rim] for face in (front, back) for rim in ((0,), (-1,), (slice(None), 0), (slice(None), -1))]
    position = SE3.position(T)[0]
    rims += [np.stack([position, front[corner]]) for corner in CORNERS]
    sides = [
        np.concatenate([back[rim], front[rim][::-1]]) for rim in ((0,), (-1,), (slice(None), 0), (slice(None), -1))
    ]
    axes.plot(*position[:, None], "o", color=ESTIMATE, markersize=7, label="sonar")
    axes.plot([], [], color=ESTIMATE, linewidth=1.0, label="frustum")
    faces = [*sides, np.concatenate([front[:, 0], front[::-1, -1]])]
    axes.add_collection3d(Poly3DCollection(faces, facecolors=ESTIMATE, alpha=FACE, linewidths=0))  # type: ignore[attr-defined]
    axes.add_collection3d(Line3DCollection(rims, colors=ESTIMATE, linewidths=1.0))  # type: ignore[attr-defined]
    if inside.any():
        r, az = range_azimuth(SE3.act(SE3.inverse(T), p[inside]))[0].T
        arcs = placed(r[:, None], az[:, None], elevation)
        axes.plot(*p[inside].T, "o", color=LANDMARK, markersize=6, label="in view")
        axes.add_collection3d(Line3DCollection(list(arcs), colors=ARC, linewidths=2.0, label="same range and azimuth"))  # type: ignore[attr-defined]
        axes.plot(*placed(r, az, 0.0).T, "x", color=CONTACT, markersize=6, label="place in the image, at elevation 0")
    if not inside.all():
        axes.plot(*p[~inside].T, "o", color=ECHO, markersize=5, label="out of view")
    space_box(axes, np.concatenate([front.reshape(-1, 3), back.reshape(-1, 3), position[None], p]), down=True)
    axes.legend(loc="upper left", fontsize=9)
    return figure_of(axes)
