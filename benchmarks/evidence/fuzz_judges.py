"""What `fuzz.py` says about a mutant that was read: nothing, or in which way the answer is another one.

Words and lines are counted here by themselves. A line of a graph file is a measurement, whatever stands around it. So
as many measurements differ between mutant and seed as lines do, and where no line differs nothing does.
"""

from __future__ import annotations

import csv
import io
import json
import re
import tomllib
import zipfile
import zlib
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from fuzz_mutants import number_of, unpacked
from fuzz_seeds import Reading, Seed

EDGE = re.compile(rb"EDGE(?!_SWITCH_PRIOR).*|ODOMETRY|Constraint2|LANDMARK.*|POINT3|VERTEX.*:PRIOR")
VERTEX = re.compile(rb"VERTEX(?!_SWITCH).*")
BESIDE = re.compile(rb"PARAMS.*|FIX|VERTEX_SWITCH|EDGE_SWITCH_PRIOR")
USED = {  # tags whose lines are never left out
    "g2o": rb"VERTEX_(SE2|XY|SE3:QUAT|TRACKXYZ)|FIX|"
    rb"EDGE_(SE2(_XY|_CALIB|_OFFSET)?|SE3:QUAT|SE3_(TRACKXYZ|CALIB|OFFSET))",
    "toro": rb"VERTEX[23]|EDGE[23]",
    "graph": rb"VERTEX2|EDGE2",
    "isam": rb"EDGE[23]|ODOMETRY|Constraint2|LANDMARK|POINT3",
    "isam-covariance": rb"EDGE2|ODOMETRY|LANDMARK",
    "pyfg": rb"EDGE_(SE2(_XY)?|SE3(:QUAT|_XYZ)|RANGE)|VERTEX_(SE2|XY|SE3:QUAT|XYZ)(:PRIOR)?",
}
ALIASES = {b"ODOMETRY": b"EDGE2", b"Constraint2": b"EDGE2", b"EDGE_SE2_PRIOR": b"EDGE_PRIOR_SE2"}
ALIASES |= dict.fromkeys((b"EDGE_PRIOR_SE3", b"EDGE_SE3_PRIOR:QUAT"), b"EDGE_SE3_PRIOR")
ALIASES |= {b"EDGE_SE3": b"EDGE_SE3:QUAT"}
LINKS = {b"EDGE_SE2": 12, b"EDGE_SE3:QUAT": 31}  # words of lines behind which the type of a link may stand
SETTINGS = ("anchor", "calibration", "beacons", "dvl_mount")  # what all of their cells say is in the graph
MEASURED = ("odometry", "zpr", "contacts", "closures", "fixes", "ranges", "usbl")  # tables with a measurement a row
BLANK = b" \t\v\f\r"
NAME, WHOLE = re.compile(rb"([A-Za-z]+)([0-9]{1,18})"), re.compile(rb"[+-]?[0-9]+")
ALIASES_OF_COLUMNS = {"time_s": "time", "i": "keyframe", "x_m": "x", "y_m": "y"}
Word = bytes | float
Line = tuple[Word, ...]


def judged(seed: Seed, given: Reading, files: dict[str, bytes], read: Reading) -> str:
    """How another answer than that of the files was read; empty where nothing is to be said against it.

    Parameters
    ----------
    seed, given : the seed, and its reading.
    files : of the mutant.
    read : its reading.
    """
    if seed.form == "draft":
        return ""
    try:
        files = {name: unpacked(data) for name, data in files.items()}
    except (OSError, EOFError, zlib.error) as error:
        return f"gzip cannot unpack it: {error!r}"
    originals = {name: unpacked(data) for name, data in seed.files.items()}
    if seed.form in ("tables", "logs"):
        return _tables(seed, originals, given, files, read)
    (data,), (original,) = files.values(), originals.values()
    judge = {"tagged": _tagged, "bal": _bal, "json": _json, "npz": _npz, "poses": _poses}[seed.form]
    return judge(seed, original, given, data, read)


def lines(data: bytes) -> list[list[bytes]]:
    """Words of the lines that are no comments."""
    data = data.removeprefix(b"\xef\xbb\xbf")
    words = [re.split(rb"[ \t\v\f\r]+", line.strip(BLANK)) for line in re.split(rb"\r\n|\n|\r", data)]
    return [line for line in words if line[0] and not line[0].startswith(b"#")]


