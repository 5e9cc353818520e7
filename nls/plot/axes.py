"""The axes that a picture is drawn in, and their figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
