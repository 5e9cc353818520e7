"""The first few of some things, and how many more."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["SOME", "some"]

SOME = 5  # of a list that are named


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
