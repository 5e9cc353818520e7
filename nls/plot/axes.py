"""The axes that a picture is drawn in, their figure, and a legend that covers nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
    """A legend under the axes, in as many rows as it needs, where it covers nothing."""
    # 13 letters of a legend in an inch
    room = 13 * axes.get_position().width * figure_of(axes).get_size_inches()[0]
    rows = min(len(labels), int(np.ceil(sum(len(label) + 5 for label in labels) / room)))
    below = (0.5, -0.12)
    columns = -(-len(labels) // rows)
    axes.legend(handles, labels, loc="upper center", bbox_to_anchor=below, fontsize=8, ncols=columns, frameon=False)
