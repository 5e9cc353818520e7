"""Factors, noises, kernels and cameras as plain data: dictionaries of numbers, texts, tuples and arrays, and back.

A thing is the arguments of its constructor, so that what is read is checked as what is made:

    Between(x[[0, 1]], x[[1, 2]], z, Diagonal(x=0.1, y=0.1, yaw=0.02))
    {"type": "Between", "i": {"kind": "x", "numbers": [0, 1]}, "j": {"kind": "x", "numbers": [1, 2]}, "z": z,
     "noise": {"type": "Diagonal", "x": [0.1], "y": [0.1], "yaw": [0.02]}, "convention": "log"}
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

import numpy as np

from factors.base import Factor
from factors.function import FunctionFactor
from factors.keys import Keys
from factors.noise import Noise
from models.errors import GraphError, LeadlineError
from nls.io.native.types import type_name, type_named

__all__ = ["MISMATCHES", "decoded", "encoded"]

Plain = Any  # None, a truth, a number, a text, an array, or tuples and dictionaries of them
MISMATCHES = (TypeError, ValueError, AttributeError, IndexError, KeyError, OverflowError)  # of arguments of any kind


def encoded(thing: Any) -> Plain:
    """The plain data of a factor, noise, kernel, camera or a number in them.

    Raises
    ------
    GraphError
        A class that no file holds, or a factor that would be read as another one.
    """
    if isinstance(thing, float | np.ndarray):
        if isinstance(thing, np.ndarray) and thing.dtype.kind not in "fib":
            raise GraphError(f"an array of {thing.dtype} is not held by a file; expected numbers")
        if not np.isfinite(thing).all():
            raise GraphError(f"{thing!r:.60} is not finite, and no file holds it")
    if thing is None or isinstance(thing, bool | int | float | str | np.ndarray):
        return thing
    if isinstance(thing, np.generic):
        return thing.item()
    if isinstance(thing, tuple | list):
        return tuple(map(encoded, thing))
    if isinstance(thing, Keys):
        return {"kind": thing.kind, "numbers": thing.numbers}
    name = type_name(thing)
    keys = thing.keys if isinstance(thing, Factor) else ()
    if isinstance(thing, FunctionFactor):
        raise GraphError(
            f"{thing!r} is made of a function, and a file holds no code; write a factor class and name it with "
            "nls.io.register",
            keys,
            thing.name,
        )
    if name is None:
        raise GraphError(
            f"{type(thing).__name__} is no class that a native file holds; name a factor class with nls.io.register",
            keys,
        )
    plain = {"type": name, **_arguments(thing)}
    if isinstance(thing, Factor):
        lost = _lost(thing, decoded(plain))
        if lost:
            raise GraphError(
                f"{thing!r} would be read without its {lost}: its constructor has no parameter of that name",
                keys,
                thing.name,
            )
    return plain


def _arguments(thing: Any) -> dict[str, Plain]:
    """The arguments with which its constructor makes it again."""
    own = {name.lstrip("_"): value for name, value in vars(thing).items()}
    keys = list(thing.keys) if isinstance(thing, Factor) else []
    arguments: dict[str, Plain] = {}
    for name, parameter in inspect.signature(type(thing)).parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            arguments |= {key: encoded(value) for key, value in own[name].items()}
        elif name in own:
            if own[name] is not None:
                arguments[name] = encoded(own[name])
        elif keys and parameter.default is parameter.empty:
            arguments[name] = encoded(keys.pop(0))
    if isinstance(thing, Factor):
        arguments |= {"z": thing.z, "noise": encoded(thing.noise)}
    return arguments


def decoded(plain: Plain) -> Any:
    """The thing of plain data.

    Raises
    ------
    GraphError
        Data of no such thing; or what its constructor raises.
    """
    if isinstance(plain, tuple):
        return tuple(map(decoded, plain))
    if not isinstance(plain, Mapping):
        return plain
    arguments = dict(plain)
    if "type" not in arguments:
        if set(arguments) != {"kind", "numbers"}:
            raise GraphError(f"expected a thing with a type, or a kind and its numbers, got {sorted(arguments)!r:.80}")
        return Keys(arguments["kind"], arguments["numbers"])
    cls = type_named(arguments.pop("type"))
    if isinstance(cls, str):
        raise GraphError(cls)
    arguments = {name: decoded(value) for name, value in arguments.items()}
    parameters = inspect.signature(cls).parameters
    own = [name for name in ("z", "noise") if issubclass(cls, Factor) and name in arguments and name not in parameters]
    beside = {name: arguments.pop(name) for name in own}
    try:
        made = cls(**arguments)
    except LeadlineError:
        raise
    except MISMATCHES as error:
        raise GraphError(f"{cls.__name__} cannot be made of {', '.join(arguments)}: {error}") from error
    if beside:  # what the constructor sets by itself, and a kernel or the rows of a part may have changed
        given = {"z": made.z, "noise": made.noise, "convention": made.convention, **beside}
        Factor.__init__(made, made.keys, **given)
    return made


def _lost(thing: Any, again: Any) -> str:
    """What differs between a factor and itself, written and read."""
    mine, other = ({k: v for k, v in vars(t).items() if k != "_model"} for t in (thing, again))
    return ", ".join(name.lstrip("_") for name, value in mine.items() if not _same(value, other.get(name)))


def _same(a: Any, b: Any) -> bool:
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return bool(a.dtype == b.dtype and np.array_equal(a, b))
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(_same(value, b[name]) for name, value in a.items())
    if isinstance(a, Noise):
        return _same(vars(a), vars(b))
    if isinstance(a, Factor):
        return not _lost(a, b)
    return bool(a == b)
