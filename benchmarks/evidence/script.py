"""How a script of this folder begins and ends: its command line, the public data and the page of its results."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

from pinv import ONE_THREAD, RESULTS, machine, positive, write_page

__all__ = ["ONE_THREAD", "arguments", "at_least_one", "markdown", "page_head", "positive", "public_data", "write_page"]


def arguments(text: str | None, files: str) -> argparse.ArgumentParser:
    """Command line of a script: the first line of its text, and the folder of the files it writes."""
    parser = argparse.ArgumentParser(description=(text or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=RESULTS, metavar="DIR", help=f"for {files}")
    return parser


def at_least_one(text: str) -> int:
    """A number of seeds or of processes."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1, got {text!r}")
    return int(text)


def public_data(parser: argparse.ArgumentParser) -> Path:
    """Folder of the public data; without one the script ends here."""
    if not (folder := os.environ.get("LEADLINE_DATA")):
        parser.exit(message="the public data sets are not shipped: set LEADLINE_DATA to the folder that holds them\n")
    return Path(folder)


def page_head(title: str) -> list[str]:
    """First lines of a page. Made before the work, as they state the load of the machine at the start."""
    return [f"# {title}", "", *machine()]


def markdown(titles: Sequence[str], rows: Iterable[Sequence[str]], names: int = 1) -> list[str]:
    """A table in Markdown; the first columns are names, the others numbers."""
    rule = "|:--" * names + "|--:" * (len(titles) - names) + "|"
    return [f"| {' | '.join(titles)} |", rule, *(f"| {' | '.join(row)} |" for row in rows)]
