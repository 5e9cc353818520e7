"""The directive ``factor-table``: one row for every public factor, taken from its docstring.

A factor that is added to `factors` appears without an edit here. What the table needs and does not find, an equation
or the noise, is a warning, and warnings end the build.
"""

from __future__ import annotations

import inspect
import re
from typing import Any

from docutils import nodes
from numpydoc.docscrape import NumpyDocString
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

import factors

__all__ = ["FactorTable", "public_factors", "row", "setup"]

HEADER = ("factor", "prediction", "variables", "measured, and its noise")
WIDTHS = (20, 30, 24, 26)
MEASURED = (("z", "noise"), ("limit", "softness"), ("factor", "G"))  # a measurement, a bound, or what shifts another
CALIBRATIONS = ("offset", "key", "scale", "yaw")  # variables that may stand behind the measurement
JACOBIAN = re.compile(r"[HJ](_| =)")
EQUATION = re.compile(r"^\.\. math::(.*?)(?:\n[ \t]*\n|\Z)", flags=re.MULTILINE | re.DOTALL)


def public_factors() -> list[type[factors.Factor]]:
    """Every class of `factors.__all__` that can be put into a graph, by name."""
    public = (getattr(factors, name) for name in sorted(factors.__all__))
    return [c for c in public if inspect.isclass(c) and issubclass(c, factors.Factor) and not inspect.isabstract(c)]


def row(factor: type[factors.Factor]) -> dict[str, Any]:
    """What the docstring says: meaning, prediction (the equation without its Jacobians), variables, z and noise.

    Raises
    ------
    KeyError
        The docstring has no equation, or does not describe z and the noise (of a bound: limit and softness).
    """
    text = inspect.getdoc(factor) or ""
    equation = r", \quad ".join(line.strip().rstrip(",") for line in EQUATION.findall(text))
    if not equation:
        raise KeyError("an equation, '.. math::'")
    said = {p.name: " ".join(p.type.split() + " ".join(p.desc).split()) for p in NumpyDocString(text)["Parameters"]}
    names = list(said)
    measured = next((pair for pair in MEASURED if set(pair) <= set(names)), None)
    if measured is None:
        raise KeyError(" or ".join(f"parameters '{value}' and '{noise}'" for value, noise in MEASURED))
    before = names[: names.index(measured[0])]
    variables = [*before, *(name for name in names if name in CALIBRATIONS and name not in before)]
    return {
        "meaning": text.split("\n\n")[0].replace("\n", " "),
        "prediction": [e for e in re.split(r",\s*\\quad\s*", equation) if not JACOBIAN.match(e)],
        "variables": [(name, said[name]) for name in variables],
        "measured": [(name, said[name]) for name in measured],
    }


class FactorTable(SphinxDirective):
    """The table."""

    def run(self) -> list[nodes.Node]:
        body = nodes.tbody()
        for factor in public_factors():
            try:
                body += self._row(factor)
            except KeyError as missing:
                logging.getLogger(__name__).warning(
                    "factor-table: the docstring of %s lacks %s", factor.__name__, missing, location=self.get_location()
                )
        head = nodes.thead("", nodes.row("", *(nodes.entry("", nodes.paragraph(text=title)) for title in HEADER)))
        columns = [nodes.colspec(colwidth=width) for width in WIDTHS]
        return [nodes.table("", nodes.tgroup("", *columns, head, body, cols=len(HEADER)), classes=["factors"])]

    def _row(self, factor: type[factors.Factor]) -> nodes.row:
        found = row(factor)
        link = self._text(f"{{py:class}}`~factors.{factor.__name__}`")
        prediction = [nodes.paragraph("", "", nodes.math(text=" ".join(e.split()))) for e in found["prediction"]]
        cells = (
            [link, self._text(found["meaning"])],
            prediction,
            [self._text(f"`{name}`: {text}") for name, text in found["variables"]],
            [self._text(f"`{name}`: {text}") for name, text in found["measured"]],
        )
        return nodes.row("", *(nodes.entry("", *cell) for cell in cells))

    def _text(self, text: str) -> nodes.paragraph:
        inline, _ = self.parse_inline(text, lineno=self.lineno)
        return nodes.paragraph("", "", *inline)


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("factor-table", FactorTable)
    return {"parallel_read_safe": True}
