"""What an option may be: one number or one whole number, of Python or NumPy; no array, text, True or False."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

__all__ = ["is_number", "is_whole"]


def is_number(value: Any) -> bool:
    """Whether it is one real number; nan and infinity are.

    Examples
    --------
    >>> import numpy as np
    >>> [is_number(value) for value in (1, 0.5, np.float64(0.5), True, "1", np.array([1.0]), None)]
    [True, True, True, False, False, False, False]
    """
    return isinstance(value, Real) and not isinstance(value, bool)


def is_whole(value: Any) -> bool:
    """Whether it is one whole number by type.

    Examples
    --------
    >>> import numpy as np
    >>> [is_whole(value) for value in (1, np.int64(1), 1.0, True, "1", None)]
    [True, True, False, False, False, False]
    """
    return isinstance(value, Integral) and not isinstance(value, bool)
