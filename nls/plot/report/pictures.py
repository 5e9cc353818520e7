"""Figures as parts of the page: as SVG or PNG, whichever is smaller, and the same bytes every time."""

from __future__ import annotations

import base64
from io import BytesIO
from typing import TYPE_CHECKING

from nls.plot.report.markup import Html, tag

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["picture"]

SMALL = 1000  # lines and dots; pictures of more are not even tried as SVG (sphere2500's R: 216 MB, 0.06 MB)
LIGHT = 60_000  # bytes; an SVG of less is taken as it is
DPI = 170
WIDE = 7.0  # inches; wider ones have the page for themselves


def picture(figure: Figure, alt: str, caption: str, size: int, inches: tuple[float, float] | None = None) -> Html:
    """One figure of the page.

    Parameters
    ----------
    figure, alt, caption : what it shows, for those who see it, those who do not, and both.
    size : lines and dots it draws: variables and measurements of a map, numbers of a matrix.
    inches : to draw it larger or smaller than it is; letters keep their size.
    """
    if inches is not None:
        figure.set_size_inches(*inches)
    width, height = figure.get_size_inches()
    kind, data = "svg+xml", _drawn(figure, "svg") if size <= SMALL else b""
    if not 0 < len(data) < LIGHT:
        dots = _drawn(figure, "png")
        kind, data = (kind, data) if 0 < len(data) < len(dots) else ("png", dots)
    shown = tag(
        "img",
        src=f"data:image/{kind};base64,{base64.b64encode(data).decode()}",
        alt=alt,
        width=round(100 * width),
        height=round(100 * height),
    )
    return tag("figure", shown, tag("figcaption", caption), class_="wide" if width > WIDE else "map")


def _drawn(figure: Figure, kind: str) -> bytes:
    """The file of a figure, without dates and chance names."""
    from matplotlib import rc_context

    out = BytesIO()
    with rc_context({"svg.hashsalt": "leadline"}):
        figure.savefig(out, format=kind, dpi=DPI, metadata={"Software" if kind == "png" else "Date": None})
    return out.getvalue()
