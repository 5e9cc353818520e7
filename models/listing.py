"""Things in words: a number; a count and its noun; the first few of them, and how many more."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["SOME", "number", "several", "some"]

SOME = 5  # of a list that are named


def number(value: float) -> str:
    """A number with four digits, thousands set apart, and 0 for rounding.

    Examples
    --------
    >>> [number(value) for value in (45564.39, 42.2746, 2.1e-28)]
    ['45,564', '42.27', '0']
    """
    return "0" if abs(value) < 1e-9 else f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def several(count: int, noun: str) -> str:
    """A count and its noun.

    Examples
    --------
    >>> several(1, "pose"), several(1200, "line")
    ('1 pose', '1200 lines')
    """
    return f"{count} {noun}{'s' * (count != 1)}"


def some(items: Sequence[object], most: int = SOME, separator: str = ", ", noun: str = "") -> str:
    """The first few of some things, and how many more.

    Parameters
    ----------
    items : by their ``str``.
    most : so many are named.
    separator : between them; another one than a comma stands before the rest as well.
    noun : of the rest, with a blank before it: `` variables``.

    Examples
    --------
    >>> some(["x0", "x1", "x2", "x3"], 2)
    'x0, x1 and 2 more'
    >>> some(["x0: yaw", "x1: yaw"], 1, "; ", " variables")
    'x0: yaw; and 1 more variables'
    """
    named = separator.join(map(str, items[:most]))
    pause = " " if separator == ", " else separator
    return named + (f"{pause}and {len(items) - most} more{noun}" if len(items) > most else "")
