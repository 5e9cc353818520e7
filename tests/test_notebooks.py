"""What all notebooks of the course have in common, and that the mistakes they have to notice can still be made.

`make docs` runs them; `python tools/break_notebooks.py` runs them with the library broken on purpose.
"""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("[0-9]*.ipynb"))
MUTANTS = tomllib.loads((ROOT / "tools" / "broken.toml").read_text(encoding="utf-8"))["mutant"]
LINES = 25  # of a cell
WORDS = 2000  # of a notebook, one reading
SHOWN = 90  # lines of code of a notebook that are not folded away
OPENING = 350  # words before the first figure
HIDDEN = {"hide-cell", "remove-cell"}  # tags of cells whose code a page does not show
CLAIM = re.compile(
    r"# (?P<title>[^\n]+)\n\n\*(?P<claim>[^*\n]+\.)\*\n\n"
    r"\*\*You will be able to\*\*\n\n(?:- [^\n]+\n)+\n\*\*You need\*\* "
)


def cells(path: Path, kind: str) -> list[dict[str, Any]]:
    """The cells of one kind, their source in one piece."""
    every = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [cell | {"source": "".join(cell["source"])} for cell in every if cell["cell_type"] == kind]


def shows(lines: list[str]) -> bool:
    """Whether a cell of code ends in a figure or an animation."""
    last = next(line for line in reversed(lines) if line[:1] not in ("", " ", ")"))
    return last in ("figure", "plt.show()") or last.startswith("animation(")


def title(path: Path) -> str:
    return cells(path, "markdown")[0]["source"].partition("\n")[0].removeprefix("# ")


def test_there_is_a_course() -> None:
    numbers = [int(path.name[:2]) for path in NOTEBOOKS]
    assert len(numbers) == len(set(numbers)) >= 12
    assert numbers[0] == 0


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name[:2])
def test_a_notebook(path: Path) -> None:
    """A claim first; A and b; what it says is asserted; no outputs; links lead to notebooks called by their titles."""
    text = path.read_text(encoding="utf-8")
    assert text == json.dumps(json.loads(text), indent=1, ensure_ascii=False) + "\n"
    code, prose = ([cell["source"] for cell in cells(path, kind)] for kind in ("code", "markdown"))
    assert CLAIM.match(prose[0]), "a title, one sentence in italics, what you will be able to do, what you need"
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells(path, "code"))
    for pattern in (r"\bA\b", r"\bb\b", r"plt\."):
        assert any(re.search(pattern, source) for source in code), pattern
    assert sum(source.count("assert ") for source in code if "check_" not in source) >= 10
    for name, target in re.findall(r"\[([^\]]+)\]\(([^)#]+)\)", "".join(prose)):
        if not target.startswith("http"):
            assert (FOLDER / target).exists(), target
            if target.endswith(".ipynb"):
                assert title(FOLDER / target).startswith(name), f"{target} is called {title(FOLDER / target)!r}"


def needed(path: Path) -> list[str]:
    """Numbers of the notebooks that a notebook needs: those of the first sentence after "You need"."""
    sentence = cells(path, "markdown")[0]["source"].partition("**You need**")[2].partition(". ")[0]
    return re.findall(r"\]\((\d\d)-", sentence)


def test_the_plans_for_lecturers_come_to_what_a_notebook_needs_first() -> None:
    needs = {path.name[:2]: needed(path) for path in NOTEBOOKS}
    page = (ROOT / "docs" / "lecturers.md").read_text(encoding="utf-8")
    weeks = [line.split("|")[2:5] for line in page.splitlines() if re.match(r"\| \d+ \|", line)]
    assert len(weeks) == 12
    for plan in zip(*weeks, strict=True):
        taken: list[str] = []
        for week in plan:
            for number in re.findall(r"\[(\d\d)\]", week):
                assert set(needs[number]) <= set(taken), f"{number} before {set(needs[number]) - set(taken)}"
                taken.append(number)
        assert len(taken) >= 10


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name[:2])
def test_a_notebook_is_one_slow_reading(path: Path) -> None:
    """Short cells, hidden assertions, a question before each figure; what a reader reads fits in an hour."""
    before, opening = "", None
    words = shown = 0
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        lines = "".join(cell["source"]).splitlines()
        if cell["cell_type"] == "markdown":
            before = "\n".join(lines)
            words += len(before.split())
            continue
        tags = set(cell["metadata"].get("tags", []))
        assert len(lines) <= LINES, f"{cell['id']} has {len(lines)} lines"
        if not HIDDEN & tags:
            assert not any(line.strip().startswith("assert ") for line in lines), f"{cell['id']} asserts"
        if not {"hide-input", *HIDDEN} & tags:
            shown += sum(bool(line.strip()) for line in lines)
        if shows(lines):
            opening = words if opening is None else opening
            assert re.search(r"\*\*Question\.\*\* [^*]*\?", before), f"{cell['id']}: no question before the figure"
        before = ""
    assert opening is not None
    assert opening <= OPENING
    assert words <= WORDS
    assert shown <= SHOWN


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name[:2])
def test_its_exercises_check_themselves(path: Path) -> None:
    (exercises,) = [cell["source"] for cell in cells(path, "markdown") if "## Exercises" in cell["source"]]
    numbers = re.findall(r"^(\d)\. ", exercises.partition("## Exercises")[2], flags=re.MULTILINE)
    assert len(numbers) >= 3
    tagged = dict.fromkeys(("hide-input", "hide-cell", "remove-cell", "remove-output"), "")
    for cell in cells(path, "code"):
        tags = cell["metadata"].get("tags", [])
        hidden = cell["metadata"].get("jupyter", {}).get("source_hidden", False)
        assert hidden == bool({"hide-input", *HIDDEN} & set(tags)), "folded on the site and in Jupyter"
        for tag in tags:
            tagged[tag] += cell["source"]
    for number in numbers:
        assert f"def check_{number}(" in tagged["hide-input"]
        assert f"check_{number}(" in exercises
        assert f"assert check_{number}(" in tagged["hide-cell"], "one solution is folded away, and run"


def test_the_mistakes_can_still_be_made() -> None:
    gone = [m["name"] for m in MUTANTS if (ROOT / m["file"]).read_text(encoding="utf-8").count(m["right"]) != 1]
    assert gone == []
    assert all(mutant["wrong"] != mutant["right"] for mutant in MUTANTS)
    assert {mutant["notebook"] for mutant in MUTANTS} <= {path.name[:2] for path in NOTEBOOKS}
