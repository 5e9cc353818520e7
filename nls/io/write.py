"""The writer of graph text files of every dialect: from a graph and values to the lines of its records.

Read, write, read with one dialect and one convention gives the same graph bit for bit. Where noise is about angles this
takes the report of the file. Comments are never written: widely used readers lose a file's edges over one.

Writers of other text formats refuse what they have no line for by the same functions.
"""

import re
from itertools import count
from pathlib import Path

import numpy as np

from factors.base import Factor
from factors.bearing_range import BearingRange
from factors.keys import Keys
from factors.range import Range
from models import SE2, SE3, LieGroup, Manifold, R
from models.advice import Advice
from models.algebra import Array, Numbers
from models.errors import GraphError, SingularGeometryError
from models.listing import several
from nls.gauge import fixed_variables
from nls.graph import FactorGraph
from nls.io.dialects import TAGGED
from nls.io.formats import FORMATS
from nls.io.ids import PRIOR, VERTEX
from nls.io.native.structure import type_name
from nls.io.records import Dialect, Record, a_file, at_origin, fixed_offsets, joined, spaces_of
from nls.io.report import LoadReport, Statement
from nls.io.text import rows
from nls.io.unused_lines import appended
from nls.io.variable_names import VertexIds
from nls.io.weights import entries
from nls.values import Values

NATIVE = Advice("native")
PARAMETER = re.compile(r"\s*PARAMS_\S+\s+([+-]?[0-9]{1,18})\s")


def graph_text(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None
) -> tuple[bytes, list[str]]:
    """The bytes of a graph text file, and its losses in words.

    A graph made in Python is read back with its information as a full matrix: its chi2 may differ by rounding.

    Parameters
    ----------
    path : the file, for messages.
    form : the name of the dialect.
    graph, values : what to write: poses of kind x, points l, places of sensors o.
    report : of the file that the graph was read from; where that is of the same format, the numbers of its lines are
        written again, and its unused lines appended, as they were.

    Raises
    ------
    GraphError
        Something this dialect has no line for, or that would be read back as something else.
    """
    content = _Content(str(path), form, graph, values, report)
    out = content.offsets.lines(content.format)
    for tag, numbers, held, columns in content.vertices:
        lines = _lines(tag, [numbers], columns)
        if held.any():
            rows_of_vertices = zip(lines, numbers.tolist(), held.tolist(), strict=True)
            lines = [line for row, n, h in rows_of_vertices for line in ([row, f"FIX {n}"] if h else [row])]
        out += lines
    edges = [line for table in content.edges for line in _lines(*table)]
    if report is not None and report.gtsam_kinds and len(at := joined(s.lines for s in report.sources)) == len(edges):
        edges = [edges[k] for k in np.argsort(at, kind="stable")]  # letters took factors apart
    out += edges
    left = content.unwritten
    only = f"{form} files hold measurements only: the values of {several(left, 'variable')} are not in it"
    text = "\n".join([*out, *appended(report, form)]) + "\n"
    return text.encode("utf-8", "surrogateescape"), [only] if left else []


def refuse_unwritable_graph(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None
) -> None:
    """Refuse what `graph_text` refuses, without its text, which takes ten times as long; parameters as there.

    Raises
    ------
    GraphError
    """
    _Content(str(path), form, graph, values, report)


