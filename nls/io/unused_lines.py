"""Lines of a file that are not used: counted and named where they are read, written back where nobody takes them up.

A line with an unknown tag is not used, and a warning says so. A mistake in a known tag is something else: without its
line the graph has one edge less, or misses a vertex elsewhere. Such lines are refused.
"""

import re
import shlex
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from unicodedata import normalize

import numpy as np

from models.advice import Advice
from models.algebra import Index
from models.errors import OptionError
from models.listing import several, some
from models.options import did_you_mean
from nls.graph import FactorGraph
from nls.io.records import a_file
from nls.io.report import LoadReport
from nls.io.text import NUMBER, SHORT, Text, character_name, printable, strange

SIGNS = bytes.maketrans(b"-:", b"__")  # as they are confused in tags
SEPARATORS = {",": "commas", ";": "semicolons", "|": "bars", "=": "equals signs"}
QUOTES = "\"'`\u00b4\u00ab\u00bb\u2018\u2019\u201a\u201c\u201d\u201e()[]{}<>"  # around words
NAMED = 9  # tags in a sentence


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


def without_comments(text: Text) -> tuple[dict[bytes, Index], Index]:
    """Lines (from 0) by the first word of each, and the lines of comments, which begin with #."""
    tags = dict(text.tags)
    return tags, np.concatenate([np.zeros(0, dtype=np.intp), *(tags.pop(t) for t in list(tags) if t.startswith(b"#"))])


def set_aside(
    text: Text,
    unknown: dict[bytes, Index],
    known: Mapping[bytes, int],
    ignore_tags: Sequence[str],
    report: LoadReport,
    unused: Collection[bytes] = (),
    first: re.Pattern[bytes] = NUMBER,
) -> None:
    """Keep the lines that are not used as text, and refuse those that may be meant as others.

    Unknown tags that begin with EDGE are refused: without lines that join variables the rest may be another graph.

    Parameters
    ----------
    text : the file.
    unknown : lines (from 0) by tags that are not read.
    known : words after each tag that is read; 0 where there may be any number above.
    ignore_tags : as for `nls.load`.
    report : gets the lines and a warning.
    unused : tags of the format that have no use here.
    first : the form of a word behind a tag.

    Raises
    ------
    GraphFileError
        With the first line of such a tag, or of one that is misspelt, see `refuse_misspelt`.
    OptionError
        A tag to ignore that is read.
    """
    strays = {tag: lines for tag, lines in unknown.items() if tag not in unused}
    if strays:
        refuse_misspelt(text, strays, known, first)
    names = tags_to_ignore(ignore_tags)
    if read := sorted(names & {printable(tag) for tag in known}):
        raise OptionError("ignore_tags", read[0], "tags that are not read; delete lines of this one that are wrong")
    edges = {printable(tag): lines for tag, lines in strays.items() if tag[:4].upper() == b"EDGE"}
    edges = {tag: lines for tag, lines in edges.items() if not names >= tags_to_ignore(tag)}
    if edges:
        counts = some([f"{tag[:SHORT]} ({len(lines)})" for tag, lines in edges.items()], NAMED, noun=" tags")
        option = (shlex.quote(",".join(edges)), repr(list(edges)))
        raise text.error(
            f"unknown tags that may connect variables: {counts}; the rest may be another graph",
            min(int(lines[0]) for lines in edges.values()),
            [Advice("ignore tags", option)] * (len(option[0]) <= 500),
        )
    if unknown:
        aside = "with unknown tags " if strays else ""
        named = [f"{printable(tag, 30)} ({len(n)}, first on line {n[0] + 1})" for tag, n in unknown.items()]
        report.warn(f"lines {aside}were not used: {some(named, NAMED, noun=' tags')}")
        keep(text, np.sort(np.concatenate(list(unknown.values()))), report)


def refuse_misspelt(
    text: Text, unknown: Mapping[bytes, Index], known: Mapping[bytes, int], first: re.Pattern[bytes] = NUMBER
) -> None:
    """Refuse lines with unknown tags that can only be lines of a known one.

    Parameters
    ----------
    text : the file.
    unknown : lines (from 0) by tags that are not known.
    known : words after each known tag; 0 where there may be any number above.
    first : the form of a word behind a tag.

    Raises
    ------
    GraphFileError
        With the first such line: a blank of another script in its tag; a known tag with a number behind it, without a
        blank between; one letter from a known tag, and as many words behind it as that one has; a letter of another
        script in a known tag; quotes around it; a blank in it; other separators than blanks behind it.

    Examples
    --------
    >>> text = Text(b"EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\\nEDGE_SE21 2 1 0 0 1 0 0 1 0 1\\n", "a.g2o")
    >>> refuse_misspelt(text, {b"EDGE_SE21": np.array([1])}, {b"EDGE_SE2": 11})
    Traceback (most recent call last):
        ...
    models.errors.GraphFileError: a.g2o:2: 'EDGE_SE21' is no tag; expected EDGE_SE2 and a blank before 1 [EDGE_SE21 2 \
1 0 0 1 0 0 1 0 1]
    """
    wrong: list[tuple[int, str]] = []
    joined = re.compile(rb"(%s)(%s)" % (b"|".join(sorted(map(re.escape, known), reverse=True)), first.pattern))
    ends = {end for name in known for end in (name[:2], name[-2:])}  # one of the two stays where one letter is wrong
    forms = {_form(name): name for name in known}
    beginnings = {form[:k] for form in forms for k in range(1, len(form))}
    for tag, lines in unknown.items():
        if strange(tag):
            wrong.append((int(lines[0]), "expected a tag and a blank behind it"))
        elif glued := joined.fullmatch(tag):
            tagged, number = printable(glued[1]), printable(glued[2], 20)
            wrong.append((int(lines[0]), f"expected {tagged} and a blank before {number}"))
        elif expected := _foreign(tag, forms):
            wrong.append((int(lines[0]), expected))
        else:
            count = text.first[lines + 1] - text.first[lines] - 1
            if ends & {tag[:2].upper(), tag[-2:].upper()}:
                for near in (name for name in known if _near(tag, name)):
                    fitting = lines[count == known[near] if known[near] else count > 0]
                    wrong += [(int(line), f"expected {printable(near)}") for line in fitting[:1]]
            if (form := _form(tag)) in beginnings:
                wrong += _split(text, form, lines[count > 0], count[count > 0], forms, known)
    if wrong:
        line, expected = min(wrong)
        raise text.error(f"'{printable(text.token(int(text.first[line])), 40)}' is no tag; {expected}", line)


