"""The message of a factor that is called without a noise: a type checker knows what is missing, a user is told."""

from __future__ import annotations

from functools import wraps
from inspect import signature
from typing import Any

from factors.noise import Noise
from models.errors import GraphError

__all__ = ["name_the_noise"]


def name_the_noise(cls: type[Any]) -> None:
    """Let the constructor of a class say how to give a noise that is missing, or z where the noise is in its place.

    Only a call that fails takes longer. A constructor that the class inherits does so already.
    """
    if "__init__" not in vars(cls):
        return
    init = cls.__init__

    @wraps(init)
    def checked(self: Any, *args: Any, **options: Any) -> None:
        try:
            init(self, *args, **options)
        except TypeError:
            parameters = signature(init).parameters
            required = [name for name, parameter in parameters.items() if parameter.default is parameter.empty]
            missing = [name for name in required[len(args) + 1 :] if name not in options]
            if missing != ["noise"] or not options.keys() <= parameters.keys():
                raise
            message = "its noise is missing; give one sigma for all numbers of z, such as noise=Isotropic(0.1), or one "
            message += "for each, noise=Diagonal([...])"
            if misplaced := [value for value in (*args, *options.values()) if isinstance(value, Noise)]:
                message = f"its z is missing; {misplaced[0]!r} stands in its place, and the noise comes after z"
            name = type(self).__name__
            raise GraphError(f"{name}: {message}", factor=name) from None

    cls.__init__ = checked
