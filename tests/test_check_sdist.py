"""The check of the source distribution: a whole one has nothing to say against it, and each fault is named."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

if not (Path(__file__).parents[1] / "tools" / "check_sdist.py").is_file():
    pytest.skip("there are no tools here (an installed copy has none)", allow_module_level=True)

from tools.check_sdist import PICTURE, ROOT, TOP, problems

README = '<img src="docs/images/a.png" width="5"> ![Before: a. After: b](docs/images/b.png) [how](docs/how.md)'
FILES = ["nls/graph.py", "nls/py.typed", "sim/cli.py", "docs/how.md", "tests/test_readme.py", "tools/check_sdist.py"]
WHOLE = {*TOP, *FILES[:3], "docs/images/a.png", "docs/images/b.png", "PKG-INFO"}


def test_a_whole_one() -> None:
    assert problems(WHOLE, FILES, README) == []


@pytest.mark.parametrize("name", sorted(WHOLE - {"PKG-INFO"}))
def test_what_is_missing_is_named(name: str) -> None:
    assert problems(WHOLE - {name}, FILES, README) == [f"{name} is missing"]


def test_single_tests_are_named() -> None:
    assert problems({*WHOLE, "tests/test_readme.py"}, FILES, README) == [
        "tests/test_readme.py is there: tests need the repository"
    ]


def test_the_pictures_of_our_readme_are_included_and_no_tests() -> None:
    """`make sdist` builds it and looks; this holds without a network."""
    manifest = (ROOT / "MANIFEST.in").read_text(encoding="utf-8").splitlines()
    included = [name for line in manifest if line.startswith("include ") for name in line.split()[1:]]
    shown = PICTURE.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    assert sorted(included) == sorted(shown)
    assert len(shown) >= 2
    assert all((ROOT / name).is_file() for name in included)
    assert any(re.fullmatch(r"prune tests", line) for line in manifest)
