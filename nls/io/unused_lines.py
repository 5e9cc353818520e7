"""Lines of a file that are not used: counted and named where they are read, written back where nobody takes them up."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from models.advice import Advice
from models.algebra import Index
from models.errors import OptionError
from models.listing import several, some
from models.options import did_you_mean
from nls.graph import FactorGraph
from nls.io.records import a_file
from nls.io.report import LoadReport
from nls.io.text import SHORT, Text, printable

__all__ = ["appended", "left_out", "measurements_left_out"]
NAMED = 9  # tags in a sentence
LONGEST = 500  # bytes of tags in an option that is advised


def refuse_edges(
    text: Text, unknown: Mapping[bytes, Index], ignore_tags: Sequence[str], known: Iterable[bytes]
) -> None:
    """Refuse unknown tags that begin with EDGE: without lines that join variables the rest may be another graph.

    Parameters
    ----------
    text : the file.
    unknown : lines (from 0) by tags that are not known.
    ignore_tags : those whose lines may be left out, see `tags_to_ignore`.
    known : tags that are read.

    Raises
    ------
    GraphFileError
        With the first such line.
    OptionError
        A tag to ignore that is read.
    """
    names = tags_to_ignore(ignore_tags)
    if read := sorted(names & {printable(tag) for tag in known}):
        raise OptionError("ignore_tags", read[0], "tags that are not read; delete lines of this one that are wrong")
    edges = {printable(tag): lines for tag, lines in unknown.items() if tag[:4].upper() == b"EDGE"}
    edges = {tag: lines for tag, lines in edges.items() if not names >= tags_to_ignore(tag)}
    if edges:
        counts = some([f"{tag[:SHORT]} ({len(lines)})" for tag, lines in edges.items()], NAMED, noun=" tags")
        option = (shlex.quote(",".join(edges)), repr(list(edges)))
        raise text.error(
            f"tags that are not known and may join variables: {counts}; the rest may be another graph",
            min(int(lines[0]) for lines in edges.values()),
            [Advice("ignore tags", option)] * (len(option[0]) <= LONGEST),
        )


def tags_to_ignore(ignore_tags: Sequence[str]) -> set[str]:
    """The tags that may be left out, those with commas in parts; one text is a list with commas, as of a command."""
    names = ",".join([ignore_tags] if isinstance(ignore_tags, str) else ignore_tags)
    return set(filter(None, names.replace(" ", "").split(",")))


def not_there(ignore_tags: Sequence[str], tags: Collection[str]) -> list[str]:
    """Remarks on tags to ignore that a file with these tags does not have."""
    absent = tags_to_ignore(ignore_tags).difference(*(tag.split(",") for tag in tags))
    return [f"ignore_tags: no line has the tag {name!r}{did_you_mean(name, tags)}" for name in sorted(absent)]


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
