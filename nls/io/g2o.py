"""Pose graphs in g2o files: VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT, FIX; blank lines and # comments.

    VERTEX_SE2 id x y theta                     EDGE_SE2 i j dx dy dtheta I11 I12 I13 I22 I23 I33
    VERTEX_SE3:QUAT id x y z qx qy qz qw        EDGE_SE3:QUAT i j x y z qx qy qz qw and 21 entries
    FIX id [id ...]

The information is the upper triangle row by row, of (x, y, theta) or of (x, y, z, qx, qy, qz): in space the rotation
part belongs to the *vector part of the quaternion*, half a rotation vector. For the conventions ``g2o``, ``graphslam``
and ``gtsam`` it is taken verbatim, for ``log`` converted (rotation block / 4, mixed blocks / 2: exact in binary).
Poses are the variables ``x`` with the ids of the file. Nothing is repaired: what cannot be right is an error with its
line. Comments are never *written*: widely used readers lose a file's edges over one.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from factors.base import Factor
from factors.between import Between
from factors.conventions import check_convention
from factors.keys import Keys
from factors.noise import Information
from models import SE2, SE3, LieGroup
from models.algebra import Array
from models.errors import GraphError, GraphFileError, GraphWarning, NoiseModelError
from nls.gauge import fixed_variables
from nls.graph import FactorGraph
from nls.io.files import write_bytes
from nls.io.report import LoadReport
from nls.io.text import Text, printable
from nls.starts.chain import chain
from nls.values import Values

__all__ = ["read_g2o", "write_g2o"]


@dataclass(frozen=True)
class Dialect:
    """The tags of one dimension."""

    group: LieGroup
    vertex: bytes
    edge: bytes
    vertex_columns: str
    edge_columns: str


PLANE = Dialect(SE2, b"VERTEX_SE2", b"EDGE_SE2", "id x y theta", "i j dx dy dtheta I11 I12 I13 I22 I23 I33")
SPACE = Dialect(
    SE3, b"VERTEX_SE3:QUAT", b"EDGE_SE3:QUAT", "id x y z qx qy qz qw", "i j x y z qx qy qz qw and 21 entries"
)
UNIT_ROUNDED = 1e-5  # how far the length of a unit quaternion written with six digits is off, at most
HALF = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])  # rotation vector per quaternion vector part


@np.errstate(over="ignore", invalid="ignore")  # numbers near the largest overflow in the checks, and are then refused
def read_g2o(data: bytes, path: str, convention: str = "g2o") -> tuple[FactorGraph, Values, LoadReport]:
    """Graph, start values and report of the bytes of a g2o file.

    Raises
    ------
    GraphFileError
        With the line, for anything that cannot be right.
    """
    check_convention(convention)
    text = Text(data, path)
    tags = dict(text.tags)
    none = np.zeros(0, dtype=np.intp)
    comments = np.concatenate([none, *(tags.pop(tag) for tag in list(tags) if tag.startswith(b"#"))])
    found = [d for d in (PLANE, SPACE) if d.vertex in tags or d.edge in tags]
    known = {tag for d in (PLANE, SPACE) for tag in (d.vertex, d.edge)} | {b"FIX"}
    if not found:
        raise _no_poses(text, tags, comments, known)
    if len(found) == 2:
        line = max(min(int(tags[t][0]) for t in (d.vertex, d.edge) if t in tags) for d in found)
        raise text.error("mixes poses of the plane and of space; expected one dimension in a file", line)
    dialect = found[0]
    edges, vertices = tags.get(dialect.edge, none), tags.get(dialect.vertex, none)

    report = LoadReport(path, "g2o", f"{dialect.group.point_dim}-D", convention)
    report.tags = {printable(tag): len(lines) for tag, lines in tags.items()}
    ignored = {tag: lines for tag, lines in tags.items() if tag not in known}
    if ignored:
        first = list(ignored.items())[:9]
        named = ", ".join(f"{printable(t)[:30]} ({len(n)}, first on line {n[0] + 1})" for t, n in first)
        more = f" and {len(ignored) - 9} other tags" if len(ignored) > 9 else ""
        report.notes.append(f"lines with unknown tags were not used, and are kept as text: {named}{more}")
        lines = np.sort(np.concatenate(list(ignored.values())))
        report.ignored = [text.line(n).decode("utf-8", "surrogateescape") for n in lines.tolist()]
        warnings.warn(f"{path}: {report.notes[-1]}", GraphWarning, stacklevel=4)
    if len(comments):
        report.notes.append(f"{len(comments)} comment lines")

    ids, poses = _vertices(text, dialect, vertices)
    graph = FactorGraph()
    between = _edges(text, dialect, edges, convention)
    z = poses[:0]
    if between is not None:
        graph.add(between)
        z = np.asarray(between.z)
        values = _start(text, dialect, between, edges, ids, poses, report)
    else:
        values = Values({"x": (dialect.group, poses, ids)})
    rounded = np.concatenate([_rounded(dialect, poses, vertices), _rounded(dialect, z, edges)])
    if len(rounded):
        report.notes.append(
            f"the length of {len(rounded)} quaternions is off by more than {UNIT_ROUNDED:g}, first on line "
            f"{rounded.min() + 1}: kept as written, and used as rotations; write more digits"
        )
        warnings.warn(f"{path}: {report.notes[-1]}", GraphWarning, stacklevel=4)
    if b"FIX" in tags:
        graph.fix(_fixed(text, dialect, tags[b"FIX"], values.stack("x").numbers, report.vertices_given))
    return graph, values, report


def _no_poses(
    text: Text, tags: dict[bytes, npt.NDArray[np.intp]], comments: npt.NDArray[np.intp], known: set[bytes]
) -> GraphFileError:
    """The error for a file without any pose."""
    expected = ", ".join(sorted(tag.decode() for tag in known))
    unknown = [tag for tag in tags if tag not in known]
    if unknown:
        line, what = int(tags[unknown[0]][0]), f"{printable(unknown[0])[:30]!r} is no tag of a pose graph"
    elif tags:
        line, what = int(tags[b"FIX"][0]), "fixes vertices and has neither a vertex nor an edge"
    elif len(comments):
        line, what = int(comments.min()), "has nothing but comments"
    else:
        line, what = 0, "is empty"
    return text.error(f"{what}; expected lines such as {expected}", line)


def _rounded(dialect: Dialect, X: Array, lines: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Lines whose quaternion has a length that is not 1 up to the rounding of six digits."""
    if dialect is PLANE or not len(lines):
        return lines[:0]
    off: npt.NDArray[np.bool_] = np.abs(np.linalg.norm(X[:, 3:], axis=1) - 1) > UNIT_ROUNDED
    return lines[off]


