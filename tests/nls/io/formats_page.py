"""The page on formats: its sections, and the tables and files in them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "docs" / "formats.md"


def section(title: str) -> str:
    """The part of the page under a title."""
    if not PAGE.exists():
        pytest.skip("there is no docs/formats.md here (an installed copy has none)")
    return PAGE.read_text(encoding="utf-8").split(f"\n## {title}\n")[1].split("\n## ")[0]


def columns_of(text: str) -> dict[str, list[str]]:
    """Columns of each CSV file, from tables whose rows name a file, or go on with the one before, and columns."""
    columns: dict[str, list[str]] = {}
    file = ""
    for row in re.findall(r"^\|([^|]*)\|([^|]*)\|.*\|$", text, re.M):
        file = (re.findall(r"`([\w-]+)\.csv`", row[0]) or [file])[0]
        columns.setdefault(file, []).extend(re.findall(r"`(\w+)`", row[1]))
    columns.pop("")  # the heads of the tables
    return columns


def files_of(text: str) -> set[str]:
    """The files in the first column of a table."""
    return set(re.findall(r"^\| `(\w+\.\w+)` \|", text, re.M))


def shown_tables(text: str) -> dict[str, str]:
    """The CSV files that are shown whole, by name."""
    return dict(re.findall(r"^`(\w+)\.csv`\n\n```text\n(.*?)^```$", text, re.M | re.S))
