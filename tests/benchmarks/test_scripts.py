"""What all scripts of the benchmarks share: each can be imported, and their pages are made in one way."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.benchmarks.conftest import FOLDER


def test_every_script_can_be_imported(part: Callable[[str], Any], script: Callable[[str], Any]) -> None:
    names = Counter(path.stem for pattern in ("*.py", "evidence/*.py") for path in FOLDER.glob(pattern))
    assert [name for name, number in names.items() if number > 1] == []
    for name in names:
        part(name)


def test_a_page(part: Callable[[str], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Head, options, folders and table; a process of its own prints what it measured."""
    harness = part("harness")

    def page(data: Path, out: Path, seeds: int, quick: bool) -> list[str]:
        table = harness.Table(("folder", "seeds"))
        table.add(data.name, harness.spread(range(seeds), 1))
        return table if quick else [str(out)]

    def made(*words: object) -> None:
        monkeypatch.setattr("sys.argv", ["page.py", *map(str, words)])
        harness.make_page("To {last}", page, str.upper, seeds=(3, "seeds"), quick="less")

    monkeypatch.setenv("LEADLINE_DATA", str(tmp_path / "public"))
    made("--quick", "--out", tmp_path / "new")
    title, *_, blank, head, rule, row = (tmp_path / "new" / "test_scripts.md").read_text().splitlines()
    assert (title, blank) == ("# To 2", "")
    assert (head, rule, row) == ("| folder | seeds |", "|:--|--:|", "| public | 1.0 (0.0-2.0) |")
    for words in (["--seeds", "0"], ["--out", Path(__file__) / "below"]):
        with pytest.raises(SystemExit):
            made(*words)
    monkeypatch.delenv("LEADLINE_DATA")
    with pytest.raises(SystemExit):
        made()


def test_a_child(
    part: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, measure in (["a"], str.upper), (["up", "a"], {"up": str.upper}):
        monkeypatch.setattr("sys.argv", ["page.py", "--child", *words])
        part("harness").make_page("Title", lambda: [], measure)
        assert json.loads(capsys.readouterr().out) == "A"


def test_blank_lines(part: Callable[[str], Any]) -> None:
    lines = ["# title", "- a", "- b\n  of b", "| t |", "|--:|", "", "| u |", "text\nof two lines", "text"]
    assert list(part("harness").spaced(lines)) == [
        *("# title", "", "- a", "- b\n  of b", "", "| t |", "|--:|", "", "| u |", "", "text\nof two lines", "", "text")
    ]
