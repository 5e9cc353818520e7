"""Columns of numbers from a text file, plain or gzip-compressed; tables of a mission by a mapping of the docs."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from models.algebra import Array
from models.errors import GraphFileError
from nls.io.files import read_bytes
from nls.missions.importing import Mapping, import_logs

__all__ = ["columns", "or_compressed", "tables"]

MISSIONS = Path(__file__).parents[3] / "docs" / "missions"

QUOTED = 200  # characters of the error of NumPy, which quotes the whole word


def columns(path: Path, names: Sequence[str] | None, skip: int = 1) -> Array:
    """The named columns (n, k) of a comma-separated file with a header, or all of a file (skip = 0: without a header).

    Raises
    ------
    GraphFileError
        It cannot be read, has no such column, no rows, or words that are no numbers.
    """
    data = read_bytes(path)
    use = None
    if names is not None:
        header = data.split(b"\n", 1)[0].decode(errors="replace").strip().split(",")
        missing = [name for name in names if name not in header]
        if missing:
            raise GraphFileError(f"has no column {missing[0]!r}; its header is {str(header)[:QUOTED]}", str(path), 1)
        use = [header.index(name) for name in names]
    rows = data.split(b"\n")[skip:]
    if not any(row.strip() for row in rows):
        raise GraphFileError("has no rows", str(path))
    try:
        return np.loadtxt(io.BytesIO(b"\n".join(rows)), delimiter=",", usecols=use, ndmin=2)
    except ValueError as error:
        raise GraphFileError(f"is no table of numbers after line {skip}: {str(error)[:QUOTED]}", str(path)) from error


def tables(name: str, logs: Sequence[Path], zero: float | None = None) -> dict[str, Array]:
    """Tables (n, columns) that `nls import` makes of logs by a mapping of docs/missions; an empty cell is NaN.

    Times are seconds from `zero`, s since 1970, where it is given.
    """
    path = MISSIONS / f"{name}.toml"
    head = "" if zero is None else f"time_zero = {zero!r}\n"
    files = import_logs(logs, Mapping(head + path.read_text(encoding="utf-8"), str(path))).files
    return {
        file.removesuffix(".csv"): np.genfromtxt(io.BytesIO(content), delimiter=",", skip_header=1)
        for file, content in files.items()
        if file.endswith(".csv")
    }


def or_compressed(folder: str | Path, name: str) -> Path:
    """The file of a folder, or its compressed twin ``name.gz`` where only that is there."""
    path = Path(folder) / name
    twin = path.with_name(f"{name}.gz")
    return twin if twin.exists() and not path.exists() else path
