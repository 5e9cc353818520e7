"""chi2 and the update norm over the iterations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nls.plot.axes import axes_or_new, figure_of
from nls.plot.style import SERIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from nls.optimizers import Result


def convergence(result: Result, axes: Axes | None = None) -> Figure:
    """chi2 (left axis) and max |dx| (right axis) per iteration, logarithmic; chi2 that falls by less than 10 is linear.

    Parameters
    ----------
    result : of an optimization.
    axes : where; a new figure when omitted.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.ticker import MaxNLocator

    axes = axes_or_new(axes, (5, 4))
    number = [iteration.number for iteration in result.history]
    chi2 = np.array([iteration.chi2 for iteration in result.history])
    # a smaller range has no ticks on a logarithmic axis
    falls = bool((chi2 > 0).all()) and chi2.max() > 10 * chi2.min()
    # a smaller part cannot be read off the number itself
    last = chi2[-1] if np.ptp(chi2) < 1e-3 * chi2.max() else 0.0
    (axes.semilogy if falls else axes.plot)(number, chi2 - last, "o-", color=SERIES[0])
    axes.set_xlabel("iteration")
    axes.set_ylabel(f"chi2 - {last:.6g}" if last else "chi2", color=SERIES[0])  # a legend would cover the curves
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if len(number) > 1:
        twin = axes.twinx()
        twin.semilogy(number[1:], [iteration.update for iteration in result.history[1:]], "s--", color=SERIES[1])
        twin.set_ylabel("max |dx|", color=SERIES[1])
    axes.set_title(f"{result.status.name.lower().replace('_', ' ')} after {result.iterations} iterations")
    return figure_of(axes)
