"""The directive ``gallery``: the graphs of the gallery, run now, with the sentence of each.

The tests run the same list. A case that does not say what it should, or whose cure does not work, ends the build.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.nls.explanation.gallery import FILE, PRELUDE, Case, problems, run
from tests.nls.explanation.gallery_cases import CHAPTERS

__all__ = ["Gallery", "setup"]

SAID = re.compile(r"^said = (nls\.\w+)\(", flags=re.MULTILINE)


class Gallery(SphinxDirective):
    """All chapters; with the argument ``prelude`` the lines that stand before every case."""

    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        if self.arguments == ["prelude"]:
            return [_code(PRELUDE)]
        return [self._section(title, [self._case(case) for case in cases]) for title, cases in CHAPTERS.items()]

    def _case(self, case: Case) -> nodes.section:
        outcome = run(case)
        if wrong := problems(case, outcome):
            raise ExtensionError(f"gallery: {case.title}: {'; '.join(wrong)}")
        parts: list[nodes.Node] = []
        if case.file:
            parts += [nodes.paragraph(text=f"{FILE}:"), _code(_shown(case.file), "text")]
        parts += [_code(case.broken), _said(outcome.error or _speaker(case.broken), outcome.sentence, "error")]
        if outcome.finding:
            text = "\n".join([outcome.finding.says, *(f"-> {advice}" for advice in outcome.finding.advice)])
            parts.append(_said("What nls.explain says", text, "hint"))
        if case.cured_file:
            parts += [nodes.paragraph(text=f"Cure, in {FILE}:"), _code(case.cured_file, "text")]
        if case.cure:
            parts += [nodes.paragraph(text="Then:" if case.cured_file else "Cure:"), _code(case.cure)]
        return self._section(case.title, parts)

    def _section(self, title: str, parts: list[Any]) -> nodes.section:
        section = nodes.section("", nodes.title(text=title), *parts, names=[nodes.fully_normalize_name(title)])
        self.state.document.note_implicit_target(section, section)
        return section


def _said(title: str, sentence: str, kind: str) -> nodes.admonition:
    said = nodes.admonition("", nodes.title(text=title), classes=[kind])
    said += nodes.paragraph("", "", nodes.literal(text=sentence))  # literal: quotes stay as they are
    return said


def _speaker(broken: str) -> str:
    """Who says it where nothing is raised: the function that the last assignment to `said` calls, or the result."""
    asked = SAID.search(broken)
    return f"What {asked[1] if asked else 'the result'} says"


def _code(text: str, language: str = "python") -> nodes.literal_block:
    return nodes.literal_block(text.strip(), text.strip(), language=language, classes=["wraps"])


def _shown(content: str | bytes) -> str:
    """Content of a file; of one that is no text, its bytes as Python writes them."""
    return repr(content)[2:-1] if isinstance(content, bytes) else content


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("gallery", Gallery)
    return {"parallel_read_safe": True}
