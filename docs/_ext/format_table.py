"""The directive ``format-table``: one line for every sort of file, made from the rows of `nls.io.formats.FORMATS`.

Formats of one section and the same contents share a line. Only what no row knows stands here: what makes a folder a
mission, and who writes one. A link is to the section of the page that describes the format.
"""

from __future__ import annotations

from typing import Any

from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from nls.io.formats import FORMATS, Format

__all__ = ["FormatTable", "lines", "setup"]

FOLDERS = {  # by the section of the page: a folder with what, and who writes it
    "mission-folders": ("folder with `odometry.csv`, `dvl.csv` or `path.csv`", "`nls.missions.write_mission`"),
    "scan-missions": ("folder with `keyframes.csv`", "`nls-sim harbor`"),
}


def lines() -> list[str]:
    """The table in Markdown."""
    groups: dict[tuple[str, str], list[Format]] = {}
    for row in sorted(FORMATS.values(), key=lambda row: not row.whole):  # what holds everything comes first
        groups.setdefault((row.section, row.holds), []).append(row)
    return ["| file | holds | read by | written by |", "|---|---|---|---|", *map(_line, groups.values())]


def _line(rows: list[Format]) -> str:
    first = rows[0]
    suffixes = dict.fromkeys(suffix for row in rows for suffix in row.suffixes)
    name, writer = FOLDERS.get(first.section, (", ".join(f"`{suffix}`" for suffix in suffixes), "`nls convert`"))
    writer = "`nls.save`" if first.measurements and first.writer else writer
    loads, poses = any(row.loads or row.folder for row in rows), any(row.poses_alone for row in rows)
    reader = "`nls.load`" if loads else "`nls evaluate`" if poses else ""
    return f"| [{name}](#{first.section}) | {first.holds} | {reader} | {writer} |"


class FormatTable(SphinxDirective):
    """The table."""

    def run(self) -> list[Any]:
        return self.parse_text_to_nodes("\n".join(lines()))


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("format-table", FormatTable)
    return {"parallel_read_safe": True}
