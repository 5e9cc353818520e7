r"""Whether contacts of a sonar are wrong: the test after a plain solution.

    chi2 > its 97.5 % quantile,     max s > v q,     v = max(1, median s / median of chi2)

with s the squared whitened residuals of the n contacts, and q a quantile of chi2 of two numbers. One of n right
contacts is beyond it by chance with 0.1 %. v is the variance of unit weight by the median. Sigmas that are all too
small raise v and max s alike, wrong contacts raise the largest ones far more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from factors.base import Factor
from nls.analysis.chi_squared import chi2_gate
from nls.optimizers import Fit, Result

__all__ = ["misfit"]

UNLIKELY = 1e-3  # with which all contacts are right and one is beyond the bound


def misfit(result: Result, contacts: Sequence[Factor]) -> bool:
    """Whether an optimum says that some of its contacts are wrong.

    Parameters
    ----------
    result : of least squares, without robust kernels.
    contacts : factors of two numbers a measurement.

    Examples
    --------
    >>> import numpy as np
    >>> import sim
    >>> mission = sim.hauv_hull(np.random.default_rng(1), levels=2, per_level=13)
    >>> spoiled = sim.exchange_contacts(mission, 0.05, np.random.default_rng(2))
    >>> [misfit(m.graph.optimize(m.start), [m.contacts]) for m in (mission, spoiled)]
    [False, True]
    """
    s = np.concatenate([factor.chi2(result.values) for factor in contacts] or [np.zeros(0)])
    if not len(s) or result.fit is Fit.PLAUSIBLE:
        return False
    variance = max(1.0, float(np.median(s)) / chi2_gate(2, 0.5))
    return bool(s.max() > variance * chi2_gate(2, 1 - UNLIKELY / len(s)))