def _form(tag: bytes) -> bytes:
    """A tag without the differences of capitals and signs between words."""
    return tag.upper().translate(SIGNS)


def _foreign(tag: bytes, forms: Mapping[bytes, bytes]) -> str:
    """The words on characters that do not belong to a known tag; empty where a tag is none of the known.

    Examples
    --------
    >>> for word in ("\u0415DGE_SE2", "EDGE_SE2;0;2", "\u201cEDGE_SE2\u201d", "EDGE"):
    ...     print(_foreign(word.encode(), {b"EDGE_SE2": b"EDGE_SE2"}) or None)
    expected EDGE_SE2 with a letter of ASCII in the place of cyrillic capital letter ie (U+0415)
    expected EDGE_SE2 and blanks, not semicolons, between the words
    expected EDGE_SE2 without left double quotation mark (U+201C)
    None
    """
    word = tag.decode("utf-8", "surrogateescape")
    bare = word.strip(QUOTES)
    separator = next((c for c in bare if c in SEPARATORS), "")
    head = bare.partition(separator)[0].strip(QUOTES) if separator else bare
    if separator and (known := forms.get(_form(head.encode("utf-8", "surrogateescape")))):
        return f"expected {printable(known)} and blanks, not {SEPARATORS[separator]}, between the words"
    if bare != word and (known := forms.get(_form(bare.encode("utf-8", "surrogateescape")))):
        return f"expected {printable(known)} without {character_name(next(c for c in word if c in QUOTES))}"
    if tag.isascii():
        return ""
    plain = normalize("NFKC", word)
    known = next((forms[form] for form in forms if _alike(plain, form.decode())), None)
    if known is None:
        return ""
    letter = character_name(next(c for c in word if not c.isascii()))
    return f"expected {printable(known)} with a letter of ASCII in the place of {letter}"


def _alike(word: str, form: str) -> bool:
    """Whether a word is a tag but for letters that are not of ASCII, fewer than the others."""
    ascii_only = "".join(c for c in word if c.isascii())
    if 2 * len(ascii_only) < len(form):
        return False
    same = len(word) == len(form) and all(
        not a.isascii() or _form(a.encode()) == b.encode() for a, b in zip(word, form, strict=True)
    )
    return same or _form(ascii_only.encode()) == form.encode()


def _split(
    text: Text, form: bytes, lines: Index, count: Index, forms: Mapping[bytes, bytes], known: Mapping[bytes, int]
) -> Iterable[tuple[int, str]]:
    """Lines whose first two words are one known tag with a blank in it, one for each tag; ``count``: words behind."""
    width = max(map(len, forms)) + 1
    second = np.char.upper(text.characters(text.first[lines] + 1, width).view(f"S{width}")[:, 0])
    for whole, tag in forms.items():
        rests = [whole[len(form) + gap :] for gap in (0, 1) if whole.startswith(form + b"_" * gap)]
        rests = [ending for ending in rests if ending]
        hit = np.isin(second, rests + [ending.replace(b"_", sign) for ending in rests for sign in (b"-", b":")])
        if any(ending.isdigit() for ending in rests):  # EDGE 2, where 2 may be a vertex
            hit &= count - 1 == known[tag]
        if hit.any():
            yield int(lines[np.argmax(hit)]), f"expected {printable(tag)} without a blank in it"


def _near(word: bytes, tag: bytes) -> bool:
    """Whether the two differ by one letter, or by two that are swapped; capitals and signs between words do not count.

    Examples
    --------
    >>> [_near(word, b"EDGE_SE2") for word in (b"edge-se2", b"EGDE_SE2", b"EDGE_E2", b"EDGE_SE3", b"EDGE_SE2_XY")]
    [True, True, True, True, False]
    """
    if abs(len(word) - len(tag)) > 1:
        return False
    a, b = _form(word), _form(tag)
    for k in range(max(len(a), len(b))):
        shorter, shorter_tag, swapped = a[:k] + a[k + 1 :], b[:k] + b[k + 1 :], a[:k] + a[k : k + 2][::-1] + a[k + 2 :]
        if b in (shorter, swapped) or shorter_tag in (shorter, a):
            return True
    return False
