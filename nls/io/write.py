"""The writer of graph text files of every dialect: from a graph and values to the lines of its records.

Read, write, read with one dialect and one convention gives the same graph bit for bit. Where noise is about angles this
takes the report of the file. Comments are never written: widely used readers lose a file's edges over one.
"""

from __future__ import annotations

import re
from itertools import count
from pathlib import Path

import numpy as np

from factors.base import Factor
from factors.keys import Keys
from models import SE2, SE3, LieGroup, R
from models.advice import Advice
from models.algebra import Array, Numbers
from models.errors import GraphError, SingularGeometryError
from models.listing import several
from nls.gauge import fixed_variables
from nls.graph import FactorGraph
from nls.io.dialects import TAGGED
from nls.io.records import Dialect, Record, a_file, at_origin, fixed_offsets, joined, spaces_of
from nls.io.refusals import NATIVE, named, other_files, refuse_held, unwritable
from nls.io.report import LoadReport, Statement
from nls.io.switches import PRIOR, VERTEX
from nls.io.text import rows
from nls.io.unused_lines import appended
from nls.io.variable_names import VertexIds
from nls.io.weights import entries
from nls.values import Values

PARAMETER = re.compile(r"\s*PARAMS_\S+\s+([+-]?[0-9]{1,18})\s")


