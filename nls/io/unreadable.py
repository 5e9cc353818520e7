"""Why a file cannot be read: of one that is not there also the names in its folder that are like it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from models.errors import GraphFileError
from models.listing import some

__all__ = ["refuse_absent", "unreadable"]


def unreadable(path: str | Path, error: OSError) -> GraphFileError:
    """The error for a file or folder that the system does not read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     Path(folder, "survey.g2o").touch()
    ...     for name in ("survye.g2o", "survey.g20", "log.g2o", "log.csv"):
    ...         print(unreadable(Path(folder, name), FileNotFoundError(0, "not there")).message.split("read: ")[1])
    not there; did you mean 'survey.g2o'?
    not there; did you mean 'survey.g2o'?
    not there; its folder has survey.g2o
    not there
    """
    near = _near(Path(path)) if isinstance(error, FileNotFoundError) else ""
    return GraphFileError(f"cannot be read: {error.strerror or error}{near}", os.fspath(path))


def refuse_absent(paths: Iterable[str | Path]) -> None:
    """Refuse files and folders that are not there.

    Raises
    ------
    GraphFileError
        The first of them; see `unreadable`.
    """
    for path in paths:
        try:
            os.stat(path)
        except OSError as error:
            raise unreadable(path, error) from error


def _near(path: Path) -> str:
    """The name in the folder of a missing file that is nearest to its own; else those with its ending."""
    from difflib import get_close_matches

    folder = path.parent
    if not folder.is_dir():
        return f"; there is no folder {str(folder)!r}"
    try:
        names = sorted(name for name in os.listdir(folder) if not name.startswith("."))
    except OSError:
        return ""  # a folder that may be entered and not listed
    like = [name for name in names if Path(name).suffix == path.suffix]
    near = get_close_matches(path.stem, [Path(name).stem for name in like], 1)
    if near := [near[0] + path.suffix] if near else get_close_matches(path.name, [] if like else names, 1):
        return f"; did you mean {near[0]!r}?"
    return f"; its folder has {some(like)}" if like and path.suffix else ""
