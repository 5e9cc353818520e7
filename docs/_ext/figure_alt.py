"""Alternative text for the figures that executed cells draw: the titles in the source of the cell, or its section.

A cell that says more in its metadata (``mystnb: image: alt``) keeps what it says. In the dark, figures are turned over.
Sonar images are dark already and keep their shades: they have the class ``sonar``.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

__all__ = ["alternative", "setup"]

TITLE = re.compile(r"""(?:title\(|title=)\s*f?(["'])(.+?)\1""")
SONAR = re.compile(r"(fan|polar)_image\(|cmap=.gray.")
FIELD = re.compile(r"\{[^}]*\}")


def alternative(source: str, section: str) -> str:
    r"""What a figure shows, by the titles its source gives it; fields of f-strings become dots.

    Examples
    --------
    >>> alternative('axes.set_title("before")\nfigure.suptitle(f"after {n} steps")', "A loop")
    'Figure in the section "A loop": before; after … steps'
    >>> alternative("plt.show()", "A loop")
    'Figure in the section "A loop"'
    """
    titles = [FIELD.sub("…", title).replace("\\n", ", ") for _, title in TITLE.findall(source)]
    return f'Figure in the section "{section}"' + (": " + "; ".join(dict.fromkeys(titles)) if titles else "")


def _describe(app: Sphinx, doctree: nodes.document) -> None:
    for image in doctree.findall(nodes.image):
        cell = image.parent
        while cell is not None and not (isinstance(cell, nodes.container) and cell.get("nb_element") == "cell_code"):
            cell = cell.parent
        if cell is None:
            continue
        source = "\n".join(block.astext() for block in cell.findall(nodes.literal_block))
        if SONAR.search(source):
            image["classes"].append("sonar")
        if image.get("alt"):
            continue
        section = cell.parent
        while not isinstance(section, nodes.section):
            section = section.parent
        title = section.next_node(nodes.title)
        image["alt"] = alternative(source, title.astext())


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("doctree-read", _describe)
    return {"parallel_read_safe": True}
