r"""Accuracy of positions as navigators state it: the circle that holds 50 % or 95 % of the errors, and 2DRMS.

    CEP(p) = the p-quantile of d_i,   d_i = sqrt(e_x^2 + e_y^2),   2DRMS = 2 sqrt(mean d_i^2)

Both are of the errors x and y, in the horizontal. CEP is counted, not computed from a normal distribution, so that
outliers count as they are. Of normal errors without correlation and of one sigma, CEP(0.5) is 1.177 sigma, CEP(0.95)
2.448 sigma and 2DRMS 2.828 sigma, which holds 98.2 %.

Source: F. van Diggelen, "GPS accuracy: lies, damn lies, and statistics", GPS World 9(1), 1998.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import GraphError
from models.finite import finite
from models.options import check_between

__all__ = ["cep", "drms2"]


def cep(errors: npt.ArrayLike, probability: float = 0.5) -> float:
    """Circular error probable: the radius about the truth that holds this share of the estimates, m.

    Parameters
    ----------
    errors : (n, 2) or (n, 3), m: x and y first, as `TrajectoryError.errors`. A third column does not count.
    probability : between 0 and 1; 0.95 gives R95.

    Raises
    ------
    GraphError
        Another shape, no errors, no finite numbers.
    OptionError
        A probability that is not between 0 and 1.

    Examples
    --------
    >>> cep([[3.0, 4.0], [0.0, 1.0], [0.0, 2.0]]), cep([[3.0, 4.0], [0.0, 1.0], [0.0, 2.0]], 0.95)
    (2.0, 4.7)
    """
    check_between("probability", probability, 0, 1, "a number between 0 and 1, such as 0.95")
    return float(np.quantile(_distances("cep", errors), probability))


def drms2(errors: npt.ArrayLike) -> float:
    """2DRMS, twice the root mean square of the horizontal errors, m; parameters and errors as for `cep`.

    Examples
    --------
    >>> drms2([[3.0, 4.0], [0.0, 5.0]])
    10.0
    """
    return float(2 * np.sqrt(np.mean(np.square(_distances("drms2", errors)))))


def _distances(who: str, errors: npt.ArrayLike) -> Array:
    """Horizontal distances (n,)."""
    e = np.atleast_2d(finite(who, "errors", errors))
    if e.ndim != 2 or e.shape[1] not in (2, 3) or not len(e):
        raise GraphError(f"{who}: errors have shape {e.shape}, expected (n, 2) or (n, 3): x and y, or x, y and z")
    return np.asarray(np.hypot(e[:, 0], e[:, 1]))