def graph_text(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None
) -> tuple[bytes, list[str]]:
    """The bytes of a graph text file, and what they leave out, in words.

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
    format = TAGGED[form]
    content = _Content(str(path), graph, values, report, format)
    out = content.offsets.lines(format)
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
    only = f"{format.name} files hold measurements only: the values of {several(left, 'variable')} are not in it"
    text = "\n".join([*out, *appended(report, format.name)]) + "\n"
    return text.encode("utf-8", "surrogateescape"), [only] if left else []


def refuse_unwritable_graph(
    path: str | Path, form: str, graph: FactorGraph, values: Values, report: LoadReport | None
) -> None:
    """Refuse what `graph_text` refuses, without its text, which takes ten times as long; parameters as there.

    Raises
    ------
    GraphError
    """
    _Content(str(path), graph, values, report, TAGGED[form])


class _Content:
    """What a file says, as numbers; everything that it cannot say is refused here.

    Attributes
    ----------
    vertices : tag, ids (n,), which are fixed (n,), numbers (n, k), by kind.
    edges : tag, columns of ids, numbers, by factor.
    offsets : the parameters.
    unwritten : variables that the format has no line for.
    """

    def __init__(
        self, path: str, graph: FactorGraph, values: Values, report: LoadReport | None, format: Dialect
    ) -> None:
        known = report.statements if report is not None and report.format == format.name else []
        statements = {id(statement.noise): statement for statement in known}
        stated = [statements.get(id(factor.noise)) for factor in graph.factors]
        apart = format.apart or any(s is not None and format.tags[s.tag].apart for s in stated)
        vertex_ids = VertexIds(graph, values, report)
        group = _dimension(path, graph, values, format, vertex_ids, apart)
        fixed = _fixed(path, graph, values, format)
        self.offsets = _Offsets(appended(report, format.name), group)
        self.edges = [
            table
            for factor, statement in zip(graph.factors, stated, strict=True)
            for table in _edges(path, factor, values, group, format, vertex_ids, self.offsets, statement)
        ]
        _refuse_conventions(path, graph, values)
        _refuse_mounts(path, graph, values, vertex_ids.roles)
        self.vertices: list[tuple[bytes, Numbers, np.ndarray, Array]] = []
        self.unwritten, start = 0, 0
        for kind, stack in values.stacks.items():
            held = fixed[start : start + len(stack)]
            start += len(stack)
            record = format.record(vertex_ids.roles[kind], group)
            if record is None:
                self.unwritten += len(stack)
                continue
            try:
                ids = vertex_ids.of(Keys(kind, stack.numbers))
                self.vertices.append((record.tag, ids, held, record.element.encode(stack.X)))
            except SingularGeometryError as error:
                raise GraphError(f"{path}: variables {kind}: {error}") from error


def _dimension(
    path: str, graph: FactorGraph, values: Values, format: Dialect, vertex_ids: VertexIds, apart: bool
) -> LieGroup:
    """SE2 or SE3; every kind in the space the format has for it, each number once where kinds share a numbering."""
    kinds = {stack.kind: stack.manifold for stack in values.stacks.values()}
    group = SE3 if {SE3, R(3)} & set(kinds.values()) else SE2
    spaces = {kind: spaces_of(group)[role] for kind, role in vertex_ids.roles.items()}
    for kind, manifold in kinds.items():
        if spaces.get(kind) is not manifold:
            expected = ", ".join(f"{k} in {space}" for k, space in spaces.items())
            raise GraphError(
                f"{path}: variables {kind} in {manifold} have no line in {a_file(format.name)}, which holds poses, "
                f"points and places of sensors of one dimension: here {expected}; build the graph with these kinds, "
                "or kinds of one or two letters, or let `nls convert` rename one kind of poses and one of points",
                advice=[NATIVE],
            )
    variables = [Keys(stack.kind, stack.numbers) for stack in values.stacks.values()]
    ids = [vertex_ids.of(keys) for keys in variables]
    unique, times = np.unique(joined(ids), return_counts=True)
    if (times > 1).any() and apart:  # FIX lines have one numbering
        refuse_held(path, graph, f"{a_file(format.name)} with numbers of points of their own")
    elif (times > 1).any():
        number = int(unique[np.argmax(times > 1)])
        clash = [keys[n == number] for keys, n in zip(variables, ids, strict=True) if number in n]
        raise GraphError(
            f"{path}: {clash[0]!r} and {clash[1]!r} have one number; expected numbers of their own, as all vertices of "
            f"{a_file(format.name)} share one numbering",
            clash,
            advice=[Advice("renumber"), NATIVE],
        )
    return group


def _fixed(path: str, graph: FactorGraph, values: Values, format: Dialect) -> np.ndarray:
    for keys in graph.fixed:
        values.stack(keys.kind)  # refuses a kind without values
    fixed = fixed_variables(graph.fixed, values)
    if not format.fix:
        refuse_held(path, graph, a_file(format.name))
    return fixed


def _refuse_conventions(path: str, graph: FactorGraph, values: Values) -> None:
    """A file is read with one convention, so it can hold no two; vectors have only one residual."""
    conventions = {f.convention for f in graph.factors if values.gather(f)[0].space in (SE2, SE3)}
    if len(conventions) > 1:
        raise GraphError(
            f"{path}: a graph file is read with one convention, these factors have {', '.join(sorted(conventions))}; "
            "give all the same one",
            advice=[NATIVE],
        )


def _refuse_mounts(path: str, graph: FactorGraph, values: Values, roles: dict[str, str]) -> None:
    """A place of a sensor that no measurement uses as one would be read back as a pose."""
    for kind in (kind for kind in values.stacks if roles[kind] == "mount"):
        used = [k.numbers for f in graph.factors for k in f.keys[1:] if k.kind == kind]
        numbers = values.stacks[kind].numbers
        if len(lost := Keys(kind, numbers[~np.isin(numbers, joined(used))])):
            raise GraphError(
                f"{path}: {lost[[0]]!r} is no offset of any measurement: a file would say it is a pose",
                [lost],
                advice=[NATIVE],
            )


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


def _edges(
    path: str,
    factor: Factor,
    values: Values,
    group: LieGroup,
    format: Dialect,
    vertex_ids: VertexIds,
    offsets: _Offsets,
    statement: Statement | None,
) -> list[tuple[bytes, list[Numbers], Array]]:
    """Tags, ids and numbers of the lines of one factor, those of its switches before its own."""
    try:
        model, _ = values.gather(factor)
    except GraphError as error:
        raise named(path, factor, error) from error
    fixed = fixed_offsets(factor)
    n, any_ = len(factor), [group.identity()]
    tag = b"" if statement is None else statement.tag
    record = _record(factor, model.manifolds, format, fixed, vertex_ids.roles, tag)
    if record is None:
        why = ""
        if fixed and _record(factor, model.manifolds, format, [], vertex_ids.roles):
            why = "its sensor is not at the origin of the vehicle, and no line of this format has an offset"
        raise unwritable(path, factor, a_file(format.name), why)
    numbers = None if statement is None else statement.numbers_of(factor, record.tag)
    if numbers is None:
        try:
            measured = record.element.encode(model.z)
            numbers = np.hstack([measured, entries(record, format, factor, model.W, measured)])
        except SingularGeometryError as error:
            message = f"{path}: {factor!r}: {error}"
            raise GraphError(message, factor.keys, factor.name, advice=other_files(factor)) from error
        except GraphError as error:
            raise named(path, factor, error) from error
    ids = [vertex_ids.of(keys) for keys in factor.keys]
    parameters = np.full((n, record.parameters), -1, dtype=np.int64)
    stated = fixed if record.used and len(fixed) == record.parameters else any_ * record.parameters
    offset = [np.broadcast_to(O, (n, group.size)) for O in stated]
    if statement is not None and statement.parameters.shape == parameters.shape:
        parameters = statement.parameters
        offset = offset if record.used else [statement.offsets[:, k] for k in range(record.parameters)]
    if record.switched:
        switch, prior = [parameters[:, 0]], offset[0][:, 1:]
        tables = [(VERTEX, switch, offset[0][:, :1]), (PRIOR, switch, prior)]
        return [*tables, (record.tag, ids + switch, numbers)]
    ids += [offsets.ids(np.ascontiguousarray(O), parameters[:, k]) for k, O in enumerate(offset)]
    return [(record.tag, ids, numbers)]


def _record(
    factor: Factor,
    manifolds: tuple[object, ...],
    format: Dialect,
    fixed: list[Array],
    roles: dict[str, str],
    tag: bytes = b"",
) -> Record | None:
    """The record whose lines can say this factor, that of a tag first; offsets of nothing with a parameter or not."""
    records = sorted((r for r in format.records if not r.foreign or r.tag == tag), key=lambda r: r.tag != tag)
    kinds = [keys.kind for keys in factor.keys]
    for offsets in (len(fixed), 1 if not fixed else 0 if at_origin(fixed) else -1):
        for record in records:
            if record.holds(factor, manifolds, offsets) and all(  # type: ignore[arg-type]
                roles[kind] in (("pose", "mount") if slot == "either" else (slot,))
                for kind, slot in zip(kinds, record.slots, strict=True)
            ):
                return record
    return None


def _lines(tag: bytes, ids: list[Numbers], numbers: Array) -> list[str]:
    """Text lines, whole numbers without a point."""
    return rows(tag.decode(), [map(str, i.tolist()) for i in ids], numbers, lambda v: repr(v).removesuffix(".0"))
