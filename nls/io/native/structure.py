"""Factors, noises, kernels and cameras as plain data: dictionaries of numbers, texts, tuples and arrays, and back.

A thing is the arguments of its constructor, so that what is read is checked as what is made:

    Between(x[[0, 1]], x[[1, 2]], z, Diagonal(x=0.1, y=0.1, yaw=0.02))
    {"type": "Between", "i": {"kind": "x", "numbers": [0, 1]}, "j": {"kind": "x", "numbers": [1, 2]}, "z": z,
     "noise": {"type": "Diagonal", "x": [0.1], "y": [0.1], "yaw": [0.02]}, "convention": "log"}

Its classes have names, those of the library and those that were registered: nothing else is ever made from a file.
"""

import inspect
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, TypeVar

import numpy as np

from factors.base import Factor
from factors.function import FunctionFactor
from factors.keys import Keys
from factors.noise import Noise
from factors.robust import Kernel
from models.errors import GraphError, LeadlineError, OptionError
from models.options import did_you_mean
from models.sensors.camera import Camera

Plain = Any  # None, a truth, a number, a text, an array, or tuples and dictionaries of them
MISMATCHES = (TypeError, ValueError, AttributeError, IndexError, KeyError, OverflowError)  # of arguments of any kind
F = TypeVar("F", bound=type[Factor])
_registered: dict[str, type] = {}


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
        why = "is made of a function, and a file holds no code; write a factor class and name it with nls.io.register"
        raise GraphError(f"{thing!r} {why}", keys, thing.name)
    if name is None:
        why = "is no class that a native file holds; name a factor class with nls.io.register"
        raise GraphError(f"{type(thing).__name__} {why}", keys)
    plain = {"type": name, **_arguments(thing)}
    if isinstance(thing, Factor) and (lost := _lost(thing, decoded(plain))):
        why = f"would be read without its {lost}: its constructor has no parameter of that name"
        raise GraphError(f"{thing!r} {why}", keys, thing.name)
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
    """The attributes that differ between a factor and itself, written and read."""
    follows = ("_model", *getattr(type(thing), "cached", ()))
    mine, other = ({k: v for k, v in vars(t).items() if k not in follows} for t in (thing, again))
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


@cache
def _own() -> dict[str, type]:
    """The concrete classes of the library."""
    import factors
    from nls.incremental.marginal import MarginalPrior

    public = [getattr(factors, name) for name in factors.__all__]
    concrete = [thing for thing in public if inspect.isclass(thing) and not inspect.isabstract(thing)]
    classes = [c for c in concrete if issubclass(c, Factor | Noise | Kernel)]
    return {c.__name__: c for c in (*classes, Camera, MarginalPrior)}


def register(name: str) -> Callable[[F], F]:
    """Let native files hold a factor class of yours, under a name that stays when the class is renamed or moved.

    A file holds the parameters of its constructor: variables in the order of the slots, ``z``, ``noise``, and
    attributes of the same name. A program that reads the file registers the class, too.

    Parameters
    ----------
    name : in the files.

    Raises
    ------
    OptionError
        No name, or one that another class has.

    Examples
    --------
    >>> from factors import Prior
    >>> import nls.io
    >>> @nls.io.register("Tide gauge")
    ... class TideGauge(Prior):
    ...     "The height of a place."
    """
    if not isinstance(name, str) or not name.isprintable() or not name:
        raise OptionError("register(name)", name, "a name of printable letters")

    def registered(cls: F) -> F:
        other = {**_own(), **_registered}.get(name)
        if other is not None and (other.__module__, other.__qualname__) != (cls.__module__, cls.__qualname__):
            raise OptionError("register(name)", name, f"another name: {other.__module__}.{other.__qualname__} has it")
        if not (inspect.isclass(cls) and issubclass(cls, Factor)) or inspect.isabstract(cls):
            raise OptionError("register(...)", cls, "a factor class with its methods `space` and `predict`")
        _registered[name] = cls
        return cls

    return registered


def type_named(name: object) -> type:
    """The class of a name.

    Raises
    ------
    GraphError
        There is none.
    """
    known = {**_own(), **_registered}
    if isinstance(name, str) and name in known:
        return known[name]
    near = did_you_mean(name, known) if isinstance(name, str) else ""
    raise GraphError(f"{name!r:.60} is no class of this library and was not registered with `nls.io.register`{near}")


def type_name(thing: Any) -> str | None:
    """The name of the class of a thing; None where it has none."""
    return {cls: name for name, cls in {**_own(), **_registered}.items()}.get(type(thing))
