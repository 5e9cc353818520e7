"""Cells with the magic ``%%bash`` are shown without it, as the lines that one types into a shell."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

__all__ = ["setup"]


def _show(app: Sphinx, doctree: nodes.document) -> None:
    for block in list(doctree.findall(nodes.literal_block)):
        magic, _, lines = block.astext().partition("\n")
        if magic.startswith("%%bash"):
            block.replace_self(nodes.literal_block(lines, lines, classes=block["classes"], language="sh"))


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("doctree-read", _show)
    return {"parallel_read_safe": True}
