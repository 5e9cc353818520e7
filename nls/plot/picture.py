"""Figures and the axes they are drawn in, a legend that covers nothing, and pictures as files."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from models.visible import CONTROLS, visible
from nls.io.files import write_bytes
from nls.plot.style import REJECTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of this size, inch."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def axes_or_new(axes: Axes | None, size: tuple[float, float], **options: Any) -> Axes:
    """The axes given, or those of a new figure of this size, inch."""
    return new_figure(*size).add_subplot(**options) if axes is None else axes


def name_plane(axes: Axes, x: str = "x [m]", y: str = "y [m]", **options: Any) -> None:
    """The names of the axes of a map, one scale for both, and what else is set, such as a title."""
    axes.set(xlabel=x, ylabel=y, **options)
    axes.set_aspect("equal", adjustable="datalim")


def add_lines(axes: Axes, segments: Any, **style: Any) -> None:
    """Draw lines through the places (n, k, 2 or 3) in one piece."""
    if axes.name == "3d":
        from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

        axes.add_collection3d(Line3DCollection(segments, **style))  # type: ignore[attr-defined]
    else:
        from matplotlib.collections import LineCollection

        axes.add_collection(LineCollection(segments, **style))


def figure_of(axes: Axes) -> Figure:
    """The figure that holds the axes."""
    figure = axes.get_figure()
    assert figure is not None
    return figure  # type: ignore[return-value]


def legend_below(*panels: Axes) -> None:
    """A legend under axes and their twins, in as many rows as it needs, where it covers nothing."""
    axes, pairs = panels[0], [panel.get_legend_handles_labels() for panel in panels]
    handles, labels = ([entry for entries in column for entry in entries] for column in zip(*pairs, strict=True))
    # 13 letters of a legend in an inch
    room = 13 * axes.get_position().width * figure_of(axes).get_size_inches()[0]
    rows = min(len(labels), int(np.ceil(sum(len(label) + 5 for label in labels) / room)))
    # 4 lines for the numbers and the name of the axis
    style: dict[str, Any] = {"bbox_to_anchor": (0.5, 0), "borderaxespad": 4, "fontsize": 8, "frameon": False}
    axes.legend(handles, labels, loc="upper center", ncols=-(-len(labels) // rows), **style)


def full_legend(axes: Axes, columns: int = 2, outside: bool = True) -> None:
    """A legend of some axes, below the figure or inside, whose lines are seen however faint those of the map are."""
    from matplotlib.lines import Line2D

    handles, labels = axes.get_legend_handles_labels()
    if outside:
        style: dict[str, Any] = {"loc": "outside lower center", "ncols": columns, "frameon": False}
        legend = figure_of(axes).legend(handles, labels, fontsize=9, **style)
    else:
        legend = axes.legend(handles, labels, loc="best", fontsize=8)
    for handle in legend.legend_handles:
        if isinstance(handle, Line2D):
            handle.set_alpha(1.0)


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
