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

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from factors.base import Factor
from factors.between import Between
from factors.conventions import check_convention
from factors.keys import Keys
from factors.landmark import Landmark
from factors.prior import Prior
from factors.range import Range
from models import SE2, SE3, R
from models.algebra import Array, Index, Numbers
from models.errors import GraphError
from nls.graph import FactorGraph
from nls.io.dialects import POINT2, POINT3, POSE2, POSE3
from nls.io.records import NONE, Element, Lines, Record, at_origin, fixed_offsets, note_turns
from nls.io.report import LoadReport, Source
from nls.io.text import NUMBER, Text, printable, rows
from nls.io.unused_lines import appended, note_comments, set_aside, without_comments
from nls.io.weights import entries, matrix, noise_of
from nls.io.write import NATIVE, named, refuse_held, unwritable
from nls.values import Values

FILE = "a PyFactorGraph file"
DIGITS = 18  # of the number in a name
FIRST = re.compile(rb"%s|[A-Za-z]+[0-9]+" % NUMBER.pattern)  # behind a tag: a time or a name


def _records(X: Element, pose: bytes, l: Element, point: bytes) -> dict[bytes, Record]:
    """The records of a dimension, whose poses and points have these names."""
    group, distance = X.space, Element(R(1), "range")
    records = (
        Record(b"VERTEX_" + pose, group, ("pose",), X),
        Record(b"VERTEX_" + point, group, ("point",), l),
        Record(b"VERTEX_%s:PRIOR" % pose, group, ("pose",), X, Prior),
        Record(b"VERTEX_%s:PRIOR" % point, group, ("point",), l, Prior),
        Record(b"EDGE_" + pose, group, ("pose", "pose"), X, Between),
        Record(b"EDGE_%s_%s" % (pose[:3], point), group, ("pose", "point"), l, Landmark),
        Record(b"EDGE_RANGE", group, ("either", "either"), distance, Range),
    )
    return {record.tag: record for record in records}


PLANE, SPACE = _records(POSE2, b"SE2", POINT2, b"XY"), _records(POSE3, b"SE3:QUAT", POINT3, b"XYZ")


def _timed(record: Record) -> bool:
    """Whether a time stands before the names: always but for points."""
    return record.factor is not None or record.slots == ("pose",)


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
    tags, comments = without_comments(text)
    dialect = _dialect(text, tags)
    report = LoadReport(path, "pyfg", "2-D" if dialect is PLANE else "3-D", convention)
    report.tags = {printable(tag): len(lines) for tag, lines in tags.items()}
    known = {tag: record.words + _timed(record) for tag, record in dialect.items()}
    unknown = {tag: lines for tag, lines in tags.items() if tag not in known}
    set_aside(text, unknown, known, ignore_tags, report, first=FIRST)
    note_comments(report, len(comments))

    graph, values, first = FactorGraph(), Values(), dict[str, int]()
    vertices: list[Lines] = []
    edges: list[Lines] = []
    blocks = (block for tag, record in dialect.items() if tag in tags for block in _blocks(text, record, tags[tag]))
    for kinds, block, times in blocks:
        lines = block.at
        if block.record.factor is not None:
            edges.append(block)
            factor = _factor(text, kinds, block, values, convention)
            report.factor_times.append((graph.add(factor), times))
            report.sources.append(Source(path, lines + 1))
            continue
        vertices.append(block)
        (kind,), (number,), space = kinds, block.ids, block.record.element.space
        if kind in first:
            spaces = f"{values.stacks[kind].manifold} and in {space}"
            raise text.error(f"kind {kind} is in {spaces}, expected one", max(first[kind], int(lines[0])))
        first[kind] = int(lines[0])
        text.once(number, lines, f"vertex {kind}")
        values.stacks |= Values({kind: (space, block.X, number)}).stacks
        if _timed(block.record) and times.any():  # a graph without times is written with times of 0
            report.vertex_times[kind] = times
    note_turns(report, vertices, edges)
    return graph, values, report


def _dialect(text: Text, tags: dict[bytes, Index]) -> dict[bytes, Record]:
    """The records of the dimension of a file."""
    plane, space = ([int(tags[tag][0]) for tag in d if tag in tags and tag != b"EDGE_RANGE"] for d in (PLANE, SPACE))
    if plane and space:
        line = max(min(plane), min(space))
        raise text.error("mixes the plane and space; expected one dimension in a file", line)
    if not plane and not space:
        expected = ", ".join(tag.decode() for tag in [*PLANE][:2] + [*SPACE][:2])
        raise text.error(f"no vertices; expected lines such as {expected}", int(next(iter(tags.values()), [0])[0]))
    return PLANE if plane else SPACE


