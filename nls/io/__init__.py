"""Files: `load` reads a graph, its start and a report, from a file or a mission folder; `save` writes a graph file."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from factors.conventions import check_convention
from models.errors import GraphFileError, GraphWarning, OptionError
from nls.graph import FactorGraph
from nls.io.dialects import FORMATS, SUFFIXES, LineOptions, check_dialect, format_of, refuse_needless
from nls.io.files import ZIP, graph_file, read_bytes, read_stream, write_bytes
from nls.io.native.structure import register
from nls.io.read import read_graph
from nls.io.report import LoadReport, Source
from nls.io.text import printable
from nls.io.trajectory import TRAJECTORIES, read_kitti, read_tum, trajectory_text, write_kitti, write_tum
from nls.io.unused_lines import left_out, measurements_left_out, not_there
from nls.stages import stage
from nls.values import Values, refuse_other

__all__ = [
    "DIALECTS",
    "LoadReport",
    "Source",
    "foreign",
    "load",
    "load_stream",
    "read_kitti",
    "read_tum",
    "register",
    "rendered",
    "save",
    "write_kitti",
    "write_tum",
]

NATIVE = ("npz", "json")
POSES_ONLY = (*TRAJECTORIES, "csv", "ply")  # estimates without measurements, which are written alone
DIALECTS = ("auto", *FORMATS, "pyfg", "bal", *NATIVE)
OBJECT = re.compile(rb"\s*\{")
BAL = re.compile(rb"\s*[0-9]+[ \t]+[0-9]+[ \t]+[0-9]+[ \t\r]*(?:\n|$)")  # three counts on the first line
POSE = re.compile(rb"VERTEX_SE[23]\S*[ \t]+\S+[ \t]+(\S*)")  # its second word
NAME = re.compile(rb"[A-Za-z]+[0-9]+")


def load(
    path: str | Path | Sequence[str | Path],
    convention: str = "g2o",
    dialect: str = "auto",
    repair_information: bool = False,
    elevation: str | None = None,
    ignore_tags: Sequence[str] = (),
    drop_absent: bool = False,
) -> tuple[FactorGraph, Values, LoadReport]:
    """Read a graph file (also gzip-compressed), or a folder that holds a mission.

    Parameters
    ----------
    path : the file, or the folder of a mission: its track, sonar contacts and truth as CSV files; or one without these
        that holds ``graph.npz`` or ``graph.g2o``. A list of folders: dives at one place, with a track each, and their
        landmarks and beacons in common.
    convention : residual of pose measurements, see `factors.conventions`.
    dialect : ``auto`` goes by the content. The dialects are ``g2o``, ``toro``, ``isam``, ``isam-covariance``, ``graph``
        (see `nls.io.dialects`), ``pyfg``, ``bal``, and the library's own ``npz`` and ``json``. The last two state the
        convention of every factor. Files whose lines have several readings must be named.
    repair_information : replace information matrices with negative eigenvalues by the nearest semi-definite ones (with
        a warning) instead of refusing the file; for the dialects g2o and toro.
    elevation : of a mission, what is done about the elevation a sonar does not measure, ``hinge`` when omitted; see
        `factors.sonar_factors`.
    ignore_tags : of a file with tags, unknown ones that begin with ``EDGE`` and may be left out (with a warning), also
        as one text with commas. Others are refused: lines that join variables are not read past in silence.
    drop_absent : leave out edges to vertices that no line gives (with a warning) instead of refusing the file; of g2o
        and TORO files that give vertices.

    Returns
    -------
    graph, values, report : of a mission, dead reckoning as values, and a `nls.missions.folder.MissionReport`; of a scan
        mission a `nls.missions.scans.folder.ScanReport`, which has the points.

    Raises
    ------
    GraphFileError
        The file cannot be right; says where. Or its lines have several readings. Or the folder holds no mission.
    ResourceLimitError
        The file, or what it unpacks to, is too large.
    OptionError
        No such dialect or convention; a repair of information in a file that has none; a tag to ignore that is read;
        these options for a mission or another format without tags.

    Examples
    --------
    >>> import nls
    >>> nls.load("missing.g2o")
    Traceback (most recent call last):
        ...
    models.errors.GraphFileError: missing.g2o: cannot be read: No such file or directory
    """
    check_dialect(dialect, DIALECTS)
    how = convention, dialect, elevation, LineOptions(repair_information, ignore_tags, drop_absent)
    if isinstance(path, str | os.PathLike):
        return _warned(path, _read(path, *how))
    return _warned("dives", _read_dives(path, *how))


def load_stream(
    file: BinaryIO,
    name: str,
    convention: str = "g2o",
    dialect: str = "auto",
    repair_information: bool = False,
    elevation: str | None = None,
    ignore_tags: Sequence[str] = (),
    drop_absent: bool = False,
) -> tuple[FactorGraph, Values, LoadReport]:
    """Read a graph, also gzip-compressed, from an open stream of bytes such as ``sys.stdin.buffer``.

    Parameters
    ----------
    file : the stream, read to its end.
    name : of the stream, for messages and the report.
    convention, dialect, repair_information, elevation, ignore_tags, drop_absent : as for `load`, which has the errors.

    Examples
    --------
    >>> import io
    >>> stream = io.BytesIO(b"EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1")
    >>> load_stream(stream, "<stdin>")[0].factors
    [Between(x0, x1)]
    """
    check_dialect(dialect, DIALECTS)
    _refuse_elevation(elevation, name)
    with stage("read file"):
        try:
            data = read_stream(file, name, archive=True)
        except OSError as error:
            raise GraphFileError(f"cannot be read: {error.strerror or error}", name) from error
    options = LineOptions(repair_information, ignore_tags, drop_absent)
    return _warned(name, _parsed(data, name, convention, dialect, options))


def _warned(name: str | Path, read: tuple[FactorGraph, Values, LoadReport]) -> tuple[FactorGraph, Values, LoadReport]:
    """What was read, its notes given as warnings of the caller's line."""
    for note in read[2].warnings:
        warnings.warn(f"{name}: {note}", GraphWarning, stacklevel=3)
    return read