class _Content:
    """The numbers of a file; what it cannot say is refused here.

    Attributes
    ----------
    vertices : tag, ids (n,), which are fixed (n,), numbers (n, k), by kind.
    edges : tag, columns of ids, numbers, by factor.
    offsets : the parameters.
    unwritten : variables that the format has no line for.
    """

    def __init__(self, path: str, form: str, graph: FactorGraph, values: Values, report: LoadReport | None) -> None:
        self.path, self.graph, self.values, self.format, self.file = path, graph, values, TAGGED[form], a_file(form)
        known = report.statements if report is not None and report.format == form else []
        statements = {id(statement.noise): statement for statement in known}
        stated = [statements.get(id(factor.noise)) for factor in graph.factors]
        self.ids = VertexIds(graph, values, report)
        self.group = SE3 if {SE3, R(3)} & {stack.manifold for stack in values.stacks.values()} else SE2
        self._refuse_kinds()
        self._refuse_clash(self.format.apart or any(s is not None and self.format.tags[s.tag].apart for s in stated))
        fixed = self._fixed()
        self.offsets = _Offsets(appended(report, form), self.group)
        self.edges = [t for f, statement in zip(graph.factors, stated, strict=True) for t in self._edges(f, statement)]
        self._refuse_conventions()
        self._refuse_mounts()
        self.vertices: list[tuple[bytes, Numbers, np.ndarray, Array]] = []
        self.unwritten, start = 0, 0
        for kind, stack in values.stacks.items():
            held = fixed[start : start + len(stack)]
            start += len(stack)
            record = self.format.record(self.ids.roles[kind], self.group)
            if record is None:
                self.unwritten += len(stack)
                continue
            try:
                ids = self.ids.of(Keys(kind, stack.numbers))
                self.vertices.append((record.tag, ids, held, record.element.encode(stack.X)))
            except SingularGeometryError as error:
                raise GraphError(f"{path}: variables {kind}: {error}") from error

    def _refuse_kinds(self) -> None:
        """Refuse a kind in another space than the format has for it."""
        spaces = {kind: spaces_of(self.group)[role] for kind, role in self.ids.roles.items()}
        for stack in self.values.stacks.values():
            if spaces.get(stack.kind) is not stack.manifold:
                expected = ", ".join(f"{k} in {space}" for k, space in spaces.items())
                raise GraphError(
                    f"{self.path}: variables {stack.kind} in {stack.manifold} have no line in {self.file}, which holds "
                    f"poses, points and places of sensors of one dimension: here {expected}; build the graph with "
                    "these kinds, or kinds of one or two letters, or let `nls convert` rename one kind of poses and "
                    "one of points",
                    advice=[NATIVE],
                )

    def _refuse_clash(self, apart: bool) -> None:
        """Refuse a number twice where kinds share a numbering, and FIX lines, which have one, where they do not."""
        variables = [Keys(stack.kind, stack.numbers) for stack in self.values.stacks.values()]
        ids = [self.ids.of(keys) for keys in variables]
        unique, times = np.unique(joined(ids), return_counts=True)
        if (times > 1).any() and apart:
            refuse_held(self.path, self.graph, f"{self.file} with numbers of points of their own")
        elif (times > 1).any():
            number = int(unique[np.argmax(times > 1)])
            clash = [keys[n == number] for keys, n in zip(variables, ids, strict=True) if number in n]
            raise GraphError(
                f"{self.path}: {clash[0]!r} and {clash[1]!r} have one number; expected numbers of their own, as all "
                f"vertices of {self.file} share one numbering",
                clash,
                advice=[Advice("renumber"), NATIVE],
            )

    def _fixed(self) -> np.ndarray:
        for keys in self.graph.fixed:
            self.values.stack(keys.kind)  # refuses a kind without values
        fixed = fixed_variables(self.graph.fixed, self.values)
        if not self.format.fix:
            refuse_held(self.path, self.graph, self.file)
        return fixed

    def _refuse_conventions(self) -> None:
        """A file is read with one convention, so it can hold no two; vectors have only one residual."""
        poses = [f for f in self.graph.factors if self.values.gather(f)[0].space in (SE2, SE3)]
        if len(conventions := {factor.convention for factor in poses}) > 1:
            raise GraphError(
                f"{self.path}: a graph file is read with one convention, these factors have "
                f"{', '.join(sorted(conventions))}; give all the same one",
                advice=[NATIVE],
            )

    def _refuse_mounts(self) -> None:
        """A place of a sensor that no measurement uses as one would be read back as a pose."""
        for kind in (kind for kind in self.values.stacks if self.ids.roles[kind] == "mount"):
            used = [k.numbers for f in self.graph.factors for k in f.keys[1:] if k.kind == kind]
            numbers = self.values.stacks[kind].numbers
            if len(lost := Keys(kind, numbers[~np.isin(numbers, joined(used))])):
                message = f"{lost[[0]]!r} is no offset of any measurement: a file would say it is a pose"
                raise GraphError(f"{self.path}: {message}", [lost], advice=[NATIVE])

    def _edges(self, factor: Factor, statement: Statement | None) -> list[tuple[bytes, list[Numbers], Array]]:
        """Tags, ids and numbers of the lines of one factor, those of its switches before its own."""
        try:
            model, _ = self.values.gather(factor)
        except GraphError as error:
            raise named(self.path, factor, error) from error
        fixed = fixed_offsets(factor)
        n, any_ = len(factor), [self.group.identity()]
        record = self._record(factor, model.manifolds, fixed, b"" if statement is None else statement.tag)
        if record is None:
            why = ""
            if fixed and self._record(factor, model.manifolds, []):
                why = "its sensor is not at the origin of the vehicle, and no line of this format has an offset"
            raise unwritable(self.path, factor, self.file, why)
        numbers = None if statement is None else statement.numbers_of(factor, record.tag)
        if numbers is None:
            try:
                measured = record.element.encode(model.z)
                numbers = np.hstack([measured, entries(record, self.format.matrix, factor, model.W, measured)])
            except SingularGeometryError as error:
                message = f"{self.path}: {factor!r}: {error}"
                raise GraphError(message, factor.keys, factor.name, advice=other_files(factor)) from error
            except GraphError as error:
                raise named(self.path, factor, error) from error
        ids = [self.ids.of(keys) for keys in factor.keys]
        parameters = np.full((n, record.parameters), -1, dtype=np.int64)
        stated = fixed if record.used and len(fixed) == record.parameters else any_ * record.parameters
        offset = [np.broadcast_to(O, (n, self.group.size)) for O in stated]
        if statement is not None and statement.parameters.shape == parameters.shape:
            parameters = statement.parameters
            offset = offset if record.used else [statement.offsets[:, k] for k in range(record.parameters)]
        if record.switched:
            switch, prior = [parameters[:, 0]], offset[0][:, 1:]
            tables = [(VERTEX, switch, offset[0][:, :1]), (PRIOR, switch, prior)]
            return [*tables, (record.tag, ids + switch, numbers)]
        ids += [self.offsets.ids(np.ascontiguousarray(O), parameters[:, k]) for k, O in enumerate(offset)]
        return [(record.tag, ids, numbers)]

    def _record(
        self, factor: Factor, manifolds: tuple[Manifold, ...], fixed: list[Array], tag: bytes = b""
    ) -> Record | None:
        """The record that can say this factor, that of a tag first; offsets of nothing with a parameter or not."""
        records = sorted((r for r in self.format.records if not r.foreign or r.tag == tag), key=lambda r: r.tag != tag)
        roles = [self.ids.roles[keys.kind] for keys in factor.keys]
        for offsets in (len(fixed), 1 if not fixed else 0 if at_origin(fixed) else -1):
            for record in records:
                if record.holds(factor, manifolds, offsets) and all(
                    role in (("pose", "mount") if slot == "either" else (slot,))
                    for role, slot in zip(roles, record.slots, strict=True)
                ):
                    return record
        return None


