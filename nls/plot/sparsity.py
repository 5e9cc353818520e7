"""Where the numbers are: A, H = A'A and R with H = R'R, with the names of factors and variables."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse as sp

from nls.linear import default_solver, factorize
from nls.linear.factorization import SingularSystemError
from nls.plot.style import SERIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

    from models.algebra import Array, Index
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
    from matplotlib.figure import Figure

    H = system.H.copy()
    H.eliminate_zeros()
    R, permutation, D = _triangle(system)
    R.eliminate_zeros()  # CHOLMOD pads its supernodes
    ordered = sp.csc_array((H if D is None else H + sp.diags_array(D))[permutation][:, permutation])

    figure = Figure(figsize=(10.5, 4.2), layout="constrained")
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
