"""Arrays that users give: numbers, all of them finite, or an error that says whose they are."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import GraphError

__all__ = ["finite"]


def finite(who: str, name: str, X: npt.ArrayLike) -> Array:
    """An array of finite numbers.

    Parameters
    ----------
    who, name : the function and its argument, for the message.
    X : anything.

    Raises
    ------
    GraphError
        No array of numbers, or one that is not finite.
    """
    try:
        array = np.asarray(X, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise GraphError(f"{who}: {name} is not an array of numbers: {error}") from error
    if not np.isfinite(array).all():
        raise GraphError(f"{who}: {name} has a number that is not finite, {array[~np.isfinite(array)][0]}")
    return array
