r"""Whether noise explains chi2: one rule for every result, of a file or a mission, plain or robust.

chi2 of d degrees of freedom has the expectation d. With sigmas that are right it is above its 97.5 % quantile in one
of forty cases. Beyond that bound something is wrong, if little: sigmas a few percent too small do it in a large graph.
Above twice its expectation sigmas are wrong by more than 40 %, or measurements contradict each other. Such a result
is implausible.

A robust kernel makes every cost smaller. So a sum of costs above twice d is implausible as well. Below that it says
nothing, as its expectation is unknown.
"""

from __future__ import annotations

from enum import Enum

__all__ = ["Fit", "fit"]

TAIL = 0.025  # probability of a chi2 above the quantile
TWICE = 2.0  # chi2 per degree of freedom


class Fit(Enum):
    """How well an optimum fits its measurements; the value says what that means."""

    PLAUSIBLE = "nothing speaks against the noise that was stated"
    HIGH = "more than noise explains"
    IMPLAUSIBLE = "wrong sigmas, outliers, or a point that is stationary but no minimum"


def fit(chi2: float, dof: int, robust: bool = False) -> Fit:
    """How well chi2 agrees with its degrees of freedom.

    Parameters
    ----------
    chi2 : at an optimum; with robust kernels the sum of their costs.
    dof : degrees of freedom; 0 or below counts as 1: chi2 is rounding then, or the point is no minimum.
    robust : whether a factor has a robust kernel.

    Examples
    --------
    >>> [fit(chi2, 100).name for chi2 in (90.0, 140.0, 210.0)]
    ['PLAUSIBLE', 'HIGH', 'IMPLAUSIBLE']
    >>> [fit(chi2, 100, robust=True).name for chi2 in (140.0, 210.0)], fit(7.0, 3).name
    (['PLAUSIBLE', 'IMPLAUSIBLE'], 'PLAUSIBLE')
    """
    dof = max(dof, 1)
    if chi2 <= dof or (robust and chi2 <= TWICE * dof):  # most results: SciPy is not imported for these
        return Fit.PLAUSIBLE
    from scipy.special import gammaincc

    if gammaincc(dof / 2, chi2 / 2) >= TAIL:
        return Fit.PLAUSIBLE
    return Fit.IMPLAUSIBLE if chi2 > TWICE * dof else Fit.HIGH
