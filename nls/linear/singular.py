"""When a linear system counts as singular, and the errors that say so."""

from __future__ import annotations

import numpy as np

from models.algebra import Array

__all__ = ["NULL", "ROUNDING", "SINGULAR", "SingularSystemError", "UnsolvedSystemError", "refuse_vanishing"]

SINGULAR = 1e-13
"""A pivot below this, relative to the diagonal entry it came from (so whatever the units), is rounding: 13 of the 16
digits of the column were cancelled by the columns before it, and the direction counts as free."""


ROUNDING = 1e-14  # of the longest column of the variable: a column this short is zero

WEAK, NULL = 1e-6, 1e-9
"""Where the smallest pivot, relative to its diagonal entry, is below WEAK, rounding may hide a free direction; it is
one when |A v| is below NULL for a vector v of length 1, the columns of A scaled to length 1."""


class SingularSystemError(np.linalg.LinAlgError):
    """The system has no unique solution; optimizers turn this into `UnderconstrainedError` with names."""


class UnsolvedSystemError(SingularSystemError):
    """An iteration did not reach its tolerance: too near to singular for it, or given too few steps."""


def refuse_vanishing(pivots: Array, diagonal: Array) -> None:
    """Refuse pivots (n,) that are rounding beside the diagonal entries (n,) they came from.

    Raises
    ------
    SingularSystemError
        One of them is.
    """
    if not (pivots > SINGULAR * diagonal).all():
        raise SingularSystemError("a pivot of A'A vanishes")
