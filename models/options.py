"""Values of options: one number or one whole number; no array, text, True or False. Names near a misspelled one."""

from __future__ import annotations

import math
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any

from models.errors import OptionError

__all__ = ["MAX_SIZE", "check_between", "check_positive", "check_whole", "did_you_mean", "is_number", "is_whole"]

MAX_SIZE = 1e30  # of a length, a sigma or a scale: squares of a product of two stay finite


def is_number(value: Any) -> bool:
    """Whether a value is one real number; nan and infinity are.

    Examples
    --------
    >>> import numpy as np
    >>> [is_number(value) for value in (1, 0.5, np.float64(0.5), True, "1", np.array([1.0]), None)]
    [True, True, True, False, False, False, False]
    """
    return isinstance(value, Real) and not isinstance(value, bool)


def is_whole(value: Any) -> bool:
    """Whether a value is one whole number by type.

    Examples
    --------
    >>> import numpy as np
    >>> [is_whole(value) for value in (1, np.int64(1), 1.0, True, "1", None)]
    [True, True, False, False, False, False]
    """
    return isinstance(value, Integral) and not isinstance(value, bool)


def check_whole(option: str, value: Any, least: int, expected: str = "") -> int:
    """A whole number of at least `least`.

    Raises
    ------
    OptionError
        Another value; ``expected`` describes the possible ones.
    """
    if not is_whole(value) or value < least:
        raise OptionError(option, value, expected or f"a whole number of at least {least}")
    return int(value)


def check_between(option: str, value: Any, low: float, high: float, expected: str) -> float:
    """A number above `low` and below `high`.

    Raises
    ------
    OptionError
        Another value; ``expected`` describes the possible ones.
    """
    if not is_number(value) or not low < value < high:
        raise OptionError(option, value, expected)
    return float(value)


def check_positive(**options: float) -> None:
    """Numbers above 0 whose squares and ratios are finite, by option.

    Raises
    ------
    OptionError
    """
    for option, value in options.items():
        check_between(option, value, 0, math.inf, "a number above 0")
        if not 1 / MAX_SIZE <= value <= MAX_SIZE:
            raise OptionError(option, value, f"a number from {1 / MAX_SIZE:g} to {MAX_SIZE:g}")


def did_you_mean(name: object, names: Iterable[str]) -> str:
    """``; did you mean 'solve'?`` where a name is nearly one of others; empty otherwise.

    Examples
    --------
    >>> did_you_mean("slove", ["solve", "explain"]), did_you_mean("x", ["solve"])
    ("; did you mean 'solve'?", '')
    """
    from difflib import get_close_matches

    known = list(names)
    near = [candidate for candidate in known if name and candidate.startswith(str(name))] or get_close_matches(
        str(name), known, 1
    )
    return f"; did you mean {near[0]!r}?" if near else ""
