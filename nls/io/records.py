"""Records of graph text formats: one `Record` per tag, from which both reader and writer follow.

A line is a tag, the ids of the vertices concerned, the ids of parameters, and the numbers of one element of a space. A
measurement has the entries of a symmetric matrix, too, or of an upper square root. A new sensor is one more record.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np

from factors.base import Factor
from factors.between import Between
from factors.between_sensors import BetweenSensors
from factors.keys import Keys
from factors.noise import Noise
from factors.prior import Prior
from models import SE3, LieGroup, Manifold, R
from models.algebra import Array, Index
from models.manifolds.euler import from_se3, to_se3

KINDS = {"pose": "x", "point": "l", "mount": "o"}  # variables of vertices by what measurements use them as
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
    switched : whether it is a switch or its prior, or has a switch as its parameter, see `nls.io.switches`.
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
        pairs = [(int(pair[0]) - 1, int(pair[1]) - 1) for pair in entries] or [
            *combinations_with_replacement(range(m), 2)
        ]
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
        names += {0: [], 1: ["switch" if self.switched else "parameter"], 2: ["parameter_i", "parameter_j"]}[
            self.parameters
        ]
        n = len(self.places[0])
        return " ".join([*names, self.element.columns]) + (f" and {n} entr{'ies' if n > 1 else 'y'}" if n else "")

    @property
    def chart(self) -> str:
        """The coordinates of the matrix: ``plain``, ``quaternion`` (its vector part) or ``angles``."""
        return "angles" if self.element.angles else "quaternion" if self.element.space.dim == 6 else "plain"

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
