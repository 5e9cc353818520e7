"""Files: `load` reads a graph, its start and a report; `save` writes one that reads back the same."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

from models.errors import GraphWarning, OptionError
from nls.graph import FactorGraph
from nls.io.dialects import FORMATS, check_dialect
from nls.io.files import read_bytes
from nls.io.read import read_graph
from nls.io.report import LoadReport
from nls.io.trajectory import read_kitti, read_tum, write_kitti, write_tum
from nls.io.write import write_graph
from nls.values import Values

__all__ = ["DIALECTS", "LoadReport", "load", "read_kitti", "read_tum", "save", "write_kitti", "write_tum"]

DIALECTS = ("auto", *FORMATS, "pyfg", "bal")
BAL = re.compile(rb"\s*[0-9]+[ \t]+[0-9]+[ \t]+[0-9]+[ \t\r]*(?:\n|$)")  # three counts on the first line
POSE = re.compile(rb"VERTEX_SE[23]\S*[ \t]+\S+[ \t]+(\S*)")  # its second word
NAME = re.compile(rb"[A-Za-z]+[0-9]+")


def load(
    path: str | Path, convention: str = "g2o", dialect: str = "auto", repair_information: bool = False
) -> tuple[FactorGraph, Values, LoadReport]:
    """Read a graph file (also gzip-compressed).

    Parameters
    ----------
    path : the file.
    convention : residual of pose measurements, see `factors.conventions`.
    dialect : ``auto`` goes by the content: ``g2o``, ``toro``, ``isam``, ``isam-covariance``, ``graph`` (see
        `nls.io.dialects`), ``pyfg`` or ``bal``. Files whose lines have several readings must be named.
    repair_information : replace information matrices with negative eigenvalues by the nearest semi-definite ones (with
        a warning) instead of refusing the file.

    Returns
    -------
    graph, values, report

    Raises
    ------
    GraphFileError
        The file cannot be right; says where. Or its lines have several readings.
    ResourceLimitError
        The file, or what it unpacks to, is too large.
    OptionError
        No such dialect or convention.

    Examples
    --------
    >>> import nls
    >>> nls.load("missing.g2o")
    Traceback (most recent call last):
        ...
    models.errors.GraphFileError: missing.g2o: cannot be read: No such file or directory
    """
    check_dialect(dialect, DIALECTS)
    data = read_bytes(path)
    if dialect == "auto":
        dialect = _foreign(data, str(path))
    if dialect == "bal":
        from nls.io.bal import read_bal

        return read_bal(data, str(path))
    if dialect == "pyfg":
        from nls.io.pyfg import read_pyfg

        return read_pyfg(data, str(path), convention)
    graph, values, report = read_graph(data, str(path), convention, dialect, repair_information)
    for note in report.warnings:
        warnings.warn(f"{path}: {note}", GraphWarning, stacklevel=2)
    return graph, values, report


def _foreign(data: bytes, path: str) -> str:
    """The formats that are no list of tagged lines with ids: ``bal``, ``pyfg``; else ``auto``."""
    first = POSE.search(data, 0, 1 << 16)
    if path.lower().removesuffix(".gz").endswith(".pyfg") or (
        first and NAME.fullmatch(first[1])
    ):  # a time, then a name
        return "pyfg"
    return "bal" if BAL.match(data) else "auto"


def save(
    path: str | Path,
    graph: FactorGraph,
    values: Values,
    report: LoadReport | None = None,
    dialect: str | None = None,
) -> None:
    """Write a graph file, replaced whole or not at all.

    Parameters
    ----------
    path : the file; compressed where the name ends in ``.gz``.
    graph, values : what to write.
    report : the report the graph was read with: its unused lines are appended as they were, and its times kept.
    dialect : as for `load`; when omitted ``pyfg`` for a name that ends so, else ``g2o``.

    Raises
    ------
    GraphError
        A factor or kind of variable the format has no line for; a variable without a value; mixed conventions.
    GraphFileError
        The file cannot be written.
    OptionError
        No such dialect; a name ending in ``.graph`` without one, which may mean TORO or covariances.
    """
    suffix = Path(str(path).lower().removesuffix(".gz")).suffix
    if dialect is None:
        if suffix == ".graph":
            raise OptionError("dialect", None, "toro or graph for a file *.graph: information or covariance")
        dialect = "pyfg" if suffix == ".pyfg" else "g2o"
    check_dialect(dialect, DIALECTS[1:])
    if dialect == "bal":
        from nls.io.bal import write_bal

        if report is not None and report.ignored:
            raise OptionError("report", report.ignored[0], "no unused lines: a bundle-adjustment file holds no others")
        write_bal(path, graph, values)
    elif dialect == "pyfg":
        from nls.io.pyfg import write_pyfg

        write_pyfg(path, graph, values, report)
    else:
        write_graph(path, graph, values, report.ignored if report else [], FORMATS[dialect])
