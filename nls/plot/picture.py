"""Pictures as files."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from nls.io.files import write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["drawn", "write_picture"]


def write_picture(path: str | Path, figure: Figure) -> None:
    """Write a figure in the format of the suffix (png, pdf, svg), replaced whole or not at all.

    Raises
    ------
    GraphFileError
        It cannot be written.
    """
    write_bytes(path, drawn(path, figure))


def drawn(path: str | Path, figure: Figure) -> bytes:
    """The bytes `write_picture` writes."""
    picture = BytesIO()
    figure.savefig(picture, format=Path(path).suffix[1:].lower(), dpi=150)
    return picture.getvalue()
