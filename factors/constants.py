"""Known numbers of a factor beside its measurements: offsets, lengths, rates."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.base import Factor
from factors.keys import Keys
from models.algebra import Array

__all__ = ["constant"]


def constant(factor: Factor, name: str, numbers: npt.ArrayLike) -> Array:
    """A read-only copy of known numbers.

    Parameters
    ----------
    factor, name : whose they are, and what they are called there.
    numbers : of any shape.

    Raises
    ------
    GraphError
        No array of numbers, or a variable.

    Examples
    --------
    >>> from factors import Isotropic, Prior
    >>> from nls import kinds
    >>> (x,) = kinds("x")
    >>> constant(Prior(x[0], [0.0, 0.0, 0.0], Isotropic(1.0)), "offset", [1, 2])
    array([1., 2.])
    """
    try:
        if isinstance(numbers, Keys):
            raise TypeError("a variable; here it must be known")
        array = np.array(numbers, dtype=float)
    except (TypeError, ValueError) as error:
        raise factor._refusal(f"its {name} is not an array of numbers: {error}") from error
    array.setflags(write=False)
    return array
