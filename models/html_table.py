"""A table as Jupyter shows it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

__all__ = ["html_table"]


def html_table(heading: str, heads: Sequence[str], rows: Iterable[Sequence[str]], notes: Iterable[str] = ()) -> str:
    """HTML of a heading, a table and notes; all text is escaped.

    Examples
    --------
    >>> html_table("a < b", ["", "m"], [["x0", "1"]])
    '<p>a &lt; b</p><table><tr><th></th><th>m</th></tr><tr><td>x0</td><td>1</td></tr></table><ul></ul>'
    """
    from html import escape  # its table of names is a fortieth of a start

    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    listed = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return f"<p>{escape(heading)}</p><table><tr>{head}</tr>{body}</table><ul>{listed}</ul>"
