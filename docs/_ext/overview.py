"""The directive ``overview``: a list of pages, each with the sentence it opens with, and the same list in the sidebar.

The content is one page a line, relative to the folder of the page that holds the directive; ``*`` stands for any name.
The sentence is the first paragraph after the title that is set in italics. A page without one is a warning, and
warnings end the build.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

__all__ = ["Overview", "claim", "pages", "setup"]

CLAIM = re.compile(r"^# .*?\n\n\*(?!\*)(.+?)\*\n", flags=re.MULTILINE | re.DOTALL)
PAGE = (".md", ".ipynb")


def claim(path: Path) -> str | None:
    """The sentence a page or a notebook opens with; None if it has none."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        text = "".join(json.loads(text)["cells"][0]["source"]) + "\n"
    found = CLAIM.search(text)
    return found and " ".join(found[1].split())


def pages(folder: Path, patterns: list[str], without: Path) -> list[Path]:
    """The pages that the patterns name, each once, those of one pattern in the order of their names.

    Raises
    ------
    FileNotFoundError
        A pattern names no page.
    """
    found: dict[Path, None] = {}
    for pattern in patterns:
        named = [path for path in sorted(folder.glob(f"{pattern}.*")) if path.suffix in PAGE and path != without]
        if not named:
            raise FileNotFoundError(f"overview: there is no page {pattern!r} in {folder}")
        found |= dict.fromkeys(named)
    return list(found)


class Overview(SphinxDirective):
    """The list."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        here = Path(self.env.doc2path(self.env.docname))
        listed, lines = [], []
        for path in pages(here.parent, [line for line in self.content if line.strip()], here):
            name = path.relative_to(here.parent)
            said = claim(path)
            if said is None:
                logging.getLogger(__name__).warning("overview: %s opens with no sentence in italics", name)
                continue
            self.env.note_dependency(str(path))
            listed.append(str(name.with_suffix("")))
            lines.append(f"**[]({name})**\n: {said}\n")
        toctree = ["```{toctree}", ":hidden:", "", *listed, "```", ""]
        return self.parse_text_to_nodes("\n".join([*toctree, *lines]))


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("overview", Overview)
    return {"parallel_read_safe": True}
