"""Lines of numbers without tags, blanks between, comments that begin with #: trajectories and logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from models.algebra import Array, Index
from nls.io.files import read_bytes
from nls.io.text import Text


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
    tokens = text.first[lines][:, None] + np.arange(columns)
    return text, lines, text.numbers(tokens.reshape(-1), lines, columns).reshape(-1, columns), comments


def refuse_late(text: Text, lines: Index, times: Array) -> None:
    """Refuse times (n,) of lines (n,) that do not rise.

    Raises
    ------
    GraphFileError
        With the line.
    """
    late, t = times[1:] <= times[:-1], times
    text.refuse(late, lines[1:], lambda k: f"time {float(t[k + 1])!r} does not rise over {float(t[k])!r} before it")
