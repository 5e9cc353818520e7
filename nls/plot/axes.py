"""The axes that a picture is drawn in, their figure, and a legend that covers nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


ROW = 50  # letters in a row of a legend


def axes_or_new(axes: Axes | None, size: tuple[float, float], **options: Any) -> Axes:
    """The axes given, or those of a new figure of this size, inch."""
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout="constrained").add_subplot(**options) if axes is None else axes


def figure_of(axes: Axes) -> Figure:
    """The figure that holds the axes."""
    figure = axes.get_figure()
    assert figure is not None
    return figure  # type: ignore[return-value]


def legend_below(axes: Axes, handles: Sequence[Artist], labels: Sequence[str]) -> None:
    """A legend under the axes, in one or two rows, where it covers nothing."""
    rows = 1 if len(labels) == 1 or sum(len(label) + 4 for label in labels) <= ROW else 2
    below = (0.5, -0.12)
    columns = -(-len(labels) // rows)
    axes.legend(handles, labels, loc="upper center", bbox_to_anchor=below, fontsize=8, ncols=columns, frameon=False)