def value(word: bytes) -> Word:
    """A number, a name without zeros before its number, or the word itself."""
    if name := NAME.fullmatch(word):
        return name[1] + b"%d" % int(name[2])
    number = number_of(word)
    return word if number is None else int(word) if WHOLE.fullmatch(word) else number


def cell(text: str) -> tuple[Word, ...]:
    """The words of a cell, such as a kernel and its width."""
    return tuple(value(part.encode()) for part in text.split(":"))


def difference(one: Counter[Any], other: Counter[Any]) -> tuple[int, int]:
    """How many of one are not in the other, and the other way round."""
    return (one - other).total(), (other - one).total()


def _without_places(texts: Counter[str]) -> Counter[str]:
    """Texts of which none calls a vertex of g2o the place of a sensor: that is said by other lines."""
    return Counter(re.sub(r'"o"|^o(?=[0-9-])', lambda o: o[0].replace("o", "x"), text) for text in texts.elements())


@dataclass
class Lines:
    """What the lines of a graph file are, by their words.

    Attributes
    ----------
    edges, vertices, parameters : how often each is there.
    fixed : numbers behind FIX.
    fault : a line that is not used although it should be, or without a word about it.
    """

    edges: Counter[Line] = field(default_factory=Counter)
    vertices: Counter[Line] = field(default_factory=Counter)
    parameters: Counter[Line] = field(default_factory=Counter)
    fixed: set[int] = field(default_factory=set)
    fault: str = ""


def _parts(dialect: str, content: bytes, ignored: list[str]) -> Lines:
    """The lines of a file but those that the report names as unused."""
    unused = Counter(tuple(words) for line in ignored for words in lines(line.encode("utf-8", "surrogateescape")))
    out, used, timed = Lines(), re.compile(USED[dialect]), dialect == "pyfg"
    for words in lines(content):
        if unused[tuple(words)]:
            unused[tuple(words)] -= 1
            if used.fullmatch(words[0]):
                out.fault = f"a line of {words[0]!r} is not used"
            continue
        tag = ALIASES.get(words[0], words[0])
        words = words[:-1] if len(words) == LINKS.get(tag, 0) + 1 and words[-1].isdigit() else words
        line = (tag, *map(value, words[1 + timed * (tag not in (b"VERTEX_XY", b"VERTEX_XYZ")) :]))
        if EDGE.fullmatch(tag):
            out.edges[line] += 1
        elif VERTEX.fullmatch(tag):
            out.vertices[line] += 1
        elif tag == b"FIX":
            out.fixed |= {int(word) for word in words[1:]}
        elif BESIDE.fullmatch(tag):
            out.parameters[line] += 1
        else:
            out.fault = f"nothing is said about a line of {tag!r}"
    if unused.total():
        out.fault = f"{unused.total()} unused lines are not in the file"
    return out


def _tagged(seed: Seed, original: bytes, given: Reading, data: bytes, read: Reading) -> str:
    old, new = (_parts(seed.dialect, content, one.report.ignored) for content, one in ((original, given), (data, read)))
    if seed.dialect == "g2o":
        given, read = (
            replace(r, measurements=_without_places(r.measurements), variables=_without_places(r.variables))
            for r in (given, read)
        )
    if new.fault:
        return new.fault
    beside = [BESIDE.match(line.lstrip().encode("utf-8", "surrogateescape")) for line in read.report.ignored]
    if not all(beside) and not read.report.warnings:
        return "lines are not used, without a warning"
    if new.edges.total() != read.measurements.total():
        return f"{new.edges.total()} lines of edges, {read.measurements.total()} measurements"
    if new.vertices.total() != read.variables.total() and new.vertices:
        return f"{new.vertices.total()} lines of vertices, {read.variables.total()} variables"
    if len(read.fixed) != len(new.fixed):
        return f"FIX names {sorted(new.fixed)}, {sorted(read.fixed)} are held"
    expected, found = difference(old.edges, new.edges), difference(given.measurements, read.measurements)
    if old.parameters == new.parameters and expected != found:
        return f"{expected} lines of edges differ, {found} measurements"
    expected, found = difference(old.vertices, new.vertices), difference(given.variables, read.variables)
    if old.vertices and new.vertices and expected != found:
        return f"{expected} lines of vertices differ, {found} variables"
    return ""


