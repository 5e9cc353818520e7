"""A link at the head of every notebook to the notebook as it was run, outputs included, for those who work offline.

myst-nb writes the executed notebooks into a folder beside the pages. The repository holds them without outputs.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.addnodes import download_reference
from sphinx.application import Sphinx

__all__ = ["setup"]

TEXT = "Download this notebook with its outputs"


def _link(app: Sphinx, doctree: nodes.document) -> None:
    env = app.env
    if Path(env.doc2path(env.docname)).suffix == ".ipynb":
        executed = Path(env.mystnb_config.output_folder, f"{env.docname}.ipynb")
        target = "/" + Path(os.path.relpath(executed, app.srcdir)).as_posix()
        reference = download_reference("", "", nodes.Text(TEXT), reftarget=target, refdoc=env.docname)
        title = doctree.next_node(nodes.title)
        title.parent.insert(title.parent.index(title) + 1, nodes.paragraph("", "", reference))


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("doctree-read", _link, priority=400)  # before Sphinx collects the files that pages offer
    return {"parallel_read_safe": True}