def _read(
    path: str | Path, convention: str, dialect: str, elevation: str | None, options: LineOptions
) -> tuple[FactorGraph, Values, LoadReport]:
    """The graph of a file or folder, without its warnings; parameters and errors as for `load`."""
    path = graph_file(path)
    if isinstance(path, str | os.PathLike) and os.path.isdir(path):
        from nls.missions.folder import read_mission
        from nls.missions.scans.folder import is_scan_mission, read_scan_mission

        if dialect != "auto":
            raise OptionError("dialect", dialect, f"auto: {path} is a folder, and folders are missions")
        refuse_needless(str(path), "mission", options)
        check_convention(convention)
        if is_scan_mission(path):
            _refuse_elevation(elevation, path)
            graph, values, _, report = read_scan_mission(path)
            return graph, values, report
        return read_mission(path, "hinge" if elevation is None else elevation)
    _refuse_elevation(elevation, path)
    with stage("read file"):
        data = read_bytes(path, archive=True)
    return _parsed(data, str(path), convention, dialect, options)


def _read_dives(
    paths: Sequence[str | Path], convention: str, dialect: str, elevation: str | None, options: LineOptions
) -> tuple[FactorGraph, Values, LoadReport]:
    """The graph of several missions, without its warnings; parameters and errors as for `load`."""
    from nls.missions.folder.dives import read_dives

    if not isinstance(paths, list | tuple) or len(paths) < 2:
        raise OptionError("path", paths, "a file or folder, or a list of the folders of several missions")
    for path in paths:
        if not os.path.isdir(path):
            raise GraphFileError("is no folder; of several inputs each must be the folder of a mission", str(path))
    if dialect != "auto":
        raise OptionError("dialect", dialect, "auto: several inputs are missions")
    refuse_needless(str(paths[0]), "mission", options)
    check_convention(convention)
    return read_dives(paths, "hinge" if elevation is None else elevation)


def _refuse_elevation(elevation: str | None, name: str | Path) -> None:
    """Refuse what is said about the elevation where there is no mission."""
    if elevation is not None:
        raise OptionError("elevation", elevation, f"None: {name} is no folder of a mission, whose contacts have one")


def _parsed(
    data: bytes, path: str, convention: str, dialect: str, options: LineOptions
) -> tuple[FactorGraph, Values, LoadReport]:
    """The graph of the bytes of a file, without its warnings; parameters and errors as for `load`."""
    reason = "as asked for"
    if dialect == "auto":
        dialect, reason = foreign(data, path)
    if dialect in ("bal", "pyfg", *NATIVE):
        refuse_needless(path, dialect, options._replace(ignore_tags=()) if dialect == "pyfg" else options)
    if dialect in NATIVE:
        from nls.io.native.native import read_native

        return read_native(data, path)
    if dialect == "bal":
        from nls.io.bal import read_bal

        read = read_bal(data, path)
    elif dialect == "pyfg":
        from nls.io.pyfg import read_pyfg

        read = read_pyfg(data, path, convention, options.ignore_tags)
    else:
        read = read_graph(data, path, convention, dialect, **options._asdict())
        reason = read[2].reason
    read[2].reason = reason
    for note in not_there(options.ignore_tags, read[2].tags):
        read[2].warn(note)
    return read


