r"""Ellipses that hold a position with a given probability.

    {t + r U sqrt(s) (cos a, sin a)'},   Sigma = U diag(s) U',   r^2 = -2 ln(1 - p)

r^2 is the quantile p of a chi-square variable with two degrees of freedom, in closed form: 5.99 for 95 %. Sigma is the
covariance of x and y along the axes of the world. In space it is that of the projection on the x-y plane, and the
ellipse is drawn level, at the height of the position.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from factors.keys import Keys, Kind
from models.options import check_between, check_whole
from nls.covariance.frames import outlines
from nls.plot.picture import add_lines, axes_or_new, figure_of, legend_below, name_plane
from nls.plot.style import ELLIPSE, ESTIMATE, LANDMARK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from models.algebra import Array
    from nls.covariance import Marginals

MOST = 120  # of one kind, where it is not said how many


def ellipses(
    marginals: Marginals,
    axes: Axes | None = None,
    probability: float = 0.95,
    every: int | None = None,
    scale: float = 1.0,
    kind: Kind | None = None,
    north_up: bool = False,
) -> Figure:
    """Tracks and landmarks, their positions with the ellipses that hold them with the given probability.

    Parameters
    ----------
    marginals : covariances of a graph; what is held has no ellipse.
    axes : where, the ellipses alone; a new figure when omitted. With ``projection="3d"`` they lie level.
    probability : between 0 and 1.
    every : draw that of every so many variables of a kind, in the order of their numbers; as many as can be told apart
        (120) when omitted.
    scale : ellipses are drawn so many times as large as they are, and the legend says so.
    kind : only variables of this kind; all that have a place when omitted.
    north_up : draw x upwards and y to the right, as on a chart of a world whose axes are north and east.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        A probability that is not between 0 and 1, an `every` below 1, a scale that is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls import Marginals
    >>> from nls.plot import ellipses
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
    >>> ellipses(Marginals(world.graph, world.truth), every=4).axes[0].get_legend().get_texts()[0].get_text()
    '95 % ellipse of every 4th x'
    """
    check_between("probability", probability, 0, 1, "a number between 0 and 1, such as 0.95")
    check_between("scale", scale, 0, np.inf, "a number above 0")
    if every is not None:
        check_whole("every", every, 1)
    alone = axes is None
    axes = axes_or_new(axes, (6, 6))
    for stack in marginals.values.stacks.values():
        position = np.asarray(stack.manifold.position(stack.X))
        chosen = np.flatnonzero(np.array(marginals.status(stack.kind)) == "estimated")
        if not position.shape[1] or not len(chosen):
            continue
        if stack.kind in marginals.placeless if kind is None else stack.kind != kind.name:
            continue
        chosen = chosen[np.argsort(stack.numbers[chosen])]
        step = every or -(-len(chosen) // MOST)
        chosen = chosen[::step]
        Sigma = marginals.covariance(Keys(stack.kind, stack.numbers[chosen]), view="position")[:, :2, :2]
        if north_up:
            position, Sigma = position[:, [1, 0, *range(2, position.shape[1])]], Sigma[:, ::-1, ::-1]
        pose = stack.manifold.dim > position.shape[1]
        style = {"color": ELLIPSE if pose else LANDMARK, "linewidth": 0.8}
        label = f"{100 * probability:g} % ellipse of {every_nth(step)}{stack.kind}{larger(scale)}"
        draw_outlines(axes, position[chosen], scale * outlines(Sigma, probability), label=label, **style)
        if alone:
            path = position[np.argsort(stack.numbers), :2].T
            axes.plot(*path, "-" if pose else ".", markersize=3, linewidth=1.0, color=ESTIMATE if pose else LANDMARK)
    if alone:
        name_plane(axes, *("y [m]", "x [m]") * north_up)
        if axes.get_legend_handles_labels()[0]:
            legend_below(axes)
    return figure_of(axes)


def draw_outlines(axes: Axes, center: Array, around: Array, **style: Any) -> None:
    """Draw closed lines around centers, each in the plane of the track, and filled where the axes have no depth."""
    if axes.name == "3d":
        level = np.zeros((len(center), 1, 3))
        level[:, 0, : center.shape[1]] = center
        flat = np.concatenate([around, np.zeros((*around.shape[:2], 1))], axis=2)
        add_lines(axes, level + flat, **style)
    else:
        from matplotlib.collections import PolyCollection
        from matplotlib.colors import to_rgba

        color = style.pop("color")
        outlines = center[:, None, :2] + around
        shape = PolyCollection(list(outlines), facecolors=to_rgba(color, 0.18), edgecolors=to_rgba(color, 0.9), **style)
        axes.add_collection(shape)


def every_nth(step: int) -> str:
    if step == 1:
        return "every "
    ending = {1: "st", 2: "nd", 3: "rd"}.get(step % 10, "th") if step % 100 not in (11, 12, 13) else "th"
    return f"every {step}{ending} "


def visible_scale(marginals: Marginals, kinds: Sequence[str] | None = None) -> float:
    """1, 2, 5, 10, ...: how many times larger than they are ellipses must be drawn to be seen, of some kinds or all."""
    stacks = marginals.values.stacks
    names = kinds or [kind for kind in stacks if kind not in marginals.placeless]
    places = [(kind, stacks[kind].manifold.position(stacks[kind].X)) for kind in names]
    extent = max((float(np.ptp(t[:, :2], axis=0).max()) for _, t in places if t.shape[1]), default=0.0)
    largest = max((_largest(marginals, kind) for kind, t in places if t.shape[1]), default=0.0)
    return magnification(extent, largest)


def magnification(extent: float, largest: float) -> float:
    """1, 2, 5, 10, ...: how many times as large an ellipse is drawn to be seen, by width of the map and sigma, m."""
    # the largest ellipse is drawn at least 0.04 of the width of the map wide
    scale = 0.04 * extent / (2 * largest) if largest > 0 else 1.0
    steps = [m * 10.0**k for k in range(6) for m in (1, 2, 5)]
    return max((step for step in steps if step <= scale), default=1.0)


def larger(scale: float) -> str:
    """Words for a legend: that ellipses are drawn larger than they are."""
    return "" if scale == 1 else f", {scale:g} times as large"


def _largest(marginals: Marginals, kind: str) -> float:
    """The largest sigma of a position, m."""
    stack = marginals.values.stack(kind)
    known = np.flatnonzero(np.array(marginals.status(kind)) == "estimated")
    if not len(known):
        return 0.0
    Sigma = marginals.covariance(Keys(kind, stack.numbers[known]), view="position")[:, :2, :2]
    return float(np.sqrt(np.linalg.eigvalsh(Sigma).max()))
