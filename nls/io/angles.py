"""Angles of a file that are more than a turn: they are read as they are, and said, for they may be degrees.

Bearings made in Python are looked at by `factors.sighting`.

Those of measurements are a warning, those of vertices, whose yaw may count its turns, a note.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from models.algebra import Array, Index

TURN = 6.3  # rad: 2 pi, also where it was rounded to two digits


def turns(angles_by_tag: Iterable[tuple[str, Index, Array]]) -> list[str]:
    """A note on angles of more than a turn: nothing, or one sentence.

    Parameters
    ----------
    angles_by_tag : by tag the lines (n,), counted from 0, and their angles (n, k), rad.

    Examples
    --------
    >>> (note,) = turns([("EDGE_SE2", np.array([7, 8]), np.array([[1.5], [90.0]]))])
    >>> print(*note.split("; "), sep="\\n")
    1 line has an angle of more than a turn, first on line 9 (EDGE_SE2): 90
    angles are radians: do they count turns, or are these degrees?
    """
    first: list[tuple[int, str, float]] = []
    count = 0
    for tag, lines, angles in angles_by_tag:
        beyond = np.flatnonzero((np.abs(angles) > TURN).any(axis=1))
        count += len(beyond)
        if len(beyond):
            k = beyond[np.argmin(lines[beyond])]
            first.append((int(lines[k]) + 1, tag, float(angles[k, np.argmax(np.abs(angles[k]))])))
    if not count:
        return []
    line, tag, angle = min(first)
    have = "1 line has" if count == 1 else f"{count} lines have"
    return [
        f"{have} an angle of more than a turn, first on line {line} ({tag}): {angle:g}; angles are radians: do they "
        "count turns, or are these degrees?"
    ]
