"""What a filter believes at a step: ellipses of pose and landmarks, and the cloud where it has particles.

Errors and ellipses that are too small to be seen are drawn larger, about the truth, and the legend says how much.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nls.covariance.ellipse import outlines
from nls.covariance.frames import axes as axes_of
from nls.covariance.frames import turned
from nls.filters.base import POSE, Filter
from nls.filters.fastslam import FastSLAM
from nls.plot.axes import axes_or_new, figure_of, legend_below
from nls.plot.ellipses import _outlines, magnification
from nls.plot.filters import BELOW
from nls.plot.style import ELLIPSE, ESTIMATE, LANDMARK, TRUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from factors.keys import Keys
    from models.algebra import Array
    from nls.values import Values

__all__ = ["belief"]

DOT = 3  # points: a particle
LARGE = 4.0  # times as large as the least that is seen: one of several ellipses may be much larger than the others


def belief(
    estimator: Filter, pose: Keys, truth: Values, axes: Axes | None = None, scale: float | None = None
) -> Figure:
    """The latest pose and the landmarks found so far with their 95 % ellipses, and the truth.

    Parameters
    ----------
    estimator : a filter after some steps, in the plane, with points for landmarks. Of `FastSLAM` the particles are
        drawn, too: a dot for the pose of each, and one for every landmark of each.
    pose : the latest pose, ``step.pose``.
    truth : poses ``x`` and landmarks.
    axes : where; a new figure when omitted.
    scale : errors and ellipses are drawn so many times as large; as many as they need to be seen when omitted.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls.filters import FastSLAM, steps
    >>> from nls.plot import belief
    >>> world = sim.subsea(np.random.default_rng(1), laps=1)
    >>> first, *_ = steps(world.graph, world.start)
    >>> particles = FastSLAM(50, rng=np.random.default_rng(0))
    >>> particles.start(first, world.start)
    >>> [text.get_text() for text in belief(particles, first.pose, world.truth).legends[0].get_texts()]
    ['truth', 'particles', 'pose, 95 %', 'landmarks, 95 %']
    """
    alone = axes is None
    axes = axes_or_new(axes, (6, 6))
    keys, L, P_landmarks = estimator.landmarks
    (X, P), poses = estimator.pose, truth.stack(POSE)
    J, _ = axes_of(pose, poses.manifold, X[None], None, "position")
    Sigma, path = turned(J, P[None]), np.asarray(poses.manifold.position(poses.X))
    if scale is None:
        spread = [np.sqrt(np.linalg.eigvalsh(P_i).max()) for P_i in (Sigma, P_landmarks) if len(P_i)]
        scale = magnification(LARGE * float(np.ptp(path, axis=0).max()), float(max(spread)))
    true, true_landmarks = poses.manifold.position(truth[pose]), truth[keys] if len(keys) else L

    def drawn(p: Array, q: Array) -> Array:
        """Places p where their error about the truth q is as many times as large as the ellipses."""
        return np.asarray(q + scale * (p - q))

    axes.plot(*path.T, color=BELOW, linewidth=5.0, zorder=0, label="truth")
    for stack in truth.stacks.values():
        if stack is not poses:
            axes.plot(*stack.X.T, "+", color=TRUE, markersize=9)
    if isinstance(estimator, FastSLAM):
        dots = {"linestyle": "none", "marker": ".", "markersize": DOT}
        cloud = drawn(poses.manifold.position(estimator.X), true)
        axes.plot(*cloud.T, color=ESTIMATE, alpha=0.5, label="particles", **dots)  # type: ignore[arg-type]
        if estimator.map is not None:
            clouds = drawn(estimator.map.L, true_landmarks).reshape(-1, 2)
            axes.plot(*clouds.T, color=LANDMARK, alpha=0.2, **dots)  # type: ignore[arg-type]
    place, places = drawn(poses.manifold.position(X[None]), true), drawn(L, true_landmarks)
    axes.plot(*place.T, "o", color=ESTIMATE, markersize=5)
    _outlines(axes, place, scale * outlines(Sigma), color=ELLIPSE, linewidth=1.2, label="pose, 95 %")
    if len(keys):
        style = {"color": LANDMARK, "linewidth": 1.2, "label": "landmarks, 95 %"}
        _outlines(axes, places, scale * outlines(P_landmarks), **style)
        axes.plot(*places.T, ".", color=LANDMARK, markersize=4)
        for key, at in zip(keys, true_landmarks, strict=True):
            axes.annotate(f"{key!r}", at, (6, 4), textcoords="offset points", color=LANDMARK, fontsize=8)
    axes.set(
        title=f"{pose!r}" + ("" if scale == 1 else f": errors and ellipses × {scale:g}"), xlabel="x [m]", ylabel="y [m]"
    )
    axes.set_aspect("equal", adjustable="datalim")
    figure, (handles, labels) = figure_of(axes), axes.get_legend_handles_labels()
    if alone:
        figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    else:
        legend_below(axes, handles, labels)
    return figure
