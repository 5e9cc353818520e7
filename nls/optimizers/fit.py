r"""Whether noise explains chi2: one rule for every result, of a file or a mission, plain or robust.

chi2 of d degrees of freedom has the expectation d. With sigmas that are right it is above its 97.5 % quantile in one
of forty cases. Beyond that bound something is wrong, if little: sigmas a few percent too small do it in a large graph.
Above twice its expectation sigmas are wrong by more than 40 %, or measurements contradict each other. Such a result
is implausible.

A robust kernel hides what does not fit: its sum of costs is small whatever was measured. So a robust optimum is judged
by plain chi2 of the measurements that the kernel believes, and by how many it ignores. A measurement is ignored where

    w(s) <= w(q) / 2,   q the 99 % quantile of chi2 of its numbers

with s its squared whitened residual and w the weight. Noise alone makes fewer than 1 % of these, by any kernel that
gives q a weight. A kernel is for a few wrong rows. Where it ignores more than a quarter of a table it silences a
sensor. Where nothing checks what is left no number tells whether it is right. Both are implausible.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from factors.base import Factor
from models.algebra import Array, Mask
from nls.sparse.pattern import measuring
from nls.values import Values

TWICE = 2.0  # chi2 per degree of freedom
SILENCED = 0.25  # part of a table that may be ignored


class Fit(Enum):
    """How well an optimum fits its measurements; the value says what that means."""

    PLAUSIBLE = "nothing speaks against the noise that was stated"
    HIGH = "more than noise explains"
    IMPLAUSIBLE = "wrong sigmas, outliers, or a point that is stationary but no minimum"


def fit(chi2: float, dof: int, robust: bool = False) -> Fit:
    """How well chi2 agrees with its degrees of freedom.

    Parameters
    ----------
    chi2 : at an optimum; with robust kernels of the measurements that they believe.
    dof : degrees of freedom; 0 or below counts as 1: chi2 is rounding then, or the point is no minimum.
    robust : whether a factor has a robust kernel: a robust optimum is none of chi2, so it may be somewhat higher.

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

    if gammaincc(dof / 2, chi2 / 2) >= 0.025:  # within its 97.5 % quantile
        return Fit.PLAUSIBLE
    return Fit.IMPLAUSIBLE if chi2 > TWICE * dof else Fit.HIGH


class Share(NamedTuple):
    """A table of measurements at a robust optimum, and how much of it the kernel ignored.

    Attributes
    ----------
    name : type of factor; odometry and loop closures are two tables.
    ignored, total : measurements.
    numbers : in the ignored ones.
    chi2 : squared whitened residuals of the others, without a kernel.
    """

    name: str
    ignored: int
    total: int
    numbers: int
    chi2: float

    def __str__(self) -> str:
        percent = f" ({100 * self.ignored / self.total:.3g} %)" if self.ignored else ""
        return f"{self.ignored} of {self.total} {self.name}{percent}"


def shares(factors: Sequence[Factor], values: Values, names: Sequence[str] = ()) -> tuple[Share, ...]:
    """How much of every table robust kernels ignored.

    Parameters
    ----------
    factors, values : of the optimum.
    names : of the table of every factor; its type when omitted.

    Examples
    --------
    >>> from factors import Cauchy, Isotropic, Prior, Robust
    >>> from factors.keys import kinds
    >>> from models import R
    >>> (x,) = kinds("x")
    >>> fixes = Prior(x[[0, 0, 0, 0]], [[0.0], [0.1], [0.0], [50.0]], Robust(Isotropic(0.1), Cauchy(1.0)))
    >>> print(*shares([fixes], Values({x: (R(1), [0.0])})))
    1 of 4 Prior (25 %)
    """
    tables: dict[tuple[str, bool], Share] = {}
    for factor, name in zip(factors, names or [factor.name for factor in factors], strict=True):
        out, s, numbers = _ignored(factor, values)
        first, last = factor.keys[0], factor.keys[-1]
        between = first.kind == last.kind and not factor.sequential
        jumps = np.abs(first.numbers - last.numbers) > 1 if between else np.zeros(len(s), dtype=bool)
        for closing in set(jumps.tolist()):
            rows, table = jumps == closing, tables.get((name, closing), Share(name, 0, 0, 0, 0.0))
            count, chi2 = int(out[rows].sum()), float(s[rows & ~out].sum())
            total, lost = table.total + int(rows.sum()), table.numbers + round(numbers * count)
            tables[name, closing] = Share(name, table.ignored + count, total, lost, table.chi2 + chi2)
    of = {True: "closures", False: "of odometry"}
    return tuple(
        share._replace(name=f"{name} {of[closing]}") if (name, not closing) in tables else share
        for (name, closing), share in tables.items()
    )


def _ignored(factor: Factor, values: Values) -> tuple[Mask, Array, float]:
    """Ignored measurements (n,), squared residuals (n,), and how many numbers one measurement has."""
    from scipy.special import chdtri

    s, kernel, model = factor.chi2(values), factor.kernel, values.gather(factor)[0]
    if kernel is None or factor.limit_only:
        return np.zeros(len(s), dtype=bool), s, 0.0
    bound = 0.5 * kernel.weight(np.array([chdtri(model.dim, 0.01)]))  # half the weight at the 99 % quantile q
    return kernel.weight(s) <= bound, s, int(measuring(model).sum()) / max(len(s), 1)
