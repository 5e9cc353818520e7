"""Lines, tags and numbers of a text file by whole-array operations: lines are split, never looped over in Python.

Numbers are read all at once (`nls.io.decimals`). Few are left: those of another form, of more than 19 digits, or next
to the middle of two floating-point numbers. They are matched against the grammar of a decimal number and go to Python's
float(). It also takes "nan", "1_0" and the digits of other scripts.

Files without tags, trajectories and logs, have lines of numbers alone, blanks between, and comments that begin with #.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from unicodedata import name

import numpy as np
import numpy.typing as npt

from models.advice import Advice
from models.algebra import Array, Index, Mask, Numbers
from models.errors import GraphError, GraphFileError, NoiseModelError, ResourceLimitError
from models.visible import visible
from nls.io.decimals import BLANK, LINE_END, MARKS, PAD, UNREAD, WHOLE, decimals, windows
from nls.io.files import read_bytes
from nls.linear.limits import default_limit, gigabytes

NUMBER = re.compile(rb"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
DECIMAL_COMMA = rb"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?"
INTEGER = rb"[+-]?[0-9]+"  # this and the next are compiled where they are used: most files need neither
STRANGE = "[\x85\xa0\u1680\u180e\u2000-\u200f\u2028-\u202f\u205f-\u2064\u3000\ufeff\udca0]"
NAMES = {
    "\x85": "next-line character (U+0085)",
    "\ufeff": "byte-order mark (U+FEFF)",
    "\udca0": "no-break space of Latin-1 (byte A0)",
}
QUOTED = 80  # characters of a line in an error
WORDS = rf".{{{QUOTED // 2},{QUOTED - 4}}}(?=[\s,])"
BLOCK = 1 << 15  # bytes at a time, within the cache and without fresh memory: 2.2 ms for sphere2500, not 4
SHORT = 64  # bytes of the first words of a format


def printable(word: bytes, most: int | None = None) -> str:
    """Bytes of a file as text for a message, whatever their encoding; at most so many characters of them."""
    return visible((word if most is None else word[: 4 * most]).decode("utf-8", "backslashreplace")[:most])


def strange(line: bytes) -> str:
    """The name of the first character that looks like a blank, or like nothing, and is none; empty where there is none.

    Examples
    --------
    >>> strange("EDGE_SE2\\u00a00 1".encode()), strange(b"EDGE_SE2 0 1")
    ('no-break space (U+00A0)', '')
    """
    match = None if line.isascii() else re.search(STRANGE, line.decode("utf-8", "surrogateescape"))
    return "" if match is None else character_name(match[0])


def character_name(character: str) -> str:
    """A character by its name; a byte that is no UTF-8 by its number."""
    if character not in NAMES and 0xDC80 <= ord(character) <= 0xDCFF:
        return f"byte {ord(character) - 0xDC00:02X}"
    return NAMES.get(character) or f"{name(character, 'character').lower()} (U+{ord(character):04X})"


def rows(tag: str, words: Sequence[Iterable[str]], numbers: Array, digits: Callable[[float], str] = repr) -> list[str]:
    """Lines to write: the tag, n words per column of words, then the rows of numbers (n, k).

    ``digits`` writes a number; the shortest that read back as the same one unless told otherwise.
    """
    lines = zip(zip(*words, strict=True), numbers.tolist(), strict=True)
    return [f"{tag} {' '.join(word)} {' '.join(map(digits, row))}" for word, row in lines]


def _quoted(line: str) -> str:
    """A line as it is quoted in an error: if it is long up to the end of a word, where one ends in its second half."""
    if len(line) <= QUOTED:
        return line
    whole = re.match(WORDS, line)
    return f"{whole[0] if whole else line[: QUOTED - 4]} ..."


class Text:
    """The tokens of a text file.

    Parameters
    ----------
    data : the bytes.
    path : for messages.
    before : lines of the file before the data.

    Attributes
    ----------
    starts, ends : (T,) where every token begins and ends, counted with `PAD` bytes in front of the data.
    first : (lines + 1,) index of the first token of every line.
    first_number : number of the first line in the file, counted from 1.
    """

    def __init__(self, data: bytes, path: str = "<text>", before: int = 0) -> None:
        self.path, self.first_number = path, before + 1
        self._bytes = b"".join((b"\n".rjust(PAD), data, b"\n".ljust(SHORT)))  # first words: up to SHORT behind
        self._marks = self._bytes.translate(MARKS)
        marks = np.frombuffer(self._marks, dtype=np.uint8)
        # half the memory where it can be
        kind: type[np.int32 | np.int64] = np.int32 if len(marks) < 2**31 else np.int64
        edges, newlines = [], []
        for begin in range(0, len(marks), BLOCK):
            block = marks[begin : begin + BLOCK + 1]
            blank = block >= BLANK
            edges.append((blank[1:] != blank[:-1]).nonzero()[0].astype(kind) + (begin + 1))
            newlines.append((block[:BLOCK] == LINE_END).nonzero()[0].astype(kind) + begin)
        tokens: Index = np.concatenate(edges)  # tokens and blanks alternate; the bytes begin blank
        self.starts, self.ends = tokens[0::2], tokens[1::2]
        self._newlines: Index = np.concatenate(newlines)
        self.first = self.starts.searchsorted(self._newlines)

    def token(self, index: int) -> bytes:
        """One token."""
        return self._bytes[self.starts[index] : self.ends[index]]

    def line(self, line: int) -> bytes:
        """One line, counted from 0, without its newline."""
        return self._bytes[self._newlines[line] + 1 : self._newlines[line + 1]]

    def error(self, message: str, line: int, advice: Sequence[Advice] = ()) -> GraphFileError:
        """An error at a line counted from 0; it names a character of the line that only looks like a blank."""
        start = self.line(line)[:1000]  # bytes that are looked at
        if character := strange(start):
            message += f"; the line has a {character}, expected a blank or nothing in its place"
        return GraphFileError(message, self.path, self.first_number + line, _quoted(printable(start.strip())), advice)

    def refuse(self, bad: Mask, lines: Index, problem: Callable[[int], str]) -> None:
        """Refuse the first of lines (n,), counted from 0, that is bad (n,); `problem` says what is wrong with row k.

        Raises
        ------
        GraphFileError
        """
        if bad.any():
            k = int(np.argmax(bad))
            raise self.error(problem(k), int(lines[k]))

    @contextmanager
    def at_lines(self, lines: Index) -> Iterator[None]:
        """Give the refusals of measurements that stand on lines (n,) their line.

        Raises
        ------
        GraphFileError
        """
        try:
            yield
        except NoiseModelError as error:
            message = str(error).split(": ", 1)[1] if error.keys else str(error)  # without the name of the factor
            advice = [Advice("repair")] if error.matrix == "information" else []  # has a negative eigenvalue
            raise self.error(message, int(lines[error.index]), advice) from error
        except GraphError as error:
            raise self.error(str(error), int(lines[error.index])) from error

    def once(self, numbers: Numbers, lines: Index, noun: str) -> Index:
        """The order (n,) in which the numbers (n,) of lines (n,) rise; none is there twice.

        ``noun`` stands in front of the number in the error.

        Raises
        ------
        GraphFileError
            A number that was given before, at the first such line.
        """
        order = np.lexsort((lines, numbers))
        again = order[1:][numbers[order][1:] == numbers[order][:-1]]
        if len(again):
            k = again[np.argmin(lines[again])]
            before = self.first_number + lines[numbers == numbers[k]].min()
            raise self.error(f"{noun}{numbers[k]} was given before, on line {before}", int(lines[k]))
        return np.asarray(order)

    @cached_property
    def tags(self) -> dict[bytes, Index]:
        """First word of every line that has one, with its lines (from 0), in order of first appearance."""
        lines = (self.first[1:] > self.first[:-1]).nonzero()[0]
        heads = self.first.take(lines)
        starts = self.starts.take(heads).astype(np.intp)
        length = self.ends.take(heads) - starts
        window = windows(self._bytes)
        lines_of_tag: dict[bytes, Index] = {}
        while len(lines) and len(lines_of_tag) < 16 and length[0] <= SHORT:
            same, first = length == length[0], int(length[0])
            for k in range(first, 0, -8):
                word = window[starts + (k - 8)] >> max(0, 64 - 8 * k)  # of these eight bytes, those of the tag
                same &= word == word[0]
            lines_of_tag[self.token(int(heads[0]))] = lines[same]
            other_lines = (~same).nonzero()[0]
            lines, heads, starts, length = (array.take(other_lines) for array in (lines, heads, starts, length))
        if (needed := 700.0 * len(lines)) > default_limit():  # bytes, for a line with a first word of its own
            raise ResourceLimitError(
                f"{self.path}: {len(lines):,} lines with first words of many kinds, to tell them apart takes "
                f"{gigabytes(needed)} of memory, the limit is {gigabytes(default_limit())}; expected tags of a graph",
                needed,
                default_limit(),
                "first words",
            )
        by_word: dict[bytes, list[int]] = {}  # a file of many or long first words is no graph: one look at each line
        for line, head in zip(lines.tolist(), heads.tolist(), strict=True):
            by_word.setdefault(self.token(head), []).append(line)
        lines_of_tag |= {tag: np.array(same, dtype=np.intp) for tag, same in by_word.items()}
        return lines_of_tag

    def characters(self, tokens: Index, width: int) -> npt.NDArray[np.uint8]:
        """The first bytes of tokens, (n, width), zeros behind their ends."""
        starts, ends = self.starts[tokens][:, None], self.ends[tokens][:, None]
        places, characters = starts + np.arange(width), np.frombuffer(self._bytes, dtype=np.uint8)
        return np.where(places < ends, characters[np.minimum(places, ends - 1)], np.uint8(0))

    @cached_property
    def _decimals(self) -> tuple[Array, npt.NDArray[np.uint8]]:
        """Numbers of all tokens, and their forms; tags are none, but few, and the rest stands in one piece."""
        marks, self._marks = self._marks, b""  # needed once: 340 MB of a million edges in space
        return decimals(marks, self.starts, self.ends)

    def table(self, lines: Index, columns: int, expected: str, entries: int = 0) -> Array:
        """The numbers after the first word of these lines, (n, columns); the last ones the entries of a matrix.

        Raises
        ------
        GraphFileError
            A line with another count of numbers, or a word that is no finite number.
        """
        first, width = self.first.take(lines), columns + 1
        count = self.first.take(lines + 1) - first - 1
        if (wrong := count != columns).any():
            k = int(np.argmax(wrong))
            numbers, needed = int(count[k]), columns - entries
            surplus = f"; these are {numbers - needed} entries for {entries}" if entries and numbers >= needed else ""
            raise self.error(f"{numbers} numbers after the tag, expected {columns}: {expected}{surplus}", int(lines[k]))
        begin, end = int(first[0]), int(first[-1]) + width
        if end - begin > len(lines) * width:  # other lines between
            return self.words(lines, 1, columns)
        value, form = self._decimals
        line, column = (form[begin:end].reshape(-1, width)[:, 1:] == UNREAD).nonzero()
        self._read(first[line] + 1 + column, lines[line])
        return value[begin:end].reshape(-1, width)[:, 1:]

    def words(self, lines: Index, first: int, columns: int) -> Array:
        """The numbers (n, columns) of so many words of these lines, the first of which is counted from 0."""
        tokens = self.first.take(lines)[:, None] + np.arange(first, first + columns)
        return self.numbers(tokens.reshape(-1), lines, columns).reshape(-1, columns)

    def whole(self, lines: Index, column: int | Index) -> Numbers:
        """Whole numbers of one column per line (1 is the first after the tag): ids, exact up to 2^63 - 1.

        A column may be one for all lines, one for each (n,), or several for all (k, 1): then (k, n) numbers.

        Raises
        ------
        GraphFileError
            A word that is no whole number, or too large.
        """
        tokens = self.first.take(lines) + column
        number, form = (array.take(tokens) for array in self._decimals)
        with np.errstate(invalid="ignore"):  # numbers too large for it are read again below
            value: Numbers = number.astype(np.int64)
        for place in zip(*(form != WHOLE).nonzero(), strict=True):
            word = self.token(int(tokens[place]))
            exact = int(word) if re.fullmatch(INTEGER, word) and len(word) < 30 else 2**63
            if not -(2**63) <= exact < 2**63:
                raise self.error(f"id '{printable(word, 40)}' is not a whole number below 2^63", int(lines[place[-1]]))
            value[place] = exact
        return value

    def numbers(self, tokens: Index, lines: Index, columns: int) -> Array:
        """Correctly rounded numbers of tokens; token k is on ``lines[k // columns]``."""
        value, form = self._decimals
        unread = np.flatnonzero(form[tokens] == UNREAD)
        self._read(tokens[unread], lines[unread // columns])
        return value[tokens]

    def _read(self, tokens: Index, lines: Index) -> None:
        """Numbers of any other form, one by one."""
        if not len(tokens):
            return
        words = [self._bytes[s:e] for s, e in zip(self.starts[tokens], self.ends[tokens], strict=True)]
        good = [NUMBER.fullmatch(word) is not None for word in words]
        if not all(good):
            k = good.index(False)
            comma = re.fullmatch(DECIMAL_COMMA, words[k])
            cure = "; it has a decimal comma: write points, such as by LC_ALL=C of the program that writes the file"
            raise self.error(f"'{printable(words[k], 40)}' is not a number{cure if comma else ''}", int(lines[k]))
        number = np.array(list(map(float, words)))
        if not np.isfinite(number).all():
            k = int(np.argmin(np.isfinite(number)))
            raise self.error(f"'{printable(words[k], 40)}' is beyond the largest number", int(lines[k]))
        self._decimals[0][tokens] = number


def plain_lines(path: str | Path, problem: str) -> tuple[Text, Index, Index, int]:
    """The text of a file, its lines (n,) that are neither blank nor comments, how many words each has, comments.

    Raises
    ------
    GraphFileError
        It cannot be read, or has no such line; `problem` is the message.
    """
    text = Text(read_bytes(path), str(path))
    count = np.diff(text.first)
    lines = np.flatnonzero(count)
    comment = text.characters(text.first[lines], 1)[:, 0] == ord("#")
    lines = lines[~comment]
    if not len(lines):
        raise text.error(f"has {problem}", 0)
    return text, lines, count[lines], int(comment.sum())


def plain_table(path: str | Path, columns: int, expected: str, of: str = "row") -> tuple[Text, Index, Array, int]:
    """The text, its lines (n,), their numbers (n, columns), how many comments.

    Raises
    ------
    GraphFileError
        With the line: another count of words than columns, or a word that is no finite number.
    """
    text, lines, count, comments = plain_lines(path, f"no {of}; expected lines of {columns} numbers: {expected}")
    text.refuse(count != columns, lines, lambda k: f"{count[k]} numbers, expected {columns}: {expected}")
    return text, lines, text.words(lines, 0, columns), comments


def refuse_late(text: Text, lines: Index, times: Array, name: str = "time") -> None:
    """Refuse numbers (n,) of lines (n,) that do not rise.

    Raises
    ------
    GraphFileError
        With the line.
    """

    def late(k: int) -> str:
        before, time = times[k : k + 2].tolist()
        cure = f"sort the rows by {name}" if time < before else "delete one of the two rows"
        return f"{name} {time!r} does not rise over {before!r} before it; {cure}"

    text.refuse(times[1:] <= times[:-1], lines[1:], late)
