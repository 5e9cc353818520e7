"""Broken on purpose: all chapters. Those without files are text, a case as

== title
lines that build the graph
-- Error: words | words               `-- says: words` where nothing is raised; further words in further such lines
-- explained: kind | keys | advice    where `nls.explain` has a finding
lines of the cure
"""

from __future__ import annotations

import re
from pathlib import Path

from tests.nls.explanation.gallery import Case
from tests.nls.explanation.gallery_files import FILES
from tests.nls.explanation.gallery_missions import MISSIONS

__all__ = ["CHAPTERS"]


def _chapter(name: str) -> tuple[Case, ...]:
    text = Path(__file__).with_name(f"gallery_{name}.txt").read_text(encoding="utf-8")
    return tuple(_case(*case.split("\n", 1)) for case in re.split(r"^== ", text, flags=re.MULTILINE)[1:])


def _case(title: str, body: str) -> Case:
    lines = body.strip().split("\n")
    marked = [n for n, line in enumerate(lines) if line.startswith("-- ")]
    broken, cure = "\n".join(lines[: marked[0]]), "\n".join(lines[marked[-1] + 1 :])
    rows = [lines[n].removeprefix("-- ").split(": ", 1) for n in marked]
    error = "" if rows[0][0] == "says" else rows[0][0]
    words = [word for name, text in rows if name != "explained" for word in text.split(" | ")]
    explained = [tuple(text.split(" | ")) for name, text in rows if name == "explained"]
    return Case(title, broken, error, tuple(words), cure, explained=explained[0] if explained else None)


CHAPTERS = {
    "What the measurements leave free": _chapter("free"),
    "What their geometry leaves free": _chapter("geometry"),
    "Measurements, weights and starts that are wrong": _chapter("data"),
    "Graphs made in Python": _chapter("python"),
    "Too large": _chapter("size"),
    "Files": FILES,
    "Mission folders": MISSIONS,
}
