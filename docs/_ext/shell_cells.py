"""Cells with the magic ``%%bash``: shown without it, as one types into a shell, with the output as it was printed.

IPython hands over the output of a shell 100 bytes at a time, and myst-nb, which joins the parts, begins a new line with
each. So they are joined before.
"""

from __future__ import annotations

from typing import Any

from docutils import nodes
from myst_nb.core import render
from nbformat import NotebookNode
from sphinx.application import Sphinx

__all__ = ["joined", "setup"]


def joined(outputs: list[NotebookNode]) -> list[NotebookNode]:
    r"""The outputs of a cell, the texts of each stream in one piece.

    Examples
    --------
    >>> parts = [NotebookNode(output_type="stream", name="stdout", text=text) for text in ("180 loop clo", "sures\n")]
    >>> [output.text for output in joined(parts)]
    ['180 loop closures\n']
    """
    merged: list[NotebookNode] = []
    streams: dict[str, NotebookNode] = {}
    for output in outputs:
        if output["output_type"] != "stream":
            merged.append(output)
        elif output["name"] in streams:
            streams[output["name"]]["text"] += output["text"]
        else:
            streams[output["name"]] = NotebookNode(output)
            merged.append(streams[output["name"]])
    return merged


def _show(app: Sphinx, doctree: nodes.document) -> None:
    for block in list(doctree.findall(nodes.literal_block)):
        magic, _, lines = block.astext().partition("\n")
        if magic.startswith("%%bash"):
            block.replace_self(nodes.literal_block(lines, lines, classes=block["classes"], language="sh"))


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    coalesce = render.coalesce_streams
    render.coalesce_streams = lambda outputs: coalesce(joined(outputs))
    app.connect("doctree-read", _show)
    return {"parallel_read_safe": True}
