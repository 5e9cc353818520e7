"""Numbers in words of eight characters: read to the bit where they are read, and left to others where they are not."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from nls.io import decimals as module
from nls.io import text as text_module
from nls.io.decimals import FRACTION, MARKS, PAD, UNREAD, WHOLE, decimals
from nls.io.lines import among
from nls.io.text import Text


def read(words: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Numbers and forms of the words, one blank between."""
    data = [word.encode() for word in words]
    lengths = np.array([len(word) for word in data])
    ends = PAD + np.cumsum(lengths + 1) - 1
    return decimals((b" " * PAD + b" ".join(data)).translate(MARKS), ends - lengths, ends)


SIGNS = ("", "-", "+")


def plain_words() -> list[str]:
    """Every length and place of the point up to 16 characters, with digits next to each other in the same words."""
    rng = np.random.default_rng(11)
    words = []
    for length in range(1, 17):
        for point in range(-1, length):
            digits = "".join(map(str, rng.integers(0, 10, length)))
            word = digits if point < 0 else f"{digits[:point]}.{digits[point + 1 :]}"
            if word != "." and int(word.replace(".", "")) <= 2**53:
                words += [sign + word for sign in SIGNS]
    return words


def test_all_lengths_and_points_are_read_here_and_to_the_bit() -> None:
    words = plain_words()
    value, form = read(words)
    expected = np.array([float(word) for word in words])
    assert len(words) > 400
    assert (value.view(np.int64) == expected.view(np.int64)).all()
    assert form.tolist() == [FRACTION if "." in word else WHOLE for word in words]


def test_exponents_are_read_here_and_to_the_bit() -> None:
    mantissas = ("1", "8.5017", "-3.25", "0.000123456", "+12345678.", ".5", "123456789.012345", "-0.0")
    words = [f"{m}{e}{s}{x:02d}" for m, e, s, x in itertools.product(mantissas, "eE", "+-", (0, 1, 5, 6, 13))]
    value, form = read(words)
    expected = np.array([float(word) for word in words])
    assert (value.view(np.int64) == expected.view(np.int64)).all()
    assert (form == FRACTION).all()


SYNTAX = """- + . -. 1.2.3 1..2 --1 +-1 1-2 12345678.1234567.1 12.4567812.45678 e-05 .e-05 -.e-05 1e-5 1e-0x 1e-0. 1e-x5
1e-.5 1ex05 1e005 1e.05 1-05 1e-23 1e+23 1.2.3e-05 9007199254740993 99999999999999999 0.123456789012345 nan x 1x x1 1/2
12&5 1,5"""


def test_words_that_are_not_read_here() -> None:
    for word in (*SYNTAX.split(), "", "\xa0", "\u0661", "1\x1e2", "1\x102", "\x00", "1\x00"):
        value, form = read(["12345678.9", word, "87654321"])
        assert form.tolist() == [FRACTION, UNREAD, WHOLE], word
        assert value[[0, 2]].tolist() == [12345678.9, 87654321.0]


LINES = b"VERTEX 1 0.5 -2e-05\nE 1 2 12345678.25 7\n\n# remark 1\nVERTEX 2 1.5 9007199254740993\nE 2 1 -0 .5\n" * 3


def test_blocks_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Text(LINES)
    for size in (1, 2, 7, 16, len(LINES) + PAD, len(LINES) + PAD + 1):
        monkeypatch.setattr(module, "BLOCK", size)
        monkeypatch.setattr(text_module, "BLOCK", size)
        text = Text(LINES)
        assert text.starts.tolist() == whole.starts.tolist()
        assert text.first.tolist() == whole.first.tolist()
        for tag, columns in ((b"VERTEX", 3), (b"E", 4)):
            lines = text.tags[tag]
            assert text.table(lines, columns, "").tolist() == whole.table(lines, columns, "").tolist()


def test_lines_in_one_piece_and_apart_are_the_same() -> None:
    rows = [b"T %d %.3f 1e-300 0.12345678901234567 %d" % (k, k / 7, 2**53 + k) for k in range(9)]
    together, apart = Text(b"\n".join(rows)), Text(b"\nother x y\n".join(rows))
    expected = [[float(word) for word in row.split()[1:]] for row in rows]
    for text in (together, apart):
        assert text.table(text.tags[b"T"], 5, "").tolist() == expected
        assert text.whole(text.tags[b"T"], 5).tolist() == [2**53 + k for k in range(9)]


def test_among() -> None:
    numbers = np.array([[-(2**63), -8, -7, 0], [3, 4, 6, 2**63 - 1]])
    for known in ([], [3], [3, 4, 5], [-7, 0, 9], [-(2**63), 2**63 - 1], [-(2**63), -(2**63) + 1]):
        expected = [[n in known for n in row] for row in numbers]
        assert among(numbers, np.array(known, dtype=np.int64)).tolist() == expected
