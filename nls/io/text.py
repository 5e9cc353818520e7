"""Lines, tags and numbers of a text file by whole-array operations: lines are split, never looped over in Python.

A number of the plain form (sign, digits, one point) whose digits make an integer below 2^52 is that integer divided by
a power of ten, which is correctly rounded (W. Clinger, "How to read floating point numbers accurately", 1990). Numbers
of one length are read together, a column of characters at a time: 15 ms for the 270,000 numbers of city10000, where
float() takes 70. Every other token is matched against the grammar of a decimal number first, because Python's own
float() also takes "nan", "1_0" and the digits of other scripts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property

import numpy as np
import numpy.typing as npt

from models.algebra import Array
from models.errors import GraphFileError

__all__ = ["Text", "printable", "rows"]

Index = npt.NDArray[np.intp]

NUMBER = re.compile(rb"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
WHOLE = re.compile(rb"[+-]?[0-9]+")
FEW, SHORT = 16, 64  # first words of a format: how many, how long
LONGEST = 17  # characters of a token read by columns: at most 16 digits, below 10^16
POWERS = 10.0 ** np.arange(LONGEST + 1)
EXACT = 2.0**52  # integers up to here are exact, and so is the floor of their rounded quotient by a power of ten


def printable(word: bytes) -> str:
    """Bytes of a file as text for a message, whatever their encoding."""
    return word.decode("utf-8", "backslashreplace")


def rows(tag: str, words: Sequence[Iterable[str]], numbers: Array, digits: Callable[[float], str] = repr) -> list[str]:
    """Lines to write: the tag, n words per column of words, then the rows of numbers (n, k).

    ``digits`` writes a number; the shortest that read back as the same one unless told otherwise.
    """
    lines = zip(zip(*words, strict=True), numbers.tolist(), strict=True)
    return [f"{tag} {' '.join(word)} {' '.join(map(digits, row))}" for word, row in lines]


class Text:
    """The tokens of a text file.

    Parameters
    ----------
    data : the bytes.
    path : for messages.

    Attributes
    ----------
    starts, ends : (T,) where every token begins and ends.
    first : (lines + 1,) index of the first token of every line.
    """

    def __init__(self, data: bytes, path: str = "<text>") -> None:
        self.data, self.path = data, path
        buffer = np.frombuffer(b"\n" + data + b"\n", dtype=np.uint8)
        self._buffer = buffer
        blank = (buffer == 32) | ((buffer >= 9) & (buffer <= 13))
        edges = np.flatnonzero(blank[1:] != blank[:-1]) + 1  # tokens and blanks alternate; the buffer begins blank
        self.starts, self.ends = edges[0::2], edges[1::2]
        self._newlines = np.flatnonzero(buffer == 10)
        self.first = np.searchsorted(self.starts, self._newlines)

    def token(self, index: int) -> bytes:
        """One token."""
        return self._buffer[self.starts[index] : self.ends[index]].tobytes()

    def line(self, line: int) -> bytes:
        """One line, counted from 0, without its newline."""
        return self.data[self._newlines[line] : self._newlines[line + 1] - 1]

    def error(self, message: str, line: int) -> GraphFileError:
        """An error at a line counted from 0."""
        return GraphFileError(message, self.path, line + 1, printable(self.line(line).strip()))

    @cached_property
    def tags(self) -> dict[bytes, Index]:
        """First word of every line that has one, with its lines (from 0), in order of first appearance."""
        count = np.diff(self.first)
        lines = np.flatnonzero(count > 0)
        heads = self.first[lines]
        length = self.ends[heads] - self.starts[heads]
        found: dict[bytes, Index] = {}
        while len(lines) and len(found) < FEW and length[0] <= SHORT:
            tag = self.token(int(heads[0]))
            same = length == len(tag)
            window = self.starts[heads[same]][:, None] + np.arange(len(tag))
            same[same] = (self._buffer[window] == np.frombuffer(tag, dtype=np.uint8)).all(axis=1)
            found[tag] = lines[same]
            lines, heads, length = lines[~same], heads[~same], length[~same]
        rest: dict[bytes, list[int]] = {}  # a file of many or long first words is no graph: one look at each line
        for line, head in zip(lines.tolist(), heads.tolist(), strict=True):
            rest.setdefault(self.token(head), []).append(line)
        found |= {tag: np.array(same, dtype=np.intp) for tag, same in rest.items()}
        return found

    def characters(self, tokens: Index, width: int) -> npt.NDArray[np.uint8]:
        """The first bytes of tokens, (n, width), zeros behind their ends."""
        starts, ends = self.starts[tokens][:, None], self.ends[tokens][:, None]
        places = starts + np.arange(width)
        return np.where(places < ends, self._buffer[np.minimum(places, ends - 1)], np.uint8(0))

    def table(self, lines: Index, columns: int, what: str) -> Array:
        """The numbers after the first word of these lines, (n, columns).

        Raises
        ------
        GraphFileError
            A line with another count of numbers, or a word that is no finite number.
        """
        count = self.first[lines + 1] - self.first[lines] - 1
        if (wrong := count != columns).any():
            k = int(np.argmax(wrong))
            raise self.error(f"{count[k]} numbers after the tag, expected {columns}: {what}", int(lines[k]))
        tokens = (self.first[lines] + 1)[:, None] + np.arange(columns)
        return self.numbers(tokens.reshape(-1), lines, columns).reshape(len(lines), columns)

    def whole(self, lines: Index, column: int | Index) -> npt.NDArray[np.int64]:
        """Whole numbers of one column per line (1 is the first after the tag): ids, exact up to 2^63 - 1.

        Raises
        ------
        GraphFileError
            A word that is no whole number, or too large.
        """
        tokens = self.first[lines] + column
        number, plain, pointed = self._by_columns(tokens)
        plain &= ~pointed
        value = np.where(plain, number, 0.0).astype(np.int64)
        for k in np.flatnonzero(~plain):
            word = self.token(int(tokens[k]))
            exact = int(word) if WHOLE.fullmatch(word) and len(word) < 30 else 2**63
            if not -(2**63) <= exact < 2**63:
                raise self.error(f"id {printable(word)[:40]!r} is not a whole number below 2^63", int(lines[k]))
            value[k] = exact
        return value

    def numbers(self, tokens: Index, lines: Index, columns: int) -> Array:
        """Correctly rounded numbers of tokens; token k is on ``lines[k // columns]``."""
        value, plain, _ = self._by_columns(tokens)
        rest = np.flatnonzero(~plain)
        if len(rest):
            words = [
                self._buffer[s:e].tobytes()
                for s, e in zip(self.starts[tokens[rest]], self.ends[tokens[rest]], strict=True)
            ]
            good = [NUMBER.fullmatch(word) is not None for word in words]
            if not all(good):
                k = good.index(False)
                raise self.error(f"{printable(words[k])[:40]!r} is not a number", int(lines[rest[k] // columns]))
            value[rest] = np.fromiter(map(float, words), dtype=float, count=len(words))
            if not np.isfinite(value[rest]).all():
                k = int(np.argmax(~np.isfinite(value[rest])))
                raise self.error(
                    f"{printable(words[k])[:40]!r} is beyond the largest number", int(lines[rest[k] // columns])
                )
        return value

    def _by_columns(self, tokens: Index) -> tuple[Array, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Numbers of the plain form, which tokens have it, and which have a point."""
        starts = self.starts[tokens]
        lengths = self.ends[tokens] - starts
        value = np.zeros(len(tokens))
        plain, pointed = np.zeros(len(tokens), dtype=bool), np.zeros(len(tokens), dtype=bool)
        order = np.argsort(np.minimum(lengths, LONGEST + 1).astype(np.uint8), kind="stable")
        bounds = np.searchsorted(lengths[order], np.arange(1, LONGEST + 2))
        for length in range(1, LONGEST + 1):
            group = order[bounds[length - 1] : bounds[length]]
            if not len(group):
                continue
            windows = np.lib.stride_tricks.sliding_window_view(self._buffer, length)
            characters = windows[starts[group]].T
            digits = np.ascontiguousarray(characters) - np.uint8(48)  # wraps: "." is 254, "-" is 253
            negative = digits[0] == 253
            digits[0][negative] = 0
            point = digits == 254
            points = point.sum(axis=0, dtype=np.uint8)
            digits[point] = 0
            fine = (digits <= 9).all(axis=0) & (points <= 1) & (length - negative - points >= 1)
            total = digits[0].astype(float)
            for row in digits[1:]:
                total *= 10.0
                total += row
            fine &= total <= EXACT
            if points.any():  # the point was read as a digit 0: take it out, all in exact integers
                after = np.where(points > 0, length - 1 - np.argmax(point, axis=0), 0)  # digits behind the point
                scale = POWERS[after]
                whole_part = np.floor(total / (10.0 * scale))
                total = np.where(points > 0, (total - 9.0 * scale * whole_part) / scale, total)
            value[group] = np.where(negative, -total, total)
            plain[group], pointed[group] = fine, points > 0
        return value, plain, pointed
