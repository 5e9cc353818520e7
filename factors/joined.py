"""Batches of one kind put together into one: the inverse of taking parts of a batch."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from copy import copy
from typing import Any

import numpy as np

from factors.base import Factor, Model
from factors.declared import OWN, attributes, factors_within, refuse_undeclared
from factors.keys import Keys
from factors.noise import Noise, SqrtInformation, square
from factors.robust import Robust
from factors.slices import below
from models.algebra import Array

__all__ = ["batch_of", "bound_batch", "form_of", "grouped", "joined", "joined_noise", "sort_of"]


def joined(models: Sequence[Model]) -> list[Factor]:
    """The measurements of bound factors in as few batches as there are kinds of measurements.

    One batch of 1,000 is evaluated as fast as a few of one. Where a graph grows measurement by measurement, its batches
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
    return [group[0].factor if len(group) == 1 else bound_batch(group) for group in grouped(models)]


def grouped(models: Sequence[Model]) -> list[list[Model]]:
    """Bound factors that `joined` makes one of each."""
    groups: dict[Hashable, list[Model]] = {}
    for model in models:
        groups.setdefault((model.manifolds, sort_of(model.factor)), []).append(model)
    return list(groups.values())


def sort_of(factor: Factor) -> Hashable:
    """Attributes that batches must share to be joined."""
    refuse_undeclared(factor)
    per = factor.per_measurement
    own = [(k, _rows(v) if k in per else _hashable(v)) for k, v in attributes(factor).items() if k not in OWN]
    return type(factor), factor.kernel, tuple([keys.kind for keys in factor.keys]), tuple(own)


def _rows(value: Any) -> Hashable:
    """Equal where `factors.slices.below` puts the rows of several batches together; else as `_hashable`."""
    if isinstance(value, tuple):
        return tuple(map(_rows, value))
    if isinstance(value, dict):
        return tuple((name, _rows(item)) for name, item in value.items())
    stacked = isinstance(value, Keys) or (isinstance(value, np.ndarray) and value.ndim > 0)
    return _hashable(type(value) if stacked else value)


def _hashable(value: Any) -> Hashable:
    """Equal for equal values; of a factor within another, for factors of one sort."""
    if isinstance(value, Factor):
        return sort_of(value)
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, tuple | list):
        return tuple(map(_hashable, value))
    return value if isinstance(value, Hashable) else id(value)


def bound_batch(group: Sequence[Model]) -> Factor:
    """The batch of bound factors of one sort."""
    factors = [model.factor for model in group]
    noise = joined_noise([factor.noise for factor in factors], [len(factor) for factor in factors])
    if noise is None:
        kernel, whiteners = factors[0].kernel, [square(model.W) for model in group]
        rows = [np.broadcast_to(W, (len(f), *W.shape[1:])) for W, f in zip(whiteners, factors, strict=True)]
        noise = SqrtInformation(np.concatenate(rows))
        noise = noise if kernel is None else Robust(noise, kernel)
    return batch_of(factors, [model.z for model in group], noise)


def batch_of(factors: Sequence[Factor], z: Sequence[Array], noise: Noise) -> Factor:
    """The batch of factors of one sort, see `sort_of`, with their measurements z (n, size) and the noise of all."""
    whole, counts = copy(factors[0]), [len(factor) for factor in factors]
    whole.keys = tuple(below(keys, counts) for keys in zip(*(factor.keys for factor in factors), strict=True))
    whole._z, whole._noise, whole._model = np.concatenate(z), noise, None
    whole._z.setflags(write=False)
    for name in whole.per_measurement:
        setattr(whole, name, below([getattr(factor, name) for factor in factors], counts))
    for name in factors_within(whole):
        setattr(whole, name, batch_of([getattr(factor, name) for factor in factors], z, noise))
    return whole


def joined_noise(noises: Sequence[Noise], counts: Sequence[int]) -> Noise | None:
    """The noise of batches of so many measurements; None where they are not of one type and shape.

    Examples
    --------
    >>> from factors import Isotropic
    >>> joined_noise([Isotropic(0.1), Isotropic([0.2, 0.3])], [1, 2]), joined_noise([Isotropic(0.1)] * 2, [1, 1])
    (Isotropic([0.1, 0.2, 0.3]), Isotropic(0.1))
    """
    first = noises[0]
    if len({id(noise) for noise in noises}) > 1 and len({form_of(noise) for noise in noises}) > 1:
        return None
    whole = copy(first)
    for name, value in vars(first).items():
        parts = [vars(noise)[name] for noise in noises]
        setattr(whole, name, joined_noise(parts, counts) if isinstance(value, Noise) else below(parts, counts))
    return whole


def form_of(value: Any) -> Hashable:
    """Types, names, and the shapes of what a measurement has."""
    if isinstance(value, np.ndarray):
        trailing: tuple[int, ...] = value.shape[1:]
        return trailing
    if isinstance(value, Noise):
        return type(value), form_of(vars(value))
    if isinstance(value, dict):
        return tuple((name, form_of(item)) for name, item in value.items())
    return _hashable(value)
