"""From the lines of one tag to arrays: ids, parameter ids, elements and matrices, each checked with its line.

Angles of more than a turn are read as they are, and said, for they may be degrees: of measurements in a warning, of
vertices, whose yaw may count its turns, in a note. Bearings made in Python are looked at by `factors.sighting`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from models import SE2, SE3
from models.algebra import Array, Index, Mask, Numbers
from models.manifolds.euler import GIMBAL_LOCK
from nls.io.records import Record
from nls.io.text import Text

__all__ = ["among", "turns"]
NONE = np.zeros(0, dtype=np.int64)
UNIT_ROUNDED = 1e-5  # how far the length of a unit quaternion written with six digits is off, at most
LINK_TYPES = range(100)  # RTAB-Map numbers them so
TURN = 6.3  # rad: 2 pi, also where it was rounded to two digits


class Lines(NamedTuple):
    """The lines of one record.

    Attributes
    ----------
    at : (n,) lines, counted from 0.
    ids : (n,) per slot, for a parameter its own; parameters : (n, k) ids.
    X : (n, size) elements.
    numbers : (n, columns) everything after the ids, also a type of a link.
    """

    record: Record
    at: Index
    ids: list[Numbers]
    parameters: Numbers
    X: Array
    numbers: Array

    def only(self, mask: Mask, record: Record) -> Lines:
        """Some of the lines, as those of a record."""
        ids = [i[mask] for i in self.ids]
        return Lines(record, self.at[mask], ids, self.parameters[mask], self.X[mask], self.numbers[mask])

    @property
    def link_types(self) -> Array:
        """(n, 1) types of links behind the matrices; (n, 0) where lines have none."""
        return self.numbers[:, self.record.element.width + len(self.record.places[0]) :]

    @property
    def rounded(self) -> Index:
        """Lines whose quaternion has a length that is not 1 up to the rounding of six digits."""
        if self.record.element.space is not SE3 or self.record.element.angles:
            return self.at[:0]
        off: Mask = np.abs(np.sqrt(np.square(self.X[:, 3:]).sum(axis=1)) - 1) > UNIT_ROUNDED
        return self.at[off]

    @property
    def angles(self) -> Array:
        """(n, k) the angles among the numbers of the element, rad."""
        element = self.record.element
        columns = [3, 4, 5] if element.angles else [2] if element.space is SE2 else []
        return self.numbers[:, columns]


def read_lines(text: Text, record: Record, at: Index) -> Lines:
    """The lines of a record; all of an edge between two poses may end in one number more, RTAB-Map's type of a link.

    Raises
    ------
    GraphFileError
        A count of numbers, a word or an element that cannot be right; an edge from a vertex to itself.
    """
    lead, width = record.lead, record.element.width
    last, typed = text.first.take(at + 1) - 1, record.slots == ("pose", "pose") and record.tag.startswith(b"EDGE_SE")
    typed = typed and bool((last - text.first.take(at) == record.words + 1).all())
    typed = typed and bool(np.isin(text.numbers(last, at, 1), LINK_TYPES).all())
    numbers = text.table(at, record.words + typed, record.columns, len(record.places[0]))[:, lead:]
    whole = text.whole(at, np.arange(1, 1 + lead)[:, None])
    ids, parameters = list(whole[: lead - record.parameters]), whole[lead - record.parameters :].T
    if record.element.angles:
        locked = np.abs(np.cos(numbers[:, 4])) < GIMBAL_LOCK
        text.refuse(locked, at, lambda _: "the pitch is +-90 deg (gimbal lock): roll and yaw are one number")
    X = record.element.decode(np.asfortranarray(numbers[:, :width]))
    if (invalid := record.element.space.invalid(X)) is not None:
        raise text.error(invalid[1], int(at[invalid[0]]))
    if len(ids) > 1 and record.slots[0] == record.slots[1]:
        text.refuse(ids[0] == ids[1], at, lambda k: f"the edge joins vertex {ids[0][k]} to itself")
    return Lines(record, at, ids, parameters, X, numbers)


def joined(parts: Iterable[Numbers]) -> Numbers:
    """Whole numbers of several arrays, or of none, in one."""
    return np.concatenate([NONE, *parts])


def different(numbers: Numbers) -> Numbers:
    """Whole numbers (n,), rising, each once: 55 us for 2,300 where `numpy.unique` takes 450.

    Examples
    --------
    >>> different(np.array([7, 2, 7])), different(np.array([], dtype=np.int64))
    (array([2, 7]), array([], dtype=int64))
    """
    rising: Numbers = np.sort(numbers)
    first = np.ones(len(rising), dtype=bool)
    first[1:] = rising[1:] != rising[:-1]
    return rising[first]


def by_number(text: Text, lines: list[Lines], noun: str) -> tuple[Numbers, Index]:
    """Ids of vertices or parameters, rising, and the place of each in these lines taken together.

    Raises
    ------
    GraphFileError
        An id given twice.
    """
    ids = joined([block.ids[0] for block in lines])
    if (ids[1:] > ids[:-1]).all():
        return ids, np.arange(len(ids))
    at = joined([block.at for block in lines])
    order = text.once(ids, at, f"{noun} ")
    return ids[order], order


def among(numbers: Numbers, known: Numbers) -> Mask:
    """Which numbers are among the known ones, which rise: 20 us for 460 where `numpy.isin` takes 90.

    Examples
    --------
    >>> among(np.array([1, 2, 7]), np.array([2, 3, 7])), among(np.array([1, 2]), np.array([2, 3]))
    (array([False,  True,  True]), array([False,  True]))
    """
    if not len(known):
        return np.zeros(numbers.shape, dtype=bool)
    first, last = known[0], known[-1]
    if int(last) - int(first) == len(known) - 1:
        return np.asarray((numbers >= first) & (numbers <= last))
    return np.asarray(known[np.minimum(np.searchsorted(known, numbers), len(known) - 1)] == numbers)


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