def _bal(seed: Seed, original: bytes, given: Reading, data: bytes, read: Reading) -> str:
    words = [value(word) for line in lines(data) for word in line]
    cameras, points, count = (int(word) for word in words[:3])
    if len(words) != 3 + 4 * count + 9 * cameras + 3 * points:
        return f"{len(words)} numbers where {cameras} cameras, {points} points and {count} observations are"
    sizes = 2 * cameras + points, count  # a camera is a pose of six numbers and three of its own
    if sizes != (read.variables.total(), read.measurements.total()):
        return f"{sizes} variables and measurements, {read.variables.total()} and {read.measurements.total()} read"
    old = [value(word) for line in lines(original) for word in line]
    if old[:3] != words[:3]:
        return ""
    changed = {k for k, (a, b) in enumerate(zip(old, words, strict=True)) if a != b}
    begin = 3 + 4 * count
    observations = {(k - 3) // 4 for k in changed if k < begin}
    middle = begin + 9 * cameras
    variables = {((k - begin) // 9, (k - begin) % 9 < 6) for k in changed if begin <= k < middle}
    variables |= {(cameras + (k - middle) // 3, True) for k in changed if k >= middle}
    for noun, expected, found in (
        ("observations", len(observations), difference(given.measurements, read.measurements)),
        ("variables", len(variables), difference(given.variables, read.variables)),
    ):
        if found != (expected, expected):
            return f"{expected} {noun} differ, {found} read"
    return ""


def _json(seed: Seed, original: bytes, given: Reading, data: bytes, read: Reading) -> str:
    if read.report.format != "json":  # lines of another seed stand before it
        return "" if read.report.warnings else "lines are not used, without a warning"
    return _same_tree(data.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace"), {}, read)


def _npz(seed: Seed, original: bytes, given: Reading, data: bytes, read: Reading) -> str:
    if read.whole == given.whole:
        return ""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if archive.testzip() is not None:
                return "a checksum is wrong"
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            content = {name: arrays[name] for name in arrays.files}
    except Exception as error:  # broad: whatever NumPy cannot read is another answer
        return f"NumPy cannot read it: {error!r}"
    return _same_tree(str(content.pop("structure")), content, read)


def _same_tree(text: str, arrays: dict[str, Any], read: Reading) -> str:
    """What the file says, and what the graph that was read says when it is written."""
    from nls.io.native.native import native_bytes

    repeated: list[str] = []

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        repeated.extend(name for name, count in Counter(name for name, _ in pairs).items() if count > 1)
        return dict(pairs)

    tree = json.loads(text, object_pairs_hook=unique)
    if repeated:
        return f"{repeated[0]!r} is there twice"
    assert read.graph is not None
    again = json.loads(native_bytes("again", "json", *read.graph, read.report)[0])
    for one in (tree, again):
        one["factors"] = {str(k): factor for k, factor in enumerate(one["factors"].values())}  # their names say nothing
    if len(tree["factors"]) > len(again["factors"]):
        return ""  # factors of one measurement each were joined
    return _different(_expanded(tree, arrays), again, "")


def _expanded(node: Any, arrays: dict[str, Any]) -> Any:
    """The tree of an archive with the arrays in it, as the text has them."""
    if isinstance(node, dict):
        if node.keys() == {"array"}:
            array = arrays[node["array"]]
            return array.tolist() if array.size else {"shape": list(array.shape)}
        return {name: _expanded(child, arrays) for name, child in node.items()}
    return [_expanded(child, arrays) for child in node] if isinstance(node, list) else node


def _different(a: Any, b: Any, where: str) -> str:
    """Where two trees differ first; empty where they do not."""
    if isinstance(a, dict) and isinstance(b, dict):
        for name in [*a, *b]:
            if name not in a or name not in b:
                return f"{where}.{name} is only in what was {'read' if name in b else 'given'}"
        return next((found for name in a if (found := _different(a[name], b[name], f"{where}.{name}"))), "")
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        return next(
            (f for k, (u, v) in enumerate(zip(a, b, strict=True)) if (f := _different(u, v, f"{where}[{k}]"))), ""
        )
    rounded = [float(n) if isinstance(n, int | float) else n for n in (a, b)]
    return "" if rounded[0] == rounded[1] else f"{where}: given {a!r:.60}, read {b!r:.60}"


def _poses(seed: Seed, original: bytes, given: Reading, data: bytes, read: Reading) -> str:
    poses, times, numbers, *_ = json.loads(read.whole)
    if seed.dialect == "csv":
        rows = records(data)
        if rows is None:
            return ""
        table = [{name: number_of(cell.encode()) for name, cell in row.items()} for row in rows]
        pairs = [("x_m", [X[0] for X in poses]), ("y_m", [X[1] for X in poses]), ("time_s", times), ("i", numbers)]
        for name, column in pairs:
            other = ALIASES_OF_COLUMNS[name]
            written = [row.get(name, row.get(other)) for row in table]
            if written != column and (column or {name, other} & table[0].keys()):
                return f"{name} is {written}, {column} read"
        return ""
    rows = [[number_of(word) for word in line] for line in lines(data)]
    own = [[t, *X[:3]] for t, X in zip(times, poses, strict=True)] if seed.dialect == "tum" else [X[:3] for X in poses]
    want = [row[:4] if seed.dialect == "tum" else [row[3], row[7], row[11]] for row in rows]
    return "" if want == own else f"{want} written, {own} read"


def records(data: bytes, sign: str = ",") -> list[dict[str, str]] | None:
    """The rows of a table by column; None where it is not plain enough to tell."""
    if not data.isascii() or b'"' in data:
        return None
    text = [
        line for line in re.split(r"\r\n|\n|\r", data.decode()) if line.strip() and not line.lstrip().startswith("#")
    ]
    rows = [[cell.strip() for cell in row] for row in csv.reader(text, delimiter=sign)]
    if not rows or any(len(row) != len(rows[0]) for row in rows) or len(set(rows[0])) < len(rows[0]):
        return None
    return [dict(zip(rows[0], row, strict=True)) for row in rows[1:]]


def canonical(name: str, data: bytes) -> Any:
    """What a file of a mission says, in whichever order its columns are; the bytes where that cannot be told."""
    if name.endswith(".toml"):
        try:
            return tomllib.loads(data.decode())
        except (ValueError, RecursionError):
            return data
    rows = records(data, ";" if b";" in data else ",")
    if rows is None:
        return data
    return [{column: cell(text) for column, text in row.items()} for row in rows]


def _tables(seed: Seed, originals: dict[str, bytes], given: Reading, files: dict[str, bytes], read: Reading) -> str:
    changed = [name for name, data in files.items() if data != originals[name]]
    new, old = ({name: canonical(name, some[name]) for name in changed} for some in (files, originals))
    if new == old:
        pairs = (given.measurements, read.measurements), (given.variables, read.variables)
        return "" if all(a == b for a, b in pairs) else "the files say the same, and something else was read"
    for name in changed:
        if not isinstance(new[name], bytes) and (answer := _file(seed, name, old[name], new[name], given, read, files)):
            return f"{name}: {answer}"
    return ""


def _file(seed: Seed, name: str, old: Any, new: Any, given: Reading, read: Reading, files: dict[str, bytes]) -> str:
    """Another answer where one file says something else; what its rows say is counted."""
    table, report = name.rpartition("/")[2].partition(".")[0], read.report
    if name.endswith(".toml"):
        same = read.whole == given.whole and table == "mission"
        return "settings differ, and nothing that was read does" if same else ""
    if seed.form == "logs":
        return _log(old, new, given, read, files["mapping.toml"].decode())
    if hasattr(report, "scans"):
        counts = {"scans": len(report.scans.points), "keyframes": len(report.numbers)}
        return f"{len(new)} rows, {counts[table]} read" if len(new) != counts.get(table, len(new)) else ""
    if table in (*MEASURED, *SETTINGS) and read.whole == given.whole:
        return "rows differ, and nothing that was read does"
    if table not in MEASURED:
        return ""
    numbers = {n for source in report.sources if source.path.endswith(name) for n in source.lines.tolist()}
    noted = any(re.search(r"not within|not used|counted once|undecided", note) for note in report.notes)
    return f"{len(new)} rows, {len(numbers)} of them measurements" if len(numbers) != len(new) and not noted else ""


def _log(old: Any, new: Any, given: Reading, read: Reading, mapping: str) -> str:
    """Rows of the mission differ where those of the log do."""
    if len(old) != len(new) or old[0] != new[0] or old[0].keys() != new[0].keys():
        return ""
    rows = [k for k, (a, b) in enumerate(zip(old, new, strict=True)) if a != b]
    names = {
        name
        for k in rows
        for name in old[k]
        if old[k][name] != new[k][name] and f'"{name}"' in mapping and isinstance(old[k][name][0], float | int)
    }
    lost, found = difference(given.measurements, read.measurements)
    if max(lost, found) > 3 * len(rows):
        return f"{len(rows)} rows of the log differ, and {lost} of the mission"
    flagged = any(row.get("lock") == (0,) for k in rows for row in (old[k], new[k]))
    return "" if not names or lost or flagged else f"{sorted(names)} differ, and no row of the mission does"
