r"""Matrices as pictures, with the names of factors and variables.

spy             where the numbers are: A, H = A'A and R with H = R'R
correlations    rho_ij = Sigma_ij / (sigma_i sigma_j): red is 1, white 0, blue -1
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse as sp

from nls.linear import default_solver, factorize
from nls.linear.factorization import SingularSystemError
from nls.plot.picture import axes_or_new, figure_of, new_figure
from nls.plot.style import SERIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

    from models.algebra import Array, Index
    from nls.covariance import Joint
    from nls.system import LinearSystem

LABELS = 40  # with more variables than this the axes count columns instead of naming them


def spy(system: LinearSystem) -> Figure:
    """A, H = A'A and R of a linear system side by side; fill-in of R is orange.

    Where something is free, H = A'A has no R. The third picture is then that of H + D, D the diagonal of H (1 where it
    is 0), which has the numbers of R in the same places; its title says so.

    Parameters
    ----------
    system : any `LinearSystem`, ``graph.linearize(values)``.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    EvaluationError
        Squares of weights or Jacobians overflow.
    """
    H = system.H.copy()
    H.eliminate_zeros()
    R, permutation, D = _triangle(system)
    R.eliminate_zeros()  # CHOLMOD pads its supernodes
    ordered = sp.csc_array((H if D is None else H + sp.diags_array(D))[permutation][:, permutation])

    figure = new_figure(10.5, 4.2)
    axes = figure.subplots(1, 3)
    _dots(axes[0], sp.coo_array(system.A), SERIES[0])
    axes[0].set_title(f"A: {system.A.shape[0]} x {system.A.shape[1]}, {system.A.nnz} numbers", fontsize=9)
    _dots(axes[1], sp.coo_array(H), SERIES[0])
    axes[1].set_title(f"H = A'A: {H.nnz} numbers", fontsize=9)
    _dots(axes[2], sp.coo_array(R), SERIES[1])
    _dots(axes[2], sp.coo_array(sp.triu(ordered)), SERIES[0])
    fill = R.nnz - sp.triu(ordered).nnz
    of_damped = "of H + D, as something is free" if D is not None else "reordered"
    axes[2].set_title(f"R, {of_damped}: {R.nnz} numbers, {max(fill, 0)} of them fill-in", fontsize=9)

    variable, _ = system.pattern.column_owner()
    names = [repr(system.pattern.key(v)) for v in variable.tolist()]
    for axis in (axes[0].xaxis, axes[1].xaxis, axes[1].yaxis):
        _name(axis, names)
    if sum(map(len, system.pattern.batches)) <= LABELS:
        _name(axes[0].yaxis, [row.rsplit(":", 1)[0] for row in system.rows])
    for axis in (axes[2].xaxis, axes[2].yaxis):
        _name(axis, [names[k] for k in permutation.tolist()])
    return figure


def _triangle(system: LinearSystem) -> tuple[sp.csc_array, Index, Array | None]:
    """R and its order p, H[p][:, p] = R'R, and None; those of H + diag(D) where H is singular, and D (n,)."""
    try:
        return *factorize(system).upper(), None
    except SingularSystemError:
        squares = np.square(system.column_norms)
        D = np.where(squares > 0, squares, 1.0)
        return *default_solver().analyze(system.pattern).factorize(system, D).upper(), D


def _name(axis: Axis, names: list[str]) -> None:
    """Names of rows or columns where they begin, as far as there is room for them; those of columns are upright."""
    from matplotlib.axis import XAxis

    first = [k for k, name in enumerate(names) if k == 0 or name != names[k - 1]]
    if len(first) <= LABELS:
        axis.set_ticks(first, [names[k] for k in first], fontsize=7, rotation=90 if isinstance(axis, XAxis) else 0)


def _dots(axes: Axes, M: sp.coo_array, color: str) -> None:
    size = float(np.clip(200 / max(*M.shape, 1), 0.3, 7))
    axes.plot(M.col, M.row, "s", color=color, markersize=size, markeredgewidth=0)
    axes.set_xlim(-0.5, max(M.shape[1], 1) - 0.5)
    axes.set_ylim(max(M.shape[0], 1) - 0.5, -0.5)
    if M.shape[0] == M.shape[1]:
        axes.set_aspect("equal")
    axes.xaxis.tick_top()


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
