"""Small logs and their mappings as mission tables, for the tests of the import."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from models.algebra import Array
from nls.missions.importing import Imported, Mapping, import_logs

__all__ = ["imported", "table"]


def imported(folder: Path, mapping: str, **logs: str | bytes) -> Imported:
    """The import of files of this text, ``dvl="..."`` in dvl.csv."""
    paths = []
    for name, text in logs.items():
        paths.append(folder / f"{name}.csv")
        paths[-1].write_bytes(text if isinstance(text, bytes) else text.encode())
    return import_logs(paths, Mapping(mapping, "mapping.toml"))


def table(result: Imported, name: str) -> dict[str, Array]:
    """The columns of a table, which are all numbers."""
    head, *rows = result.files[f"{name}.csv"].decode().splitlines()
    numbers = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    return dict(zip(head.split(","), numbers.T, strict=True))