def _fixed(
    text: Text, dialect: Dialect, lines: npt.NDArray[np.intp], ids: npt.NDArray[np.int64], vertices_given: bool
) -> Keys:
    """The variables of all FIX lines, each once."""
    count = text.first[lines + 1] - text.first[lines] - 1
    if (count == 0).any():
        raise text.error("FIX without a vertex; expected FIX id [id ...]", int(lines[np.argmin(count)]))
    owner = np.repeat(lines, count)
    numbers = text.whole(owner, 1 + np.concatenate([np.arange(n) for n in count]))
    missing = ~np.isin(numbers, ids)
    if missing.any():
        k = int(np.argmax(missing))
        name, tag = f"x{numbers[k]}", (dialect.vertex if vertices_given else dialect.edge).decode()
        raise text.error(f"FIX names {name}, which no {tag} line has; add one, or take {name} out", int(owner[k]))
    return Keys("x", np.unique(numbers))


def _vertices(text: Text, dialect: Dialect, lines: npt.NDArray[np.intp]) -> tuple[npt.NDArray[np.int64], Array]:
    """Ids (n,) and poses (n, size) of the vertex lines."""
    group = dialect.group
    poses = text.table(lines, 1 + group.size, dialect.vertex_columns)[:, 1:]
    ids = text.whole(lines, 1)
    if len(ids):
        if (found := group.invalid(poses)) is not None:
            raise text.error(found[1], int(lines[found[0]]))
        order = np.argsort(ids, kind="stable")
        again = np.flatnonzero(ids[order][1:] == ids[order][:-1])
        if len(again):
            k = int(order[again[0] + 1])
            first = int(lines[order[again[0]]])
            raise text.error(f"vertex {ids[k]} was given before, on line {first + 1}", int(lines[k]))
    return ids, poses


def _edges(text: Text, dialect: Dialect, lines: npt.NDArray[np.intp], convention: str) -> Between | None:
    """One batch of all edge lines."""
    if not len(lines):
        return None
    group, d = dialect.group, dialect.group.dim
    upper = np.triu_indices(d)
    table = text.table(lines, 2 + group.size + len(upper[0]), dialect.edge_columns)
    i, j = text.whole(lines, 1), text.whole(lines, 2)
    z = table[:, 2 : 2 + group.size]
    if (found := group.invalid(z)) is not None:
        raise text.error(found[1], int(lines[found[0]]))
    if (same := i == j).any():
        k = int(np.argmax(same))
        raise text.error(f"the edge joins vertex {i[k]} to itself", int(lines[k]))
    Omega = np.empty((len(lines), d, d))
    Omega[:, upper[0], upper[1]] = Omega[:, upper[1], upper[0]] = table[:, 2 + group.size :]
    if convention == "log" and group is SE3:
        Omega /= HALF[:, None] * HALF
    between = Between(Keys("x", i), Keys("x", j), z, Information(Omega), convention)
    try:
        between.bind(group, group)
    except NoiseModelError as error:
        raise text.error(str(error).split(": ", 1)[1], int(lines[error.index])) from error
    return between


