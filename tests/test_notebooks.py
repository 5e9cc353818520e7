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
CLAIM = re.compile(
    r"# (?P<title>[^\n]+)\n\n\*(?P<claim>[^*\n]+\.)\*\n\n\*\*You will be able to\*\* .+\n\n\*\*You need\*\* "
)


def cells(path: Path, kind: str) -> list[dict[str, Any]]:
    """The cells of one kind, their source in one piece."""
    every = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [cell | {"source": "".join(cell["source"])} for cell in every if cell["cell_type"] == kind]


def title(path: Path) -> str:
    return cells(path, "markdown")[0]["source"].partition("\n")[0].removeprefix("# ")


def test_there_is_a_course() -> None:
    numbers = [int(path.name[:2]) for path in NOTEBOOKS]
    assert len(numbers) == len(set(numbers)) >= 12
    assert numbers[0] == 1


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name[:2])
def test_it_opens_with_a_claim_and_is_stored_without_outputs(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    opening = cells(path, "markdown")[0]["source"]
    assert CLAIM.match(opening), "a title, one sentence in italics, what you will be able to do, what you need"
    assert text == json.dumps(json.loads(text), indent=1, ensure_ascii=False) + "\n"
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells(path, "code"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name[:2])
def test_it_shows_A_and_b_and_asserts_what_it_says(path: Path) -> None:
    code = [cell["source"] for cell in cells(path, "code")]
    assert any(re.search(r"\bA\b", source) for source in code)
    assert any(re.search(r"\bb\b", source) for source in code)
    checked = sum(source.count("assert ") for source in code if "check_" not in source)
    assert checked >= 10
    assert any("plt." in source for source in code)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name[:2])
def test_its_exercises_check_themselves(path: Path) -> None:
    (exercises,) = [cell["source"] for cell in cells(path, "markdown") if "## Exercises" in cell["source"]]
    numbers = re.findall(r"^(\d)\. ", exercises.partition("## Exercises")[2], flags=re.MULTILINE)
    assert len(numbers) >= 3
    tagged = dict.fromkeys(("hide-input", "hide-cell"), "")
    for cell in cells(path, "code"):
        tags = cell["metadata"].get("tags", [])
        hidden = cell["metadata"].get("jupyter", {}).get("source_hidden", False)
        assert hidden == bool({"hide-input", "hide-cell"} & set(tags)), "folded on the site and in Jupyter"
        for tag in tags:
            tagged[tag] += cell["source"]
    for number in numbers:
        assert f"def check_{number}(" in tagged["hide-input"]
        assert f"check_{number}(" in exercises
        assert f"assert check_{number}(" in tagged["hide-cell"], "one solution is folded away, and run"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name[:2])
def test_its_links_lead_somewhere_and_call_notebooks_by_their_titles(path: Path) -> None:
    text = "".join(cell["source"] for cell in cells(path, "markdown"))
    for name, target in re.findall(r"\[([^\]]+)\]\(([^)#]+)\)", text):
        if target.startswith("http"):
            continue
        assert (FOLDER / target).exists(), target
        if target.endswith(".ipynb"):
            assert title(FOLDER / target).startswith(name), f"{target} is called {title(FOLDER / target)!r}"


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant["name"])
def test_the_mistake_can_still_be_made(mutant: dict[str, str]) -> None:
    assert (ROOT / mutant["file"]).read_text(encoding="utf-8").count(mutant["right"]) == 1
    assert mutant["wrong"] != mutant["right"]
    assert mutant["notebook"] in {path.name[:2] for path in NOTEBOOKS}