def _blocks(text: Text, record: Record, lines: Index) -> Iterator[tuple[tuple[str, ...], Lines, Array]]:
    """Kinds of variables, lines and times (n,) of a tag, one block per combination of kinds."""
    timed, size, entries = _timed(record), record.element.space.size, len(record.places[0])
    count, words = text.first[lines + 1] - text.first[lines] - 1, record.words + timed
    columns = ["time"] * timed + ["name"] * len(record.slots) + [f"{size} numbers"]
    columns += [f"{entries} of covariance"] * (record.factor is not None)
    problem = f"words after {record.tag.decode()}, expected {words}: {' '.join(columns)}"
    text.refuse(count != words, lines, lambda k: f"{count[k]} {problem}")
    times = text.words(lines, 1, 1)[:, 0] if timed else np.zeros(len(lines))
    names = [_names(text, lines, 1 + timed + k) for k in range(len(record.slots))]
    table = text.words(lines, 1 + timed + record.lead, size + entries)
    if (invalid := record.element.space.invalid(table[:, :size])) is not None:
        raise text.error(invalid[1], int(lines[invalid[0]]))
    pairs, pair_of = np.unique(np.stack([kind for kind, _ in names], axis=1), axis=0, return_inverse=True)
    for k, pair in enumerate(pairs):
        mine = np.flatnonzero(pair_of.reshape(-1) == k)
        ids, numbers = [number[mine] for _, number in names], table[mine]
        block = Lines(record, lines[mine], ids, NONE, numbers[:, :size], numbers)
        yield tuple(word.decode() for word in pair.tolist()), block, times[mine]


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


def _factor(text: Text, kinds: tuple[str, ...], block: Lines, values: Values, convention: str) -> Factor:
    """One batch of measurements between variables of these kinds."""
    record, lines, z = block.record, block.at, block.X
    keys = [Keys(kind, number) for kind, number in zip(kinds, block.ids, strict=True)]
    for k in keys:
        known = values.stacks[k.kind].numbers if k.kind in values.stacks else NONE
        if (missing := ~np.isin(k.numbers, known)).any():
            at = int(np.argmax(missing))
            raise text.error(f"{k[[at]]!r} is measured, but no vertex line gives it", int(lines[at]))
    if len(keys) == 2 and kinds[0] == kinds[1]:
        text.refuse(keys[0].numbers == keys[1].numbers, lines, lambda k: f"connects {keys[0][[k]]!r} to itself")
    if record.factor is Range:
        text.refuse(z[:, 0] < 0, lines, lambda _: "a range is at least 0 m")
    with text.at_lines(lines):
        Sigma = np.ascontiguousarray(matrix(record, block.numbers[:, z.shape[1] :], "covariance"))
        noise = noise_of(record, "covariance", Sigma, z, convention)
        factor = record.build(keys, z if z.shape[1] > 1 else z[:, 0], noise, [], convention)
        values.gather(factor)
    return factor


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
        vertices = (r for r in dialect.values() if r.factor is None and r.element.space is stack.manifold)
        if (record := next(vertices, None)) is None or not (stack.kind.isascii() and stack.kind.isalpha()):
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
        out += _lines(record, times, [Keys(stack.kind, numbers)], stack.X)
    for factor in graph.factors:
        record, table = _measured(str(path), factor, values, dialect)
        times = factor_times.get(id(factor), np.zeros(len(factor)))
        out += _lines(record, times, list(factor.keys), table)
    out += appended(report, form)
    return ("\n".join(out) + "\n").encode("utf-8", "surrogateescape"), []


def _measured(path: str, factor: Factor, values: Values, dialect: dict[bytes, Record]) -> tuple[Record, Array]:
    """Record and table (n, columns) of a factor: measured value and covariance."""
    model, _ = values.gather(factor)
    same = (r for r in dialect.values() if r.factor is type(factor) and r.element.space.size == model.space.size)
    plain = getattr(factor, "components", None) is None and at_origin(fixed_offsets(factor))
    if (record := next(same, None)) is None or not plain or len(factor.keys) != len(record.slots):
        raise unwritable(path, factor, FILE, ranges=True)
    try:
        return record, np.hstack([model.z, entries(record, "covariance", factor, model.W, model.z)])
    except GraphError as error:
        raise named(path, factor, error) from error


def _lines(record: Record, times: Array, keys: list[Keys], table: Array) -> list[str]:
    """Text lines."""
    names = [[f"{k.kind}{number}" for number in k.numbers.tolist()] for k in keys]
    return rows(record.tag.decode(), [map(repr, times.tolist()), *names][not _timed(record) :], table)