def _start(
    text: Text,
    dialect: Dialect,
    between: Between,
    lines: npt.NDArray[np.intp],
    ids: npt.NDArray[np.int64],
    poses: Array,
    report: LoadReport,
) -> Values:
    """The file's vertices; where it has none at all, the poses chained along the edges."""
    numbers = np.concatenate([k.numbers for k in between.keys])
    if len(ids):
        missing = ~np.isin(numbers, ids)
        if missing.any():
            k = int(np.argmax(missing))
            raise text.error(
                f"the edge needs vertex {numbers[k]}, which no {dialect.vertex.decode()} line has (others are there); "
                "add it, or take out all vertices to have the poses chained along the edges",
                int(lines[k % len(lines)]),
            )
        return Values({"x": (dialect.group, poses, ids)})
    unique = np.unique(numbers)
    report.vertices_given = False
    report.notes.append(f"no vertices in the file: {len(unique)} poses chained along the edges")
    values = Values({"x": (dialect.group, dialect.group.identity(len(unique)), unique)})
    values = chain(FactorGraph([between]), values)
    if not np.isfinite(values.stack("x").X).all():
        raise text.error("the poses chained along the edges grow beyond the largest number", int(lines[0]))
    return values


def write_g2o(path: str | Path, graph: FactorGraph, values: Values, ignored: list[str] | None = None) -> None:
    """Write a pose graph, gzip-compressed where the name ends in ``.gz``.

    Read, write, read gives the same graph bit for bit, when both are read with one convention: a file does not name
    it. A graph made in Python is read back with its information as a full matrix: its chi2 may differ by rounding.

    Raises
    ------
    GraphError
        A factor or kind of variable this format has no line for; a variable without a value; mixed conventions.
    GraphFileError
        The file cannot be written.
    """
    if list(values.stacks) != ["x"]:
        raise GraphError(f"{path}: g2o files hold poses of kind x, these values have {list(values.stacks)}")
    stack = values.stack("x")
    dialect = next((d for d in (PLANE, SPACE) if d.group is stack.manifold), None)
    if dialect is None:
        raise GraphError(f"{path}: g2o files hold SE2 or SE3 poses, these are in {stack.manifold}")
    edges = [line for factor in graph.factors for line in _edge_lines(str(path), factor, values, dialect)]
    conventions = sorted({factor.convention for factor in graph.factors})
    if len(conventions) > 1:
        raise GraphError(
            f"{path}: a g2o file is read with one convention, these factors have {', '.join(conventions)}; give all "
            "the same one"
        )
    for keys in graph.fixed:
        values.stack(keys.kind)  # refuses a kind without values
    fixed = fixed_variables(graph.fixed, values)
    out = []
    poses = _rows(dialect.vertex, [stack.numbers], stack.X)
    for line, number, held in zip(poses, stack.numbers.tolist(), fixed.tolist(), strict=True):
        out += [line, f"FIX {number}"] if held else [line]
    text = "\n".join([*out, *edges, *(ignored or [])]) + "\n"
    write_bytes(path, text.encode("utf-8", "surrogateescape"))


def _edge_lines(path: str, factor: Factor, values: Values, dialect: Dialect) -> list[str]:
    if not isinstance(factor, Between):
        raise GraphError(f"{path}: {factor!r} cannot be written to a g2o file", factor.keys, factor.name)
    (model, _), d = values.gather(factor), dialect.group.dim
    if isinstance(factor.noise, Information):
        Omega = factor.noise.matrix
    else:
        W = model.W if model.W.ndim == 3 else model.W[..., None] * np.eye(d)
        Omega = W.mT @ W
    if factor.convention == "log" and dialect.group is SE3:
        Omega = Omega * (HALF[:, None] * HALF)
    Omega = np.broadcast_to(Omega, (len(factor), d, d))
    upper = np.triu_indices(d)
    return _rows(dialect.edge, [k.numbers for k in factor.keys], np.hstack([model.z, Omega[:, upper[0], upper[1]]]))


def _rows(tag: bytes, ids: list[npt.NDArray[np.int64]], numbers: Array) -> list[str]:
    """Text lines; the shortest digits that read back as the same number."""
    head = tag.decode()
    names = zip(*(i.tolist() for i in ids), strict=True)
    return [
        f"{head} {' '.join(map(str, name))} {' '.join(repr(v).removesuffix('.0') for v in row)}"
        for name, row in zip(names, numbers.tolist(), strict=True)
    ]