def foreign(data: bytes, path: str) -> tuple[str, str]:
    """The formats that are no list of tagged lines with ids, and why; else ``auto``."""
    if data.startswith(ZIP):
        return "npz", "an archive of arrays"
    if OBJECT.match(data):
        return "json", "a JSON object"
    if path.lower().removesuffix(".gz").endswith(".pyfg"):
        return "pyfg", "by its name"
    first = POSE.search(data, 0, 1 << 16)
    if first and NAME.fullmatch(first[1]):
        return "pyfg", f"'{printable(first[1], 30)}' after a time is the name of a pose"
    return ("bal", "three counts on its first line") if BAL.match(data) else ("auto", "")


def save(
    path: str | Path,
    graph: FactorGraph,
    values: Values,
    report: LoadReport | None = None,
    dialect: str | None = None,
    renumber: bool = False,
) -> None:
    """Write a graph file, replaced whole or not at all.

    Parameters
    ----------
    path : the file; compressed where the name ends in ``.gz``.
    graph, values : what to write.
    report : the report the graph was read with: its times are kept. For a file of the same format the numbers of the
        lines and the ids of parameters stay as they were. Unused lines are appended. For another format, which may read
        them as its own, a warning counts them.
    dialect : as for `load`; when omitted by the name: ``.npz`` and ``.json`` hold every graph bit for bit, ``.g2o``,
        ``.toro``, ``.isam``, ``.pyfg`` and ``.bal`` what they have lines for; ``.tum`` and ``.kitti`` hold the poses
        alone, and ``.csv`` the values as a table.
    renumber : for formats in which all vertices share one numbering, such as g2o: variables whose numbers clash get new
        ones, poses keep theirs. A warning says which variable was which; the file cannot.

    Raises
    ------
    GraphError
        A factor or kind of variable the format has no line for; a variable without a value; mixed conventions; two
        variables of one number, without `renumber`.
    GraphFileError
        The file cannot be written.
    OptionError
        No such dialect; none, and a name that says none, such as ``.graph``, which may mean TORO or covariances;
        `renumber` for a format that needs no new numbers.
    """
    if not isinstance(path, str | os.PathLike):
        raise OptionError("path", path, "the name of a file first, then the graph and its values")
    data, notes = rendered(path, graph, values, report, dialect, renumber)
    write_bytes(path, data)
    if format_of(path, dialect, SUFFIXES, "dialect=FORMAT") in POSES_ONLY:
        return  # nobody expects more of them
    for note in notes:
        warnings.warn(f"{path}: {note}", GraphWarning, stacklevel=2)


def rendered(
    path: str | Path,
    graph: FactorGraph,
    values: Values,
    report: LoadReport | None = None,
    dialect: str | None = None,
    renumber: bool = False,
) -> tuple[bytes, list[str]]:
    """The bytes `save` writes, and what they leave out, in words; parameters and errors as there."""
    refuse_other("save", graph, values)
    dialect = check_dialect(format_of(path, dialect, SUFFIXES, "dialect=FORMAT"), (*DIALECTS[1:], *POSES_ONLY))
    notes = left_out(report, dialect)
    if renumber:
        from nls.io.renumbering import check_renumber, renumbered

        check_renumber(dialect)
        graph, values, changes = renumbered(graph, values, report)
        notes += changes
    if dialect == "bal":
        from nls.io.bal import bal_text

        return bal_text(path, graph, values), notes
    if dialect == "pyfg":
        from nls.io.pyfg import pyfg_text

        return pyfg_text(path, graph, values, report), notes
    if dialect in TRAJECTORIES:
        data, more = trajectory_text(path, dialect, graph, values, report)
        return data, notes + more
    if dialect == "csv":
        from nls.io.table import values_table

        return values_table(values, report), notes + measurements_left_out("csv", graph)
    if dialect == "ply":
        from nls.missions.charts.ply import cloud_text

        data, more = cloud_text(path, values)
        return data, notes + more + measurements_left_out("ply", graph)
    if dialect in NATIVE:
        from nls.io.native.native import native_bytes

        return native_bytes(path, graph, values, report, dialect), notes
    from nls.io.write import graph_text

    data, more = graph_text(path, graph, values, report, FORMATS[dialect])
    return data, notes + more
