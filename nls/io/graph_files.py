"""`load` reads a graph, its start and a report, from a file or a mission folder; `save` writes a graph file.

Both go by the table of `nls.io.formats`.
"""

import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import nls.io.read  # noqa: F401  # the reader of most files: its import is none of the work of the first one
from factors.conventions import check_convention
from models.errors import GraphFileError, GraphWarning, OptionError
from nls.graph import FactorGraph
from nls.io import formats
from nls.io.files import graph_file, read_bytes, read_stream, write_bytes
from nls.io.formats import FORMATS, Reading
from nls.io.report import LoadReport
from nls.io.unused_lines import left_out, measurements_left_out, not_there
from nls.stages import stage
from nls.values import Values, refuse_other

Read = tuple[FactorGraph, Values, LoadReport]


def load(
    path: str | Path | Sequence[str | Path],
    convention: str = "g2o",
    dialect: str = "auto",
    repair_information: bool = False,
    elevation: str | None = None,
    ignore_tags: Sequence[str] = (),
    drop_absent: bool = False,
) -> Read:
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
    graph, values, report : of a mission, dead reckoning as values, and a `nls.missions.MissionReport`; of a scan
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
    formats.check_dialect(dialect, formats.dialects())
    how = Reading(convention, dialect, repair_information, elevation, ignore_tags, drop_absent)
    if isinstance(path, str | os.PathLike):
        return _warned(path, _read(path, how))
    return _warned("dives", _read_dives(path, how))


def load_stream(
    file: BinaryIO,
    name: str,
    convention: str = "g2o",
    dialect: str = "auto",
    repair_information: bool = False,
    elevation: str | None = None,
    ignore_tags: Sequence[str] = (),
    drop_absent: bool = False,
) -> Read:
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
    formats.check_dialect(dialect, formats.dialects())
    how = Reading(convention, dialect, repair_information, elevation, ignore_tags, drop_absent)
    _refuse_elevation(elevation, name)
    with stage("read file"):
        try:
            data = read_stream(file, name, archive=True)
        except OSError as error:
            raise GraphFileError(f"cannot be read: {error.strerror or error}", name) from error
    return _warned(name, _parsed(data, name, how))


def _warned(name: str | Path, read: Read) -> Read:
    """The graph, values and report, its notes given as warnings of the caller's line."""
    for note in read[2].warnings:
        warnings.warn(f"{name}: {note}", GraphWarning, stacklevel=3)
    return read


def _read(path: str | Path, how: Reading) -> Read:
    """The graph of a file or folder, without its warnings; errors as for `load`."""
    path = graph_file(path)
    if not os.path.isdir(path):
        _refuse_elevation(how.elevation, path)
        with stage("read file"):
            data = read_bytes(path, archive=True)
        return _parsed(data, str(path), how)
    _refuse_options(path, how, f"{path} is a folder, and folders are missions")
    row = formats.of_folder(path)
    if "elevation" not in row.options:
        _refuse_elevation(how.elevation, path)
    return row.read(how, path)


def _read_dives(paths: Sequence[str | Path], how: Reading) -> Read:
    """The graph of several missions, without its warnings; errors as for `load`."""
    if not isinstance(paths, list | tuple) or len(paths) < 2:
        raise OptionError("path", paths, "a file or folder, or a list of the folders of several missions")
    for path in paths:
        if not os.path.isdir(path):
            raise GraphFileError("is no folder; of several inputs each must be the folder of a mission", str(path))
    _refuse_options(paths[0], how, "several inputs are missions")
    return FORMATS["dives"].read(how, paths)


def _refuse_options(path: str | Path, how: Reading, why: str) -> None:
    """Refuse the options of files for a folder."""
    if how.dialect != "auto":
        raise OptionError("dialect", how.dialect, f"auto: {why}")
    formats.refuse_needless(str(path), "mission", how)
    check_convention(how.convention)


def _refuse_elevation(elevation: str | None, name: str | Path) -> None:
    """Refuse what is said about the elevation where there is no mission."""
    if elevation is not None:
        raise OptionError("elevation", elevation, f"None: {name} is no folder of a mission, whose contacts have one")


def _parsed(data: bytes, path: str, how: Reading) -> Read:
    """The graph of the bytes of a file, without its warnings; errors as for `load`."""
    row, reason = formats.by_content(data, path) if how.dialect == "auto" else (FORMATS[how.dialect], "as asked for")
    row = FORMATS["g2o"] if row is None else row  # whose reader reads all dialects
    formats.refuse_needless(path, row.name, how, row.options)
    graph, values, report = row.read(how, data, path)
    report.reason = report.reason or reason
    for note in not_there(how.ignore_tags, report.tags) if how.ignore_tags else ():
        report.warn(note)
    return graph, values, report


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
    if FORMATS[formats.format_of(path, dialect)].measurements:  # of others nobody expects more
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
    row = FORMATS[formats.check_dialect(formats.format_of(path, dialect), formats.outputs())]
    notes = left_out(report, row.name)
    if renumber:
        from nls.io.variable_names import renumbered

        formats.check_renumber(row.name)
        graph, values, changes = renumbered(graph, values, report)
        notes += changes
    data, more = row.written(path, graph, values, report)
    if not row.measurements:
        more = more + measurements_left_out("trajectory" if row.poses_alone else row.name, graph)
    return data, notes + more
