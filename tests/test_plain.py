"""The list of sentences that are hard to read: what is a sentence, and which ones are listed."""

from __future__ import annotations

from pathlib import Path

import pytest

if not (Path(__file__).parents[1] / "tools" / "plain.py").is_file():
    pytest.skip("there are no tools here (an installed copy has none)", allow_module_level=True)

from tools import plain

PAGE = """---
kernelspec: python3
---
# A title of a page

One thought, with [a link](page.md) and `code. Inside`. Another one: $a. B$
ends on the next line.

- What it is.
- A point; half of it.

| a | table. Nothing |

```python
x = 1  # No prose.
```
"""


def test_sentences_of_a_page() -> None:
    assert plain.sentences(PAGE) == [
        "One thought, with a link and x.",
        "Another one: x ends on the next line.",
        "What it is.",
        "A point;",
        "half of it.",
    ]


def test_long_sentences_and_pronouns_are_listed_the_longest_first(tmp_path: Path) -> None:
    long, short = " ".join(["Word"] * 26) + ".", " ".join(["Word"] * 25) + "."
    assert plain.candidates([short, "It is.", long]) == [long, "It is."]
    source = tmp_path / "a.py"
    source.write_text(f'"""{long}\n\n>>> print()\n"""\n\n\ndef _hidden():\n    """It is hidden."""\n')
    assert plain.sentences(plain.texts(source)) == [long]


def test_a_page_before_and_after() -> None:
    lines = plain.comparison({"a": [30, 4], "gone": [5]}, {"a": [10, 9, 8], "new": [7]})
    assert lines[2:] == [
        "| a | 34 | 27 | 30 | 10 | 1 | 0 |",
        "| new |  | 7 |  | 7 |  | 0 |",
        "| gone | 5 |  | 5 |  | 0 |  |",
        "| **all** | 39 | 34 | 30 | 10 | 1 | 0 |",
    ]
