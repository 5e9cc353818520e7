r"""Correlations of a set of variables, rho_ij = Sigma_ij / (sigma_i sigma_j): red is 1, white 0, blue -1."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nls.plot.axes import axes_or_new, figure_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from nls.covariance import Joint


def correlations(joint: Joint, axes: Axes | None = None) -> Figure:
    """The correlation matrix, with lines between the variables.

    Parameters
    ----------
    joint : of `nls.Marginals.joint`, or `EKF.joint`. A component of variance 0 has no correlations and stays white.
    axes : where; a new figure when omitted.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> from nls import Marginals, kinds
    >>> from nls.plot import correlations
    >>> (x,) = kinds("x")
    >>> world = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
    >>> figure = correlations(Marginals(world.graph, world.truth).joint(x[10:13], frame="world"))
    >>> [label.get_text() for label in figure.axes[0].get_xticklabels()]
    ['x10', 'x11', 'x12']
    """
    axes = axes_or_new(axes, (5.4, 4.6))
    sigma = np.sqrt(np.diagonal(joint.matrix))
    weight = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0)
    rho = joint.matrix * weight * weight[:, None]
    shades = axes.imshow(rho, cmap="RdBu_r", vmin=-1.0, vmax=1.0, interpolation="none")
    for part in joint.parts[1:]:
        axes.axhline(part.start - 0.5, color="0.6", linewidth=0.6)
        axes.axvline(part.start - 0.5, color="0.6", linewidth=0.6)
    # the names of 40 variables fit beside the matrix
    if len(joint.keys) <= 40:
        middle = [(part.start + part.stop - 1) / 2 for part in joint.parts]
        names = [f"{key!r}" for key in joint.keys]
        axes.set_xticks(middle, names, fontsize=8, rotation=90 if len(names) > 10 else 0)
        axes.set_yticks(middle, names, fontsize=8)
        axes.tick_params(length=0)
    axes.set_title("correlations")
    figure = figure_of(axes)
    figure.colorbar(shades, ax=axes, shrink=0.6, aspect=25, pad=0.02, ticks=[-1, -0.5, 0, 0.5, 1])
    return figure
