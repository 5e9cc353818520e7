"""Lines of a file that are not used: counted and named where they are read, written back where nobody takes them up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection

import numpy as np

from models.algebra import Index
from models.listing import several, some
from nls.graph import FactorGraph
from nls.io.records import a_file
from nls.io.report import LoadReport
from nls.io.text import Text, printable

__all__ = ["appended", "left_out", "measurements_left_out"]
NAMED = 9  # tags in a sentence


def keep(text: Text, lines: Index, report: LoadReport) -> None:
    """Keep lines (counted from 0) as text."""
    report.ignored += [text.line(n).decode("utf-8", "surrogateescape") for n in lines.tolist()]


def keep_unknown(text: Text, unknown: dict[bytes, Index], report: LoadReport, known: Collection[bytes] = ()) -> None:
    """Keep the lines of tags that are not used, and warn; ``known``: tags of the format without a use here."""
    if not unknown:
        return
    aside = "" if all(tag in known for tag in unknown) else "with unknown tags "
    named = [f"{printable(tag, 30)} ({len(n)}, first on line {n[0] + 1})" for tag, n in unknown.items()]
    report.warn(f"lines {aside}were not used: {some(named, NAMED, noun=' tags')}")
    keep(text, np.sort(np.concatenate(list(unknown.values()))), report)


def note_comments(report: LoadReport, count: int) -> None:
    """Say how many comments there were: they are never written."""
    if count:
        report.notes.append(several(count, "comment line"))


def appended(report: LoadReport | None, format: str) -> list[str]:
    """The unused lines a file of this format gets back: another format might read them as its own."""
    return report.ignored if report is not None and report.format == format else []


def measurements_left_out(noun: str, graph: FactorGraph) -> list[str]:
    """Contents that a file of values alone does not hold, in at most one sentence."""
    count = several(len(graph), "measurement")
    return [f"a {noun} file holds no measurements: {count} left out"] if len(graph) else []


def left_out(report: LoadReport | None, format: str) -> list[str]:
    """Lines that a file of this format does not get back, in at most one sentence."""
    if report is None or report.format == format or not report.ignored:
        return []
    tags = Counter(line.encode("utf-8", "surrogateescape").split()[0] for line in report.ignored)
    named = some([f"{printable(tag, 30)} ({count})" for tag, count in tags.items()], NAMED, noun=" tags")
    count = len(report.ignored)
    lines, pronoun = (
        (f"{count} lines that were not used are", "them") if count > 1 else ("1 line that was not used is", "it")
    )
    return [f"{lines} left out, only {a_file(report.format)} gets {pronoun} back: {named}"]
