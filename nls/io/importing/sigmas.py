"""Columns of standard deviations: which numbers they may have, as the reader of a mission takes them."""

from __future__ import annotations

import numpy as np

from models.algebra import Array, Mask
from nls.io.mission.columns import MAY_BE_0
from nls.io.mission.table import BOUNDS, LARGEST, SMALLEST

__all__ = ["sigma_words", "sigmas_out"]

ZERO = (*MAY_BE_0, "sigma")  # a sigma of 0 in calibration.csv holds the value


def sigma_words(column: str) -> str:
    """The numbers that a column of standard deviations may have, in words.

    Examples
    --------
    >>> sigma_words("sigma_x_m"), sigma_words("scale")
    ('a standard deviation above 0, 1e-12 to 1e12', '0 or above, up to 1e12')
    """
    smallest, largest = BOUNDS
    if column in ZERO:
        return f"0 or above, up to {largest}"
    return f"a standard deviation above 0, {smallest} to {largest}"


def sigmas_out(column: str, numbers: Array | float) -> Mask:
    """Which numbers a column of standard deviations cannot have; none of another column.

    Examples
    --------
    >>> sigmas_out("sigma_x_m", np.array([-2.0, 0.0, 2.0])).tolist(), bool(sigmas_out("scale", 0.0))
    ([True, True, False], False)
    """
    is_sigma, smallest = column in ZERO or column.startswith("sigma"), 0.0 if column in ZERO else SMALLEST
    return np.asarray(is_sigma & ((numbers < smallest) | (numbers > LARGEST)))
