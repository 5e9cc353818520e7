"""First words that are no tags but must have been meant as one: refused at their own lines.

A line with an unknown tag is not used, and a warning says so. A mistake in a known tag is something else: without its
line the graph has one edge less, or misses a vertex elsewhere.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from models.algebra import Index
from nls.io.text import NUMBER, Text, printable, strange

__all__ = ["refuse_misspelt"]
SIGNS = bytes.maketrans(b"-:", b"__")  # as they are confused in tags


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
        blank between; one letter from a known tag, and as many words behind it as that one has.

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
    for tag, lines in unknown.items():
        if strange(tag):
            wrong.append((int(lines[0]), "expected a tag and a blank behind it"))
        elif glued := joined.fullmatch(tag):
            name, number = printable(glued[1]), printable(glued[2], 20)
            wrong.append((int(lines[0]), f"expected {name} and a blank before {number}"))
        elif ends & {tag[:2].upper(), tag[-2:].upper()}:
            count = text.first[lines + 1] - text.first[lines] - 1
            for near in (name for name in known if _near(tag, name)):
                fitting = lines[count == known[near] if known[near] else count > 0]
                wrong += [(int(line), f"expected {printable(near)}") for line in fitting[:1]]
    if wrong:
        line, expected = min(wrong)
        raise text.error(f"{printable(text.token(int(text.first[line])), 40)!r} is no tag; {expected}", line)


def _near(word: bytes, tag: bytes) -> bool:
    """Whether the two differ by one letter, or by two that are swapped; capitals and signs between words do not count.

    Examples
    --------
    >>> [_near(word, b"EDGE_SE2") for word in (b"edge-se2", b"EGDE_SE2", b"EDGE_E2", b"EDGE_SE3", b"EDGE_SE2_XY")]
    [True, True, True, True, False]
    """
    if abs(len(word) - len(tag)) > 1:
        return False
    a, b = word.upper().translate(SIGNS), tag.upper().translate(SIGNS)
    for k in range(max(len(a), len(b))):
        shorter, other, swapped = a[:k] + a[k + 1 :], b[:k] + b[k + 1 :], a[:k] + a[k : k + 2][::-1] + a[k + 2 :]
        if b in (shorter, swapped) or other in (shorter, a):
            return True
    return False
