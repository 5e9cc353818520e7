"""Files: `load` reads a graph, its start and a report; `save` writes one that reads back the same."""

from __future__ import annotations

from pathlib import Path

from nls.graph import FactorGraph
from nls.io.files import read_bytes
from nls.io.g2o import read_g2o, write_g2o
from nls.io.report import LoadReport
from nls.values import Values

__all__ = ["LoadReport", "load", "save"]


def load(path: str | Path, convention: str = "g2o") -> tuple[FactorGraph, Values, LoadReport]:
    """Read a graph file (also gzip-compressed).

    Parameters
    ----------
    path : the file.
    convention : residual of pose measurements, see `factors.conventions`.

    Returns
    -------
    graph, values, report

    Raises
    ------
    GraphFileError
        The file cannot be right; says where.
    ResourceLimitError
        The file, or what it unpacks to, is too large.

    Examples
    --------
    >>> import nls
    >>> nls.load("missing.g2o")
    Traceback (most recent call last):
        ...
    models.errors.GraphFileError: missing.g2o: cannot be read: No such file or directory
    """
    return read_g2o(read_bytes(path), str(path), convention)


def save(path: str | Path, graph: FactorGraph, values: Values, ignored: list[str] | None = None) -> None:
    """Write a graph file, replaced whole or not at all.

    Parameters
    ----------
    path : the file, ``*.g2o``, or ``*.g2o.gz`` to compress it.
    graph, values : what to write.
    ignored : lines to append verbatim, ``LoadReport.ignored``.

    Raises
    ------
    GraphError
        A factor or kind of variable the format has no line for; a variable without a value; mixed conventions.
    GraphFileError
        The file cannot be written.
    """
    write_g2o(path, graph, values, ignored)
