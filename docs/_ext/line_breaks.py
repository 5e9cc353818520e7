"""Where lines may break: not between a formula and the comma after it, and anywhere in sentences that a cell printed.

A formula is a box to a browser, which may put the mark that follows it on the next line: both are kept in one span. A
printed sentence is one line, however long; its block gets the class ``prose``, and ``columns`` where other lines are
aligned, so that the style sheet can wrap the one and let the other scroll.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

__all__ = ["printed", "setup"]

MARK = re.compile(r"[,.;:!?)\]]+")
COLUMNS = re.compile(r"\S {2,}\S")
FITS = 44  # characters that a phone shows; a page 1280 pixels wide shows 85, and wraps none of them


def printed(text: str) -> list[str]:
    r"""Classes of a printed block: none where no line is long, or a long one is numbers.

    Examples
    --------
    >>> printed("chi2 fell by 6e-09\n" + "the values given are not the optimum " * 3)
    ['prose']
    >>> printed("kind     chi2\nsteps   15.2\n" + "a closure is probably wrong: " * 4)
    ['prose', 'columns']
    >>> printed("0.25 " * 30)
    []
    """
    lines = text.splitlines()
    long = [re.sub(r"\s", "", line) for line in lines if len(line) > FITS]
    if not long or any(2 * sum(map(str.isalpha, line)) < len(line) for line in long):
        return []
    return ["prose", "columns"] if any(COLUMNS.search(line) for line in lines) else ["prose"]


def _mark(app: Sphinx, doctree: nodes.document) -> None:
    for formula in list(doctree.findall(nodes.math)):
        follows = formula.next_node(descend=False, siblings=True)
        mark = isinstance(follows, nodes.Text) and MARK.match(follows)
        if mark:
            parent, k = formula.parent, formula.parent.index(formula)
            parent[k : k + 2] = [
                nodes.inline("", "", formula, nodes.Text(mark[0]), classes=["together"]),
                nodes.Text(follows[mark.end() :]),
            ]
    for block in doctree.findall(nodes.literal_block):
        if "output" in block["classes"]:
            block["classes"] += printed(block.astext())


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.connect("doctree-read", _mark)
    return {"parallel_read_safe": True}
