"""Pictures as files."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from nls.io.files import write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["write_picture"]


def write_picture(path: str | Path, figure: Figure) -> None:
    """Write a figure in the format of the suffix (png, pdf, svg), replaced whole or not at all.

    Raises
    ------
    GraphFileError
        It cannot be written.
    """
    drawn = BytesIO()
    figure.savefig(drawn, format=Path(path).suffix[1:].lower(), dpi=150)
    write_bytes(path, drawn.getvalue())