class _Offsets:
    """Parameters of a file being written: an id for every different offset, the one it had where it was read."""

    def __init__(self, ignored: list[str], group: LieGroup) -> None:
        self.group = group
        parameters = [PARAMETER.match(line) for line in ignored]
        self.used_ids = {int(m[1]) for m in parameters if m}
        self.rows: dict[int, bytes] = {}
        # the first id of every row: a search through `rows` made 8000 take 3.6 s, not 0.2
        self.known: dict[bytes, int] = {}
        self.free = max(self.used_ids, default=-1) + 1

    def ids(self, offsets: Array, wanted_ids: Numbers) -> Numbers:
        """Ids (n,) of offsets (n, size), the wanted ones (n,) where they are free or say the same; -1: any."""
        pairs = np.column_stack([offsets.view(np.int64), wanted_ids])  # equal bits, not equal numbers: -0.0 stays
        unique, row_of = np.unique(pairs, axis=0, return_inverse=True)
        number = [self._id(row[:-1].tobytes(), int(row[-1])) for row in unique]
        return np.array(number, dtype=np.int64)[row_of.reshape(-1)]

    def _id(self, row: bytes, wanted_id: int) -> int:
        if wanted_id >= 0 and wanted_id not in self.used_ids and self.rows.get(wanted_id, row) == row:
            return self._add(wanted_id, row)
        return self.known[row] if row in self.known else self._add(self.free, row)

    def _add(self, number: int, row: bytes) -> int:
        self.rows[number] = row
        self.known.setdefault(row, number)
        self.free = max(self.free, number + 1)
        if self.free == 2**63:  # no id: the first that is left
            self.free = next(k for k in count() if k not in self.rows and k not in self.used_ids)
        return number

    def lines(self, format: Dialect) -> list[str]:
        """The parameter lines."""
        if not self.rows:
            return []
        record = format.record("parameter", self.group)
        assert record is not None
        X = np.frombuffer(b"".join(self.rows.values())).reshape(-1, self.group.size)
        return _lines(record.tag, [np.array(list(self.rows), dtype=np.int64)], X)


def _lines(tag: bytes, ids: list[Numbers], numbers: Array) -> list[str]:
    """Text lines, whole numbers without a point."""
    return rows(tag.decode(), [map(str, i.tolist()) for i in ids], numbers, lambda v: repr(v).removesuffix(".0"))


def unwritable(path: str, factor: Factor, file: str, why: str = "", ranges: bool = False) -> GraphError:
    """The error for a factor that a format has no line for.

    Parameters
    ----------
    path : the file.
    factor : the factor.
    file : of which format it would be, such as ``a g2o file``.
    why : the cause, where the format knows it.
    ranges : whether the format has lines for ranges.
    """
    if not why and isinstance(factor, BearingRange):
        why = "no line holds a bearing and its range, and two lines would be two independent measurements"
    advice = other_files(factor)
    if type(factor) is Range and not ranges and len(factor.keys) == 2 and at_origin(fixed_offsets(factor)):
        advice = [*(Advice("range line", row.suffixes) for row in FORMATS.values() if row.ranges), *advice]
    message = f"{path}: {factor!r} cannot be written to {file}" + (f": {why}" if why else "")
    return GraphError(message, factor.keys, factor.name, advice=advice)


def refuse_held(path: str, graph: FactorGraph, file: str) -> None:
    """Refuse variables that are held fixed, for a format that has no line for it.

    Raises
    ------
    GraphError
    """
    if held := [keys for keys in graph.fixed if len(keys)]:
        message = f"{path}: {held[0]!r} is fixed, and {file} has no line for that"
        raise GraphError(message, held, advice=[NATIVE])


def other_files(factor: Factor) -> list[Advice]:
    """The files that hold a factor: native ones hold all that have a name there."""
    return [NATIVE if type_name(factor) is not None else Advice("register")]


def named(path: str, factor: Factor, error: GraphError) -> GraphError:
    """The refusal of what a factor holds, with the file."""
    return GraphError(f"{path}: {error.message}", factor.keys, factor.name, advice=error.advice or other_files(factor))
