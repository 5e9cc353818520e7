"""Parts of a batch: which measurements an index means, and the rows of what a factor holds for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import Any

import numpy as np

from factors.declared import factors_within, refuse_undeclared
from factors.keys import Keys
from models.algebra import Array, Index
from models.errors import GraphError


def places(index: Any, n: int, name: str) -> Index:
    """Places (k,) in a batch of n that a whole number, a slice, an array of whole numbers or a mask (n,) means.

    Raises
    ------
    GraphError
        None of these, a mask of another length, or a place the batch does not have.

    Examples
    --------
    >>> places(-1, 3, "Range"), places(slice(1, None), 3, "Range"), places([True, False, True], 3, "Range")
    (array([2]), array([1, 2]), array([0, 2]))
    """
    if isinstance(index, slice):
        try:
            return np.arange(n)[index]
        except TypeError as error:
            raise GraphError(f"{name}: index {index}: {error}") from error
    try:
        array = np.asarray(index)
    except ValueError as error:
        raise GraphError(f"{name}: index {index!r:.60}: {error}") from error
    if array.dtype == bool and array.ndim == 1:
        if len(array) != n:
            raise GraphError(f"{name}: a mask of {len(array)} for {n} measurements; expected one entry for each")
        return np.flatnonzero(array)
    if array.ndim > 1 or (array.size and array.dtype.kind not in "iu"):
        raise GraphError(
            f"{name}: index {index!r:.60} has type {array.dtype} and shape {array.shape}; expected a whole number, a "
            "slice, an array of whole numbers or a mask"
        )
    array = np.atleast_1d(array)
    if (wrong := (array < -n) | (array >= n)).any():
        raise GraphError(f"{name}: there is no measurement {array[wrong][0]}; the batch has {n}, counted from 0")
    return np.where(array < 0, array + n, array).astype(np.intp)


def part(factor: Any, index: Index) -> Any:
    """A factor of the same kind with the measurements at some places (k,), see `Factor.__getitem__`."""
    refuse_undeclared(factor)
    n, model = len(factor), factor._model
    sizes = factor.sizes() if model is None else (model.space.size,)
    if (per_row := one_each(factor.z, n, sizes)) is None:
        raise factor._refusal(f"z of shape ({n},) may be {n} measurements or one of {n} numbers; give it as (n, size)")
    subset = copy(factor)
    subset.keys = tuple(k[index] for k in factor.keys)
    subset._z = rows(factor.z, index, n) if per_row else factor.z
    subset._noise = factor.noise.take(index, n)
    for name in factor.per_measurement:
        setattr(subset, name, rows(getattr(factor, name), index, n))
    for name, within in factors_within(factor).items():
        setattr(subset, name, within[index])
    subset._model = None if model is None else model.part(subset, index)
    return subset


def rows(value: Any, index: Index, n: int) -> Any:
    """The rows of keys and arrays with one for each of n measurements; what all share, and anything else, as it is."""

    def some(item: Any) -> Any:
        if isinstance(item, Keys):
            return item[index]
        if isinstance(item, np.ndarray) and item.ndim and len(item) == n:
            subset = item[index]
            subset.setflags(write=item.flags.writeable)
            return subset
        return item

    return changed(value, some)


def changed(value: Any, change: Callable[[Any], Any]) -> Any:
    """An attribute with other items, also those in a tuple or a table.

    Examples
    --------
    >>> changed(({"a": 1}, 2), lambda item: -item)
    ({'a': -1}, -2)
    """
    if isinstance(value, tuple):
        return tuple(changed(item, change) for item in value)
    if isinstance(value, dict):
        return {name: changed(item, change) for name, item in value.items()}
    return change(value)


def below(parts: Sequence[Any], counts: Sequence[int]) -> Any:
    """The inverse of `rows`: keys and arrays of several batches of so many measurements, one row a measurement.

    Rows that are all equal are one that all share; what is neither keys nor array is that of the first.

    Examples
    --------
    >>> below([np.array([0.1]), np.array([0.2, 0.3])], [1, 2]), below([np.array([0.1]), np.array([0.1])], [1, 2])
    (array([0.1, 0.2, 0.3]), array([0.1]))
    """
    first = parts[0]
    if isinstance(first, Keys):
        return Keys(first.kind, np.concatenate([keys.numbers for keys in parts]))
    if isinstance(first, tuple):
        return tuple(below(items, counts) for items in zip(*parts, strict=True))
    if isinstance(first, dict):
        return {name: below([part[name] for part in parts], counts) for name in first}
    if not isinstance(first, np.ndarray):
        return first
    stacks = [p if len(p) in (1, n) else p[None] for p, n in zip(parts, counts, strict=True)]
    if all(len(stack) == 1 for stack in stacks):
        together = np.concatenate(stacks)
        if (together == together[0]).all():
            return together[:1]
    full = [s if len(s) == n else np.broadcast_to(s, (n, *s.shape[1:])) for s, n in zip(stacks, counts, strict=True)]
    return np.concatenate(full)


def one_each(z: Array, n: int, sizes: tuple[int, ...]) -> bool | None:
    """Whether z has a row for each of n measurements, or is one that all share; None where it may be either.

    Parameters
    ----------
    z : as given: (n, size), (1, size), (size,), or (n,) where a measurement is one number.
    n : measurements.
    sizes : how many numbers a measurement may have, () for any.

    Examples
    --------
    >>> z = np.zeros(3)
    >>> one_each(z, 3, (1,)), one_each(z, 3, (2, 3)), one_each(z, 3, ()), one_each(z[:, None], 3, ())
    (True, False, None, True)
    """
    if z.ndim != 1 or len(z) != n or n < 2:
        return z.ndim > 0 and len(z) == n
    if not sizes or {1, n} <= set(sizes):
        return None
    return 1 in sizes
