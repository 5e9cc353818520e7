"""Attributes of a factor beside keys, z and noise: for each measurement, or for all, as its class declares."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from functools import cache
from typing import Any, TypeVar

import numpy as np

from factors.keys import Keys
from models.errors import GraphError

__all__ = ["OWN", "attributes", "copied", "declared", "factors_within", "refuse_undeclared"]

OWN = ("keys", "_z", "_noise", "_model", "slots")  # what every batch has of its own, or follows from what it has
BASE = {*OWN, "unmoved"}  # attributes that the base class knows how to cut
T = TypeVar("T")
MANY = 64  # items of a list or tuple, of another length than the batch, that are looked into


def declared(kind: type[Any], name: str) -> tuple[str, ...]:
    """The names in ``per_measurement`` or ``shared`` of a class and of all that it is derived from.

    Raises
    ------
    GraphError
        One name instead of a tuple of names: a comma is missing.
    """
    names: dict[str, None] = {}
    for base in reversed(kind.__mro__):
        own = vars(base).get(name, ())
        if isinstance(own, str):
            raise GraphError(f'{kind.__name__}: {name} = "{own}" is no tuple of names; write {name} = ("{own}",)')
        names.update(dict.fromkeys(own))
    return tuple(names)


def attributes(factor: Any) -> dict[str, Any]:
    """Everything that an object holds: its ``__dict__`` and its ``__slots__``."""
    held = dict(vars(factor)) if hasattr(factor, "__dict__") else {}
    return held | {name: getattr(factor, name) for name in _slots(type(factor).__mro__) if hasattr(factor, name)}


def copied(factor: T) -> T:
    """`copy.copy` of a factor: one that holds the same, not bound yet. Through pickling it takes ten times as long."""
    other = object.__new__(type(factor))
    for name, value in {**attributes(factor), "_model": None}.items():
        setattr(other, name, value)
    return other


@cache
def _slots(bases: tuple[type[Any], ...]) -> list[str]:
    """The names in ``__slots__`` of some classes."""
    stated = [vars(base).get("__slots__", ()) for base in bases]
    names = [name for slots in stated for name in ([slots] if isinstance(slots, str) else slots)]
    return [name for name in names if name not in ("__dict__", "__weakref__")]


def factors_within(factor: Any) -> dict[str, Any]:
    """The factors that a factor is made of, by attribute: they are cut and joined with it."""
    return {name: value for name, value in attributes(factor).items() if _is_factor(value)}


def _is_factor(value: object) -> bool:
    return hasattr(value, "per_measurement") and not isinstance(value, type)


def refuse_undeclared(factor: Any) -> None:
    """Refuse what may or may not be one row per measurement, before a part of the batch is taken or batches are joined.

    Raises
    ------
    GraphError
        A name that the factor does not have; an array, list or table of as many rows as there are measurements that is
        in neither ``per_measurement`` nor ``shared``; one in ``per_measurement`` that is no array.
    """
    held, n = attributes(factor), len(factor)
    for name in factor.per_measurement:
        if isinstance(getattr(type(factor), name, None), property) or not hasattr(factor, name):
            named = f"per_measurement names {name!r}, which is no attribute that can be set"
            message = f"{factor!r:.200}: {named}; expected one of {', '.join(sorted(held.keys() - BASE))}"
            raise GraphError(message, factor.keys, factor.name)
    if n < 2:
        return
    for name in held.keys() - BASE - {*factor.shared}:
        own = name in factor.per_measurement
        for place, rows in _with_rows(held[name], n, name):
            if own and isinstance(rows, np.ndarray | Keys):
                continue
            cure = "only arrays can be sliced; make it one with np.asarray"
            if not own:
                cure = f'its class does not say whether each measurement has one; write per_measurement = ("{name}",) '
                cure += f'for that, or shared = ("{name}",) where all measurements use all of it'
            subject = f"its attribute {place} is a {type(rows).__name__} of {n} for {n} measurements"
            raise GraphError(f"{factor!r:.200}: {subject}, and {cure}", factor.keys, factor.name)


def _with_rows(value: Any, n: int, place: str) -> Iterator[tuple[str, Any]]:
    """The things of first length n in an attribute, itself or what it holds, and their places."""
    if value is None or isinstance(value, str | bytes | int | float) or _is_factor(value):
        return  # a factor within is cut as a whole
    if isinstance(value, Mapping):
        if len(value) == n and set(value) == set(range(n)):
            yield place, value
        for key, item in value.items():
            yield from _with_rows(item, n, f"{place}[{key!r}]")
    elif isinstance(value, list | tuple):
        arrays = all(isinstance(item, np.ndarray | Keys) for item in value)
        if len(value) == n and not (arrays and isinstance(value, tuple)):
            yield place, value
        elif len(value) <= MANY:
            for k, item in enumerate(value):
                yield from _with_rows(item, n, f"{place}[{k}]")
    elif isinstance(value, Keys) or isinstance(getattr(value, "shape", None), tuple):  # an array, or a table
        if (len(value) if isinstance(value, Keys) else (*value.shape, 0)[0]) == n:
            yield place, value
    elif is_dataclass(value) or callable(getattr(value, "take", None)):  # as a noise model has it
        for name, item in attributes(value).items():
            yield from _with_rows(item, n, f"{place}.{name}")
