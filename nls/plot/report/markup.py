"""HTML from pieces: text is escaped wherever it comes from, only what was built here is markup."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from models.visible import visible

EMPTY = {"img", "meta"}  # elements without content


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
