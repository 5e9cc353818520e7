"""Small logs and their mappings as mission tables, for the tests of the import."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from models.algebra import Array
from nls import GraphFileError
from nls.missions.importing import Imported, Mapping, draft, import_logs

__all__ = ["column", "drafted", "imported", "line", "refused", "table"]


def written(folder: Path, logs: dict[str, str | bytes]) -> list[Path]:
    paths = [folder / f"{name}.csv" for name in logs]
    for path, text in zip(paths, logs.values(), strict=True):
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return paths


def imported(folder: Path, mapping: str, **logs: str | bytes) -> Imported:
    """The import of files of this text, ``dvl="..."`` in dvl.csv."""
    return import_logs(written(folder, logs), Mapping(mapping, "mapping.toml"))


def drafted(folder: Path, **logs: str | bytes) -> str:
    """The draft of a mapping of such files."""
    return draft(written(folder, logs))


def refused(folder: Path, mapping: str, **logs: str | bytes) -> str:
    """What the import of such files says that it cannot be."""
    with pytest.raises(GraphFileError) as error:
        imported(folder, mapping, **logs)
    return str(error.value)


def column(folder: Path, name: str, mapping: str, **logs: str | bytes) -> list[float]:
    """A column of the import of such files, ``depth.z_m``."""
    return list(table(imported(folder, mapping, **logs), name.split(".")[0])[name.split(".")[1]].tolist())


def line(result: Imported, name: str, number: int = 1) -> str:
    """A line of a table; line 0 has the names."""
    return result.files[f"{name}.csv"].decode().splitlines()[number]


def table(result: Imported, name: str) -> dict[str, Array]:
    """The columns of a table, which are all numbers."""
    head, *rows = result.files[f"{name}.csv"].decode().splitlines()
    numbers = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    return dict(zip(head.split(","), numbers.T, strict=True))
