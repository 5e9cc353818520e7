"""HTML from pieces: text is escaped wherever it comes from, only what was built here is markup.

Figures are SVG or PNG, whichever is smaller and the same every time; small bars stand inside of tables.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from models.visible import visible
from nls.plot.picture import escape_controls

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EMPTY = {"img", "meta"}  # elements without content
SMALL = 1000  # lines and dots; pictures of more are not even tried as SVG (sphere2500's R: 216 MB, 0.06 MB)
WIDTH, HEIGHT = 208, 20  # pixels of a bar
EDGE = 8  # on both sides of the scale


class Html(str):
    """Markup, as opposed to text that has to be escaped."""

    __slots__ = ()


def joined(parts: Iterable[str], between: str = "") -> Html:
    """Markup and text one after the other.

    Examples
    --------
    >>> joined(["a < b", tag("b", "!")])
    'a &lt; b<b>!</b>'
    """
    pieces = (piece if isinstance(piece, Html) else escape(visible(piece)) for piece in parts)
    return Html(escape(between).join(pieces))


def tag(name: str, /, *inside: str, **attributes: str | float) -> Html:
    """One element; the underscore of ``class_`` is dropped.

    Examples
    --------
    >>> tag("p", "<script>", class_="note")
    '<p class="note">&lt;script&gt;</p>'
    """
    written = "".join(f' {key.rstrip("_")}="{escape(visible(str(value)))}"' for key, value in attributes.items())
    return Html(f"<{name}{written}>" if name in EMPTY else f"<{name}{written}>{joined(inside)}</{name}>")


def section(name: str, heading: str, *inside: str) -> Html:
    """A section with its heading; `name` is what links lead to."""
    return tag("section", joined([tag("h2", heading), *inside], "\n"), id=name)


def listed(items: Iterable[tuple[str, str]], **attributes: str) -> Html:
    """Terms and what they are."""
    rows = (tag("div", tag("dt", term), tag("dd", description)) for term, description in items)
    return tag("dl", *rows, **attributes)


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]], numbers: Iterable[int] = ()) -> Html:
    """A table that scrolls by itself where the page is narrow.

    Parameters
    ----------
    caption, heads, rows : what it shows; the first column names its row.
    numbers : columns of numbers, aligned to the right.
    """
    right = set(numbers)

    def cell(name: str, column: int, content: str, **attributes: str) -> Html:
        return tag(name, content, **attributes, **({"class_": "number"} if column in right else {}))

    head = tag("thead", tag("tr", *(cell("th", k, content, scope="col") for k, content in enumerate(heads))))
    body = [
        tag("tr", cell("th", 0, row[0], scope="row"), *(cell("td", k, content) for k, content in enumerate(row[1:], 1)))
        for row in rows
    ]
    return tag("div", tag("table", tag("caption", caption), head, tag("tbody", joined(body, "\n"))), class_="scroll")


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
    # an SVG below 60 kB is taken as it is
    if not 0 < len(data) < 60_000:
        dots = _drawn(figure, "png")
        kind, data = (kind, data) if 0 < len(data) < len(dots) else ("png", dots)
    source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    shown = tag("img", src=source, alt=alt, width=round(100 * width), height=round(100 * height))
    # pictures wider than 7 inches have the page for themselves
    return tag("figure", shown, tag("figcaption", caption), class_="wide" if width > 7.0 else "map")


def _drawn(figure: Figure, kind: str) -> bytes:
    """The file of a figure, without dates and chance names."""
    from matplotlib import rc_context

    escape_controls(figure)
    out = BytesIO()
    with rc_context({"svg.hashsalt": "leadline"}):
        figure.savefig(out, format=kind, dpi=170, metadata={"Software" if kind == "png" else "Date": None})
    return out.getvalue()


def across(low: float, high: float, ratio: float, other_ratios: Sequence[float]) -> Html:
    """A band from `low` to `high`, a line at 1 and a dot at `ratio`, on a scale of logarithms.

    Parameters
    ----------
    low, high, ratio : around 1.
    other_ratios : all numbers of the table, which has one scale.
    """
    above = [other_ratio for other_ratio in other_ratios if other_ratio > 0]
    # the scale reaches at least from 1/2 to 2
    reach = max([float(np.log(2.0)), *(abs(float(np.log(other_ratio))) for other_ratio in above)])

    def at(number: float) -> float:
        place = np.log(number) / reach if number > 0 else -1.0
        return round(float(WIDTH / 2 + (WIDTH / 2 - EDGE) * place), 1)

    color = "var(--good)" if low <= ratio <= high else "var(--hot)"
    begin, end, middle = at(low), at(high), HEIGHT / 2
    return tag(
        "svg",
        tag("line", x1=EDGE, x2=WIDTH - EDGE, y1=middle, y2=middle, stroke="var(--line)"),
        tag("rect", x=begin, y=4, width=round(max(end - begin, 2.0), 1), height=HEIGHT - 8, fill="var(--line)"),
        tag("line", x1=at(1.0), x2=at(1.0), y1=2, y2=HEIGHT - 2, stroke="var(--quiet)"),
        tag("circle", cx=at(ratio), cy=middle, r=5, fill=color),
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        role="img",
        **{"aria-label": f"{ratio:.3g}, where {low:.3g} to {high:.3g} is expected"},
    )


def bar(share: float) -> Html:
    """A bar of a part of the width, between 0 and 1."""
    length = max(round(WIDTH * share, 1), 1.0)
    shape = tag("rect", x=0, y=4, width=length, height=HEIGHT - 8, fill="var(--ink)")
    return tag("svg", shape, viewBox=f"0 0 {WIDTH} {HEIGHT}", **{"aria-hidden": "true"})
