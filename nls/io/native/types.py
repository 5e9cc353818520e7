"""Possible contents of a native file, by name: nothing else is ever made from one."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

from factors.base import Factor
from factors.noise import Noise
from factors.robust import Kernel
from models.errors import OptionError
from models.options import did_you_mean
from models.sensors.camera import Camera

__all__ = ["register", "type_name", "type_named"]

F = TypeVar("F", bound=type[Factor])
_registered: dict[str, type] = {}


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


def type_named(name: object) -> type | str:
    """The class of a name, or why there is none."""
    known = {**_own(), **_registered}
    if isinstance(name, str) and name in known:
        return known[name]
    near = did_you_mean(name, known) if isinstance(name, str) else ""
    return f"{name!r:.60} is no class of this library and was not registered with `nls.io.register`{near}"


def type_name(thing: Any) -> str | None:
    """The name of the class of a thing; None where it has none."""
    known = {cls: name for name, cls in {**_own(), **_registered}.items()}
    return known.get(type(thing))
