"""Arrays that users give: numbers, all of them finite, or an error that says whose they are. Numbers for JSON."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import GraphError

__all__ = ["finite_or_none", "first_not_finite", "numbers"]


def numbers(who: str, name: str, X: npt.ArrayLike) -> Array:
    """An array of numbers, its own; parameters as for `finite`.

    Raises
    ------
    GraphError
        No array of numbers.
    """
    try:
        return np.array(X, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise GraphError(f"{who}: {name} is not an array of numbers: {error}") from error


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
    array = numbers(who, name, X)
    if not np.isfinite(array).all():
        raise GraphError(f"{who}: {name} has a number that is not finite, {array[~np.isfinite(array)][0]}")
    return array


def first_not_finite(stack: Array) -> int | None:
    """The first of a stack (n, ...) with a number that is not finite; None where all are.

    Examples
    --------
    >>> first_not_finite(np.array([[1.0, 2.0], [3.0, np.nan]])), first_not_finite(np.zeros((2, 3)))
    (1, None)
    """
    finite = np.isfinite(stack)
    return None if finite.all() else int(np.argmin(finite.reshape(len(stack), -1).all(axis=1)))


def finite_or_none(item: Any) -> Any:
    """A record of dicts, lists and numbers with None for every number that is not finite: JSON has no other word.

    Examples
    --------
    >>> finite_or_none({"sigmas": (0.1, np.inf), "name": "x1"})
    {'sigmas': [0.1, None], 'name': 'x1'}
    """
    if isinstance(item, dict):
        return {name: finite_or_none(value) for name, value in item.items()}
    if isinstance(item, list | tuple):
        return [finite_or_none(value) for value in item]
    return None if isinstance(item, float) and not math.isfinite(item) else item
