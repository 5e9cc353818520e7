"""The directive ``overview``: a list of pages, each with the sentence it opens with, and the same list in the sidebar.

The content is a list of links, ``- [Title](page.md)``, relative to the folder of the page that holds the directive: a
code host shows it as it stands. The title is that of the page. The sentence is its first paragraph after the title that
is set in italics. A page without one, or with another title, is a warning, and warnings end the build.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

__all__ = ["Overview", "setup"]

OPENING = re.compile(r"^# (.+?)\n\n\*(?!\*)(.+?)\*\n", flags=re.MULTILINE | re.DOTALL)
LINK = re.compile(r"- \[(.+)\]\((.+)\)")


def opening(path: Path) -> tuple[str, str] | None:
    """The title of a page or a notebook and the sentence it opens with; None if it has none."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        text = "".join(json.loads(text)["cells"][0]["source"]) + "\n"
    match = OPENING.search(text)
    return match and (match[1], " ".join(match[2].split()))


class Overview(SphinxDirective):
    """The list."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        folder = Path(self.env.doc2path(self.env.docname)).parent
        listed, lines = [], []
        for line in filter(str.strip, self.content):
            link = LINK.fullmatch(line)
            if link is None or not (folder / link[2]).is_file():
                raise ExtensionError(f"overview: {line!r} is no link to a page, as - [Title](page.md), in {folder}")
            path = folder / link[2]
            title, sentence = opening(path) or (None, "")
            if title != link[1]:
                problem = f"is called {title!r}, not {link[1]!r}" if title else "opens with no sentence in italics"
                logging.getLogger(__name__).warning("overview: %s %s", link[2], problem)
                continue
            self.env.note_dependency(str(path))
            listed.append(link[2].rpartition(".")[0])
            lines.append(f"**[]({link[2]})**\n: {sentence}\n")
        toctree = ["```{toctree}", ":hidden:", "", *listed, "```", ""]
        return self.parse_text_to_nodes("\n".join([*toctree, *lines]))


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("overview", Overview)
    return {"parallel_read_safe": True}
