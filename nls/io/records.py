"""Records of graph text formats, one `Record` per tag, from which reader and writer follow; and the lines of one.

A line is a tag, the ids of the vertices concerned, the ids of parameters, and the numbers of one element of a space. A
measurement has the entries of a symmetric matrix, too, or of an upper square root. A new sensor is one more record.

Angles of more than a turn are read as they are, and said, for they may be degrees: of measurements in a warning, of
vertices, whose yaw may count its turns, in a note. Bearings made in Python are looked at by `factors.sighting`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np

from factors.base import Factor
from factors.between import Between
from factors.between_sensors import BetweenSensors
from factors.keys import Keys
from factors.noise import Noise
from factors.prior import Prior
from models import SE2, SE3, LieGroup, Manifold, R
from models.algebra import Array, Index, Mask, Numbers
from models.listing import several
from models.manifolds.euler import GIMBAL_LOCK, from_se3, to_se3
from nls.io.report import LoadReport
from nls.io.text import Text

KINDS = {"pose": "x", "point": "l", "mount": "o"}  # variables of vertices by what measurements use them as
NONE = np.zeros(0, dtype=np.int64)
UNIT_ROUNDED = 1e-5  # how far the length of a unit quaternion written with six digits is off, at most
LINK_TYPES = range(100)  # RTAB-Map numbers them so
ANGLES_FIRST = [3, 4, 5, 0, 1, 2]  # x y z roll pitch yaw from (roll, pitch, yaw, x, y, z), and back


@dataclass(frozen=True, eq=False)
class Element:
    """How an element of a space stands in a line; ``angles``: the rotation as roll, pitch and yaw."""

    space: LieGroup
    columns: str
    angles: bool = False

    @cached_property
    def width(self) -> int:
        """Numbers in the line."""
        return len(self.columns.split())

    def decode(self, numbers: Array) -> Array:
        """Stored form (n, size) of the numbers (n, width) of lines."""
        return to_se3(numbers[:, ANGLES_FIRST]) if self.angles else numbers

    def encode(self, X: Array) -> Array:
        """Numbers (n, width) of elements (n, size).

        Raises
        ------
        SingularGeometryError
            Roll and yaw at gimbal lock.
        """
        return from_se3(X)[:, ANGLES_FIRST] if self.angles else X


@dataclass(frozen=True, eq=False)
class Record:
    """One tag.

    Attributes
    ----------
    tag : the first word of its lines.
    group : SE2 or SE3, the poses of its dimension.
    slots : what the vertices are used as, in the order of the line: ``pose``, ``point``, ``mount``, ``either`` (pose or
        mount). A mount is a pose of a sensor on the vehicle that is a variable.
    element : the value of a vertex or parameter, the measured value.
    factor : the measurement; None for a vertex or parameter.
    parameters : ids of fixed poses of sensors, the offsets of the factor.
    used : False where the error of the measurement ignores its parameter.
    switched : whether it is a switch or its prior, or has a switch as its parameter, see `nls.io.ids`.
    foreign : whether it is a tag of other programs that is written only where lines were read with it.
    apart : whether its points have a numbering of their own.
    entries : places of the matrix entries, ``"11 12 22 33 13 23"``; the upper triangle row by row when omitted.
    """

    tag: bytes
    group: LieGroup
    slots: tuple[str, ...]
    element: Element
    factor: type[Factor] | None = None
    parameters: int = 0
    used: bool = True
    switched: bool = False
    foreign: bool = False
    apart: bool = False
    entries: str = ""

    @cached_property
    def places(self) -> tuple[Index, Index]:
        """Rows and columns of the matrix entries."""
        m, entries = 0 if self.factor is None else self.element.space.dim, self.entries.split()
        pairs = [(int(p[0]) - 1, int(p[1]) - 1) for p in entries] or [*combinations_with_replacement(range(m), 2)]
        rows, columns = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
        return rows, columns

    @cached_property
    def lead(self) -> int:
        """Numbers of a line before those of the element."""
        return (len(self.slots) or 1) + self.parameters

    @cached_property
    def words(self) -> int:
        """Words of a line after its tag."""
        return self.lead + self.element.width + len(self.places[0])

    @cached_property
    def columns(self) -> str:
        """The numbers after the tag, in words."""
        names = ["id"] if self.factor is None else ["i", "j"][: len(self.slots)]
        if "point" in self.slots[1:] or "mount" in self.slots:
            names = [f"{slot}{'_j' if k == 1 and slot == 'pose' else ''}" for k, slot in enumerate(self.slots)]
        names += [[], ["switch" if self.switched else "parameter"], ["parameter_i", "parameter_j"]][self.parameters]
        n = len(self.places[0])
        return " ".join([*names, self.element.columns]) + (f" and {n} entr{'ies' if n > 1 else 'y'}" if n else "")

    def build(self, keys: list[Keys], z: Array, noise: Noise, offsets: list[Array], convention: str) -> Factor:
        """The factor of lines with these variables, values and offsets."""
        options: dict[str, object] = {}
        if self.factor in (Between, BetweenSensors, Prior):
            options["convention"] = convention
        if "mount" in self.slots:
            options["offset"] = keys.pop()
        elif self.parameters and self.used:
            options["offset"] = offsets[0] if len(offsets) == 1 else tuple(offsets)
        assert self.factor is not None
        return self.factor(*keys, z, noise, **options)  # type: ignore[arg-type, call-arg]

    def holds(self, factor: Factor, manifolds: tuple[Manifold, ...], offsets: int) -> bool:
        """Whether its lines can say this factor, bound to these spaces, with so many fixed offsets."""
        return (
            type(factor) is self.factor
            and tuple(spaces_of(self.group)[slot] for slot in self.slots) == manifolds
            and (self.parameters if self.used else 0) == offsets
            and getattr(factor, "components", None) is None
        )


@dataclass(frozen=True, eq=False)
class Dialect:
    """A dialect of graph text files.

    Attributes
    ----------
    name : of the dialect.
    records : its tags.
    matrix : what the entries of a measurement are: ``information``, ``covariance``, or the upper ``square root`` of the
        information.
    says : what tells it from the others, for the refusal of a file that could be several.
    fix : whether lines ``FIX id [id ...]`` hold vertices.
    ignored_tags : tags that belong to it and are not used.
    aliases : other names of tags, which are read and not written.
    apart : whether points have a numbering of their own: there may be a pose 0 and a point 0.
    """

    name: str
    records: tuple[Record, ...]
    matrix: str
    says: str
    fix: bool = False
    ignored_tags: tuple[bytes, ...] = ()
    aliases: tuple[tuple[bytes, bytes], ...] = ()
    apart: bool = False

    @cached_property
    def tags(self) -> dict[bytes, Record]:
        """Records by tag and alias; the last one of a tag, which reads all of its lines."""
        by_tag = {record.tag: record for record in self.records}
        return by_tag | {alias: by_tag[tag] for alias, tag in self.aliases}

    def record(self, role: str, group: LieGroup) -> Record | None:
        """The record of vertices of a role, or of a ``parameter``, in the plane or in space; None where none is."""
        slots = {"mount": ("pose",), "parameter": ()}.get(role, (role,))
        records = [r for r in self.records if r.factor is None and r.slots == slots and r.group is group]
        return records[0] if records else None


@cache
def spaces_of(group: LieGroup) -> dict[str, Manifold]:
    """The space of vertices by what they are used as, with poses of SE2 or SE3."""
    return {"pose": group, "point": R(group.point_dim), "mount": group, "either": group}


def a_file(format: str) -> str:
    """A file of a format, in words.

    Examples
    --------
    >>> a_file("g2o"), a_file("isam")
    ('a g2o file', 'an isam file')
    """
    return f"a{'n' if format.startswith('i') else ''} {format} file"


def fixed_offsets(factor: Factor) -> list[Array]:
    """The fixed offsets of a factor, none, one or two."""
    offset = getattr(factor, "offset", None)
    if isinstance(offset, tuple):
        return list(offset)
    return [offset] if isinstance(offset, np.ndarray) else []


def at_origin(offsets: list[Array]) -> bool:
    """Whether fixed offsets, poses or lever arms, say that the sensors are at the origin: the same as no offset."""
    return all(bool((np.abs(O) == (SE3.identity() if O.shape[-1] == SE3.size else 0.0)).all()) for O in offsets)


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
        text.refuse(ids[0] == ids[1], at, lambda k: f"the edge connects vertex {ids[0][k]} to itself")
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
    if not len(numbers):
        return numbers
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


def note_rounded(report: LoadReport, blocks: Iterable[Lines]) -> None:
    """Warn of quaternions whose length is not 1 up to the rounding of six digits."""
    lines = NONE
    for at, element, X in ((block.at, block.record.element, block.X) for block in blocks):
        if element.space is SE3 and not element.angles:
            off = np.abs(np.sqrt(np.square(X[:, 3:]).sum(axis=1)) - 1) > UNIT_ROUNDED
            lines = np.concatenate([lines, at[off]])
    if len(lines):
        report.warn(
            f"the length of {several(len(lines), 'quaternion')} is off by more than {UNIT_ROUNDED:g}, first on line "
            f"{lines.min() + 1}: kept as written, and used as rotations; write more digits"
        )


def note_turns(report: LoadReport, vertices: Iterable[Lines], edges: Iterable[Lines]) -> None:
    """Say that angles are of more than a turn: of vertices in a note, of edges in a warning."""
    for blocks, say in ((vertices, report.notes.append), (edges, report.warn)):
        count, first = 0, list[tuple[int, str, float]]()
        for block in blocks:
            beyond = np.flatnonzero((np.abs(block.angles) > 6.3).any(axis=1))  # 2 pi, also rounded to two digits
            count += len(beyond)
            if len(beyond):
                k = beyond[np.argmin(block.at[beyond])]
                angle = block.angles[k, np.argmax(np.abs(block.angles[k]))]
                first.append((int(block.at[k]) + 1, block.record.tag.decode(), float(angle)))
        if first:
            line, tag, angle = min(first)
            have = "1 line has" if count == 1 else f"{count} lines have"
            say(
                f"{have} an angle of more than a turn, first on line {line} ({tag}): {angle:g}; angles are radians: do "
                "they count turns, or are these degrees?"
            )
