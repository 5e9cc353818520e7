"""Batches of one kind put together into one: the inverse of taking parts of a batch."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from copy import copy
from typing import Any

import numpy as np

from factors.base import Factor, Model
from factors.keys import Keys
from factors.noise import SqrtInformation, square
from factors.robust import Robust
from models.algebra import Array

__all__ = ["alike", "batch_of", "grouped", "joined", "sort_of"]

OWN = ("keys", "_z", "_noise", "_model", "slots")  # what every batch has of its own, or follows from what it has


def joined(models: Sequence[Model]) -> list[Factor]:
    """The measurements of bound factors in as few batches as there are kinds of measurements.

    One batch of 1,000 is evaluated as fast as a few of one: where a graph grows measurement by measurement, its batches
    are joined now and then. Batches are of one kind where everything is equal but variables, z, noise, and what is
    given for each measurement.

    Parameters
    ----------
    models : factors bound to the spaces of their variables, ``values.gather(factor)[0]`` or ``factor.bind(...)``.

    Returns
    -------
    list of factors, in the order in which their kinds come first, their measurements in the order given.

    Examples
    --------
    >>> from factors import Diagonal, Isotropic, Range
    >>> from models import SE2, R
    >>> from nls import kinds
    >>> x, l = kinds("x", "l")
    >>> parts = [Range(x[0], l[0], 5.0, Isotropic(0.1)), Range(x[1], l[[0, 1]], [4.0, 3.0], Diagonal(range=0.2))]
    >>> whole, = joined([part.bind(SE2, R(2)) for part in parts])
    >>> whole, whole.z.ravel()
    (Range(x[0, 1, 1], l[0, 0, 1]), array([5., 4., 3.]))
    """
    return [group[0].factor if len(group) == 1 else batch_of(group) for group in grouped(models)]


def grouped(models: Sequence[Model]) -> list[list[Model]]:
    """Bound factors that `joined` makes one of each."""
    groups: dict[Hashable, list[Model]] = {}
    for model in models:
        groups.setdefault((model.manifolds, sort_of(model.factor)), []).append(model)
    return list(groups.values())


def alike(a: Model, b: Model) -> bool:
    """Whether two batches may be one."""
    return a.manifolds == b.manifolds and sort_of(a.factor) == sort_of(b.factor)


def sort_of(factor: Factor) -> Hashable:
    """All that batches have in common that may be one."""
    per = factor.per_measurement
    own = [(k, type(v) if k in per else _hashable(v)) for k, v in vars(factor).items() if k not in OWN]
    return type(factor), factor.kernel, tuple([keys.kind for keys in factor.keys]), tuple(own)


def _hashable(value: Any) -> Hashable:
    """Equal for equal values."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, tuple | list):
        return tuple(map(_hashable, value))
    return value if isinstance(value, Hashable) else id(value)


def batch_of(group: Sequence[Model]) -> Factor:
    """The batch of bound factors of one kind."""
    whole, kernel = copy(group[0].factor), group[0].factor.kernel
    whole.keys = tuple(_rows([m.factor.keys[slot] for m in group], group) for slot in range(len(whole.keys)))
    whole._z = np.concatenate([model.z for model in group])
    whole._z.setflags(write=False)
    noise = SqrtInformation(np.concatenate([_square(model) for model in group]))
    whole._noise = noise if kernel is None else Robust(noise, kernel)
    for name in whole.per_measurement:
        setattr(whole, name, _rows([getattr(model.factor, name) for model in group], group))
    return whole


def _rows(parts: Sequence[Any], group: Sequence[Model]) -> Any:
    """Keys or arrays below each other, one row a measurement; what is no such thing is shared by all."""
    if isinstance(parts[0], Keys):
        return Keys(parts[0].kind, np.concatenate([keys.numbers for keys in parts]))
    if isinstance(parts[0], np.ndarray):
        counts = [len(model.z) for model in group]
        stacks = [array if array.ndim > 1 else array[None] for array in parts]
        return np.concatenate([np.broadcast_to(p, (n, *p.shape[1:])) for p, n in zip(stacks, counts, strict=True)])
    return parts[0]


def _square(model: Model) -> Array:
    """The whiteners (n, m, m) of a batch."""
    W = square(model.W)
    return np.broadcast_to(W, (len(model.z), *W.shape[1:]))
