"""Range-aided pose graphs in PyFactorGraph text files: poses and points with names, time stamps, covariances.

    VERTEX_SE2 time name x y theta            VERTEX_SE3:QUAT time name x y z qx qy qz qw
    VERTEX_XY name x y                        VERTEX_XYZ name x y z
    VERTEX_SE2:PRIOR time name ...            VERTEX_SE3:QUAT:PRIOR, VERTEX_XY:PRIOR, VERTEX_XYZ:PRIOR, with covariance
    EDGE_SE2 time a b dx dy dtheta            EDGE_SE3:QUAT time a b x y z qx qy qz qw, with covariance
    EDGE_SE2_XY time a b x y                  EDGE_SE3_XYZ time a b x y z, with covariance; the point in the frame of a
    EDGE_RANGE time a b range variance

A *covariance* is its upper triangle, row by row, of (translation, rotation); its rotation part in space is that of the
rotation vector. Readers of the format turn it into a precision 3 / (2 trace), the one of the chordal distance. For the
conventions ``g2o`` and ``graphslam``, whose residual is half a rotation vector, it is converted (block / 4, mixed / 2:
exact in binary). A name is letters and a number: ``A17`` is number 17 of kind ``A``, one kind per vehicle, usually
``L`` for points.

Source: the reader and writer of MarineRoboticsGroup/PyFactorGraph, py_factor_graph/io/pyfg_text.py; A. Papalia et al.,
"Certifiably correct range-aided SLAM", IEEE T-RO 2024.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from factors.base import Factor
from factors.between import Between
from factors.conventions import check_convention
from factors.keys import Keys
from factors.landmark import Landmark
from factors.noise import Covariance, square
from factors.prior import Prior
from factors.range import Range
from models import SE2, SE3, LieGroup, R
from models.algebra import Array, Index, Numbers
from models.errors import GraphError
from nls.graph import FactorGraph
from nls.io.records import at_origin, fixed_offsets, turns
from nls.io.refusals import NATIVE, named, refuse_held, unwritable
from nls.io.report import LoadReport, Source
from nls.io.text import NUMBER, Text, printable, rows
from nls.io.unused_lines import appended, note_comments, set_aside, without_comments
from nls.io.weights import HALF, covariance, refuse_robust
from nls.values import Values

FILE = "a PyFactorGraph file"
DIGITS = 18  # of the number in a name
FIRST = re.compile(rb"%s|[A-Za-z]+[0-9]+" % NUMBER.pattern)  # behind a tag: a time or a name


class Tag(NamedTuple):
    """One kind of line: its measurement, and how many names stand before it."""

    factor: Callable[..., Factor] | None  # None for a vertex
    space: LieGroup  # of the vertex or the measured value
    names: int
    timed: bool = True

    @property
    def noise(self) -> int:
        """Numbers of covariance."""
        return 0 if self.factor is None else self.space.dim * (self.space.dim + 1) // 2

    @property
    def words(self) -> int:
        """Words of a line after its tag."""
        return self.timed + self.names + self.space.size + self.noise

    @property
    def columns(self) -> str:
        """The numbers after the tag, in words."""
        columns = ["time"] * self.timed + ["name", "name"][: self.names] + [f"{self.space.size} numbers"]
        return " ".join(columns + [f"{self.noise} of covariance"] * (self.factor is not None))


class Batch(NamedTuple):
    """Lines of one tag whose names are of the same kinds: numbers (n,) per name, times (n,), table (n, columns)."""

    tag: str
    kinds: tuple[str, ...]
    numbers: list[Numbers]
    lines: Index
    times: Array
    table: Array


def _tags(group: LieGroup, pose: str, space: LieGroup, point: str) -> dict[str, Tag]:
    """The tags of a dimension, whose poses and points have these names."""
    return {
        f"VERTEX_{pose}": Tag(None, group, 1),
        f"VERTEX_{point}": Tag(None, space, 1, timed=False),
        f"VERTEX_{pose}:PRIOR": Tag(Prior, group, 1),
        f"VERTEX_{point}:PRIOR": Tag(Prior, space, 1),
        f"EDGE_{pose}": Tag(Between, group, 2),
        f"EDGE_{pose[:3]}_{point}": Tag(Landmark, space, 2),
        "EDGE_RANGE": Tag(Range, R(1), 2),
    }


PLANE, SPACE = _tags(SE2, "SE2", R(2), "XY"), _tags(SE3, "SE3:QUAT", R(3), "XYZ")


@np.errstate(over="ignore", invalid="ignore")  # numbers near the largest overflow in the checks, and are then refused
def read_pyfg(
    data: bytes, path: str, convention: str = "g2o", ignore_tags: Sequence[str] = ()
) -> tuple[FactorGraph, Values, LoadReport]:
    """Graph, values of the vertices and report of the bytes of a PyFactorGraph text file.

    The vertices of published files are the *true* values, not a start. ``ignore_tags`` as for `nls.load`.

    Raises
    ------
    GraphFileError
        With the line, for anything that cannot be right.

    Examples
    --------
    >>> text = b"VERTEX_SE2 0.5 A0 1 2 0\\nVERTEX_XY L3 4 6\\nEDGE_RANGE 0.5 A0 L3 5.1 0.04\\n"
    >>> graph, values, report = read_pyfg(text, "one.pyfg")
    >>> graph.factors, values, report.vertex_times["A"].tolist(), graph.chi2(values)
    ([Range(A0, L3)], Values(A: 1 x SE2, L: 1 x R(2)), [0.5], 0.25)
    """
    check_convention(convention)
    text = Text(data, path)
    words, comments = without_comments(text)
    tags = {printable(tag): lines for tag, lines in words.items()}
    dialect = _dialect(text, tags)
    report = LoadReport(path, "pyfg", "2-D" if dialect is PLANE else "3-D", convention)
    report.tags = {tag: len(lines) for tag, lines in tags.items()}
    known = {name.encode(): tag.words for name, tag in dialect.items()}
    unknown = {tag: lines for tag, lines in words.items() if tag not in known}
    set_aside(text, unknown, known, ignore_tags, report, first=FIRST)
    note_comments(report, len(comments))

    graph, values, first = FactorGraph(), Values(), dict[str, int]()
    angles: tuple[list[tuple[str, Index, Array]], ...] = [], []  # of measurements, of vertices
    batches = ((tag, batch) for name, tag in dialect.items() for batch in _batches(text, name, tag, tags.get(name)))
    for tag, batch in batches:
        lines = batch.lines
        angles[tag.factor is None].extend([(batch.tag, lines, batch.table[:, 2:3])] * (tag.space is SE2))
        if tag.factor is not None:
            factor = _factor(text, tag, batch, values, convention)
            report.factor_times.append((graph.add(factor), batch.times))
            report.sources.append(Source(path, lines + 1))
            continue
        (kind,), (number,) = batch.kinds, batch.numbers
        if kind in first:
            spaces = f"{values.stacks[kind].manifold} and in {tag.space}"
            raise text.error(f"kind {kind} is in {spaces}, expected one", max(first[kind], int(lines[0])))
        first[kind] = int(lines[0])
        text.once(number, lines, f"vertex {kind}")
        values.stacks |= Values({kind: (tag.space, batch.table, number)}).stacks
        if tag.space in (SE2, SE3) and batch.times.any():  # a graph without times is written with times of 0
            report.vertex_times[kind] = batch.times
    report.notes += turns(angles[True])
    for message in turns(angles[False]):
        report.warn(message)
    return graph, values, report


def _dialect(text: Text, tags: dict[str, Index]) -> dict[str, Tag]:
    """The tags of the dimension of a file."""
    dialects = [d for d in (PLANE, SPACE) if any(tag in tags and tag != "EDGE_RANGE" for tag in d)]
    if len(dialects) == 1:
        return dialects[0]
    if not dialects:
        expected = ", ".join(list(PLANE)[:2] + list(SPACE)[:2])
        raise text.error(f"no vertices; expected lines such as {expected}", int(next(iter(tags.values()), [0])[0]))
    line = max(min(int(tags[tag][0]) for tag in d if tag in tags and tag != "EDGE_RANGE") for d in dialects)
    raise text.error("mixes the plane and space; expected one dimension in a file", line)


def _batches(text: Text, name: str, tag: Tag, lines: Index | None) -> Iterator[Batch]:
    """Lines of a tag, one batch per combination of kinds; nothing of a tag that is not there."""
    if lines is None:
        return
    lead = 1 + tag.timed + tag.names
    wide = tag.space.size + tag.noise
    count = text.first[lines + 1] - text.first[lines] - 1
    expected = f"expected {tag.words}: {tag.columns}"
    text.refuse(count != tag.words, lines, lambda k: f"{count[k]} words after {name}, {expected}")
    times = text.words(lines, 1, 1)[:, 0] if tag.timed else np.zeros(len(lines))
    names = [_names(text, lines, 1 + tag.timed + k) for k in range(tag.names)]
    table = text.words(lines, lead, wide)
    if (invalid := tag.space.invalid(table[:, : tag.space.size])) is not None:
        raise text.error(invalid[1], int(lines[invalid[0]]))
    pairs, pair_of = np.unique(np.stack([kind for kind, _ in names], axis=1), axis=0, return_inverse=True)
    for k, pair in enumerate(pairs):
        mine = np.flatnonzero(pair_of.reshape(-1) == k)
        kinds = tuple(word.decode() for word in pair.tolist())
        yield Batch(name, kinds, [number[mine] for _, number in names], lines[mine], times[mine], table[mine])


def _names(text: Text, lines: Index, column: int, longest: int = 40) -> tuple[npt.NDArray[np.bytes_], Numbers]:
    """Names such as A17 as their letters (n,) and numbers (n,)."""
    tokens = text.first[lines] + column
    lengths = text.ends[tokens] - text.starts[tokens]
    C = text.characters(tokens, min(int(lengths.max(initial=1)), longest))
    letter = ((C | 32) >= ord("a")) & ((C | 32) <= ord("z"))
    digit = (C >= ord("0")) & (C <= ord("9"))
    head = np.argmin(np.column_stack([letter, np.zeros(len(C), dtype=bool)]), axis=1)  # letters in front
    digits = lengths - head
    leading_zero = np.take_along_axis(C, np.minimum(head, C.shape[1] - 1)[:, None], axis=1)[:, 0] == ord("0")
    column_of = np.arange(C.shape[1])
    tail = (column_of >= head[:, None]) & (column_of < lengths[:, None])
    bad = (head < 1) | (digits < 1) | (digits > DIGITS) | (lengths > longest) | (leading_zero & (digits > 1))
    bad |= (tail & ~digit).any(axis=1)

    def problem(k: int) -> str:
        word = printable(text.token(int(tokens[k])), longest)
        return f"name '{word}': expected letters and a number of at most {DIGITS} digits, such as A17"

    text.refuse(bad, lines, problem)
    number = np.zeros(len(C), dtype=np.int64)
    for k in range(C.shape[1]):
        number = np.where(tail[:, k], 10 * number + C[:, k] - ord("0"), number)
    kind = np.ascontiguousarray(np.where(letter & ~tail, C, np.uint8(0))).view(f"S{C.shape[1]}")[:, 0]
    return kind, number


def _factor(text: Text, tag: Tag, batch: Batch, values: Values, convention: str) -> Factor:
    """One batch of measurements between variables of these kinds."""
    assert tag.factor is not None
    lines, table = batch.lines, batch.table
    keys = [Keys(kind, number) for kind, number in zip(batch.kinds, batch.numbers, strict=True)]
    for k in keys:
        known = values.stacks[k.kind].numbers if k.kind in values.stacks else np.zeros(0, dtype=np.int64)
        if (missing := ~np.isin(k.numbers, known)).any():
            at = int(np.argmax(missing))
            raise text.error(f"{k[[at]]!r} is measured, but no vertex line gives it", int(lines[at]))
    if tag.names == 2 and keys[0].kind == keys[1].kind:
        text.refuse(keys[0].numbers == keys[1].numbers, lines, lambda k: f"joins {keys[0][[k]]!r} to itself")
    size, d = tag.space.size, tag.space.dim
    Sigma = np.empty((len(lines), d, d))
    upper = np.triu_indices(d)
    Sigma[:, upper[0], upper[1]] = Sigma[:, upper[1], upper[0]] = table[:, size:]
    if _halved(tag.space, convention):
        Sigma /= HALF[:, None] * HALF
    options = {"convention": convention} if tag.factor in (Between, Prior) else {}
    z = table[:, :size] if size > 1 else table[:, 0]
    if tag.factor is Range and (below := z < 0).any():
        raise text.error("a range is at least 0 m", int(lines[np.argmax(below)]))
    with text.at_lines(lines):
        factor = tag.factor(*keys, z, Covariance(Sigma), **options)
        values.gather(factor)
    return factor


def _halved(space: LieGroup, convention: str) -> bool:
    """Whether the residual is that of half a rotation vector."""
    return space is SE3 and convention in ("g2o", "graphslam")


def pyfg_text(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None = None
) -> tuple[bytes, list[str]]:
    """The bytes of a PyFactorGraph text file, and no notes.

    Reading, writing and reading again gives the same numbers, bit for bit.

    Parameters
    ----------
    path : the file, for messages.
    graph, values : what to write; kinds are letters, the names in the file are kind and number.
    report : the report the graph was read with, for its time stamps, and for its unused lines where the file was in
        this format; without one, and for factors it does not know, the time 0 is written.

    Raises
    ------
    GraphError
        A factor, space or name the format has no line for; variables held fixed.
    """
    refuse_held(str(path), graph, FILE)
    known = LoadReport(str(path), form, "", "") if report is None else report
    factor_times = {id(factor): times for factor, times in known.factor_times}
    space = {stack.manifold for stack in values.stacks.values()} & {SE3, R(3)}
    dialect = SPACE if space else PLANE
    out = []
    for stack in sorted(values.stacks.values(), key=lambda stack: stack.manifold not in (SE2, SE3)):  # poses first
        name = next((n for n, tag in dialect.items() if tag.factor is None and tag.space is stack.manifold), None)
        if name is None or not (stack.kind.isascii() and stack.kind.isalpha()):
            message = f"{path}: variables {stack.kind} in {stack.manifold} have no line in {FILE}"
            raise GraphError(message, advice=[NATIVE])
        numbers = stack.numbers
        if len(wrong := numbers[(numbers < 0) | (numbers >= 10**DIGITS)]):
            why = "is negative" if wrong[0] < 0 else f"has more than {DIGITS} digits"
            message = f"{path}: {stack.kind}{wrong[0]} is no name of {FILE}, the number {why}"
            raise GraphError(message, advice=[NATIVE])
        times = known.vertex_times.get(stack.kind, np.zeros(len(numbers)))
        if len(times) != len(numbers):
            raise GraphError(f"{path}: the report has {len(times)} times for the {len(numbers)} variables {stack.kind}")
        out += _lines(name, times if dialect[name].timed else None, [Keys(stack.kind, numbers)], stack.X)
    for factor in graph.factors:
        name, table = _measured(str(path), factor, values, dialect)
        times = factor_times.get(id(factor), np.zeros(len(factor)))
        out += _lines(name, times, list(factor.keys), table)
    out += appended(report, form)
    return ("\n".join(out) + "\n").encode("utf-8", "surrogateescape"), []


def _measured(path: str, factor: Factor, values: Values, dialect: dict[str, Tag]) -> tuple[str, Array]:
    """Tag and table (n, columns) of a factor: measured value and covariance."""
    model, _ = values.gather(factor)
    name = next((n for n, t in dialect.items() if t.factor is type(factor) and t.space.size == model.space.size), None)
    plain = getattr(factor, "components", None) is None and at_origin(fixed_offsets(factor))
    if name is None or not plain or len(factor.keys) != dialect[name].names:
        raise unwritable(path, factor, FILE, ranges=True)
    d = model.space.dim
    W = square(model.W)
    try:
        refuse_robust(factor)
        Sigma = factor.noise.matrix if isinstance(factor.noise, Covariance) else covariance(factor, W)
    except GraphError as error:
        raise named(path, factor, error) from error
    if _halved(dialect[name].space, factor.convention):
        Sigma = Sigma * (HALF[:, None] * HALF)
    upper = np.triu_indices(d)
    return name, np.hstack([model.z, np.broadcast_to(Sigma, (len(factor), d, d))[:, upper[0], upper[1]]])


def _lines(tag: str, times: Array | None, keys: list[Keys], table: Array) -> list[str]:
    """Text lines."""
    stamps = [] if times is None else [map(repr, times.tolist())]
    return rows(tag, [*stamps, *([f"{k.kind}{number}" for number in k.numbers.tolist()] for k in keys)], table)
