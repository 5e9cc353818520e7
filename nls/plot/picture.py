"""Pictures as files."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from models.visible import CONTROLS, visible
from nls.io.files import write_bytes
from nls.plot.style import REJECTED

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_picture(path: str | Path, figure: Figure, doubts: Sequence[str] = ()) -> None:
    """Write a figure in the format of the suffix (png, pdf, svg), replaced whole or not at all.

    Parameters
    ----------
    doubts : why its result is doubtful; above the picture.

    Raises
    ------
    GraphFileError
        It cannot be written.
    """
    if doubts:
        # 14 letters in an inch of the line that marks a picture
        words = textwrap.fill(f"doubtful: {'; '.join(doubts)}", int(14 * figure.get_figwidth()))
        figure.suptitle("\n".join(filter(None, [figure.get_suptitle(), words])), color=REJECTED, fontsize=9)
    write_bytes(path, drawn(path, figure))


def escape_controls(figure: Figure) -> None:
    """Escape what a name of a file, a kind or a landmark may have and a picture must not."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        if isinstance(text, Text) and CONTROLS.search(text.get_text()):
            text.set_text(visible(text.get_text()))


def drawn(path: str | Path, figure: Figure) -> bytes:
    """The bytes `write_picture` writes."""
    escape_controls(figure)
    picture = BytesIO()
    figure.savefig(picture, format=Path(path).suffix[1:].lower(), dpi=150)
    return picture.getvalue()
