"""Numbers in words of eight characters: read to the bit where they are read, and left to others where they are not."""

from __future__ import annotations

import itertools
import math
from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from nls.io import decimals as module
from nls.io import text as text_module
from nls.io.decimals import MARKS, PAD, UNREAD, WHOLE, decimals
from nls.io.records import among
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
    assert form.tolist() == [2 if "." in word else WHOLE for word in words]


def read_to_the_bit(words: list[str]) -> np.ndarray:
    """The forms of the words; what is read has the bits of float()."""
    value, form = read(words)
    expected = np.array([float(word) for word in words])
    bits = [(word, x) for word, x, y, f in zip(words, value, expected, form, strict=True) if f and x.hex() != y.hex()]
    assert not bits
    return form


def test_exponents_are_read_here_and_to_the_bit() -> None:
    mantissas = ("1", "8.5017", "-3.25", "0.000123456", "+12345678.", ".5", "123456789.012345", "-0.10000000000000001")
    exponents = (0, 1, 5, 6, 13, 22, 32)
    words = [f"{m}{e}{s}{x:02d}" for m, e, s, x in itertools.product(mantissas, "eE", "+-", exponents)]
    assert (read_to_the_bit(words) == 2).all()


@pytest.mark.parametrize("form", [".17g", ".16e", ".17f", "r"])
def test_numbers_of_all_digits_are_read_here_and_to_the_bit(form: str) -> None:
    numbers = np.random.default_rng(3).normal(size=3000) * 10.0 ** np.random.default_rng(4).integers(-5, 3, 3000)
    words = [repr(x) if form == "r" else format(x, form) for x in numbers.tolist()]
    assert (read_to_the_bit(words) == 2).mean() > 0.98
    assert max(map(len, words)) >= 22


def test_long_numbers_with_the_point_anywhere() -> None:
    """Three words: 17 to 24 characters, so many digits that fit 64 bits, zeros in front of others."""
    rng, words = np.random.default_rng(12), list[str]()
    for length in range(17, 25):
        for point in range(-1, length):
            digits = "0" * (length - 18) + "".join(map(str, rng.integers(1, 10, min(length, 18))))
            word = digits if point < 0 else f"{digits[:point]}.{digits[point + 1 :]}"
            words += [sign + word for sign in SIGNS]
    form = read_to_the_bit(words)
    assert len(words) > 400
    assert (form == 2).mean() > 0.97
    assert (read(["1." + "0" * 22 + "1", "0" * 24 + "1"])[1] == UNREAD).all()


def test_the_largest_integers_do_not_overflow() -> None:
    largest = 1843 * 10**16
    words = [f"{n + k * 10**p + 1}" for n in (largest, 2**64) for k in range(-9, 10) for p in range(2, 19)]
    words += [word[:k] + "." + word[k:] for word in words for k in (1, 3, 4, 5, 12)]
    form = read_to_the_bit(words)
    assert 0.1 < (form == 2).mean() < 0.3


@given(st.floats(1e-12, 1e20), st.integers(17, 25), st.integers(-2, 2), st.sampled_from(["f", "e"]))
def test_near_the_middle_of_two_numbers(x: float, digits: int, away: int, style: str) -> None:
    """The middle of two neighbors, cut to some digits, and what is one or two of the last digit from there."""
    with localcontext(prec=60):
        middle = (Decimal(x) + Decimal(math.nextafter(x, math.inf))) / 2
        near = Decimal(f"{middle:.{digits - 1}e}")
        unit = Decimal((0, (1,), near.adjusted() - digits + 1))
        words = [format(sign * (near + away * unit), style) for sign in (1, -1)]
    read_to_the_bit([words[0], "7", words[1]])


def test_a_number_in_the_middle_of_two_is_not_decided_here() -> None:
    middles = [str(2 * k + 1) for k in np.random.default_rng(5).integers(2**52, 2**53, 50).tolist()]
    assert not read_to_the_bit(
        [*middles, *(f"{m}.0" for m in middles), *(f"{m[:-3]}.{m[-3:]}e+03" for m in middles)]
    ).any()


LONG = r"[+-]?([0-9]{0,12}\.[0-9]{1,12}|[0-9]{1,24})([eE][+-][0-9]{2})?"


@given(st.lists(st.from_regex(LONG, fullmatch=True).filter(str.isascii), min_size=1, max_size=30))
def test_words_of_every_kind_are_read_to_the_bit_or_not(words: list[str]) -> None:
    read_to_the_bit(words)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=30))
@example([5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, 0.0, -0.0, 2.225073858507201e-308])
def test_numbers_of_every_size_are_read_to_the_bit_or_not(numbers: list[float]) -> None:
    read_to_the_bit([form.format(x) for x in numbers for form in ("{!r}", "{:.17g}", "{:.16e}", "{:.17f}")])


SYNTAX = """- + . -. 1.2.3 1..2 --1 +-1 1-2 12345678.1234567.1 12.4567812.45678 e-05 .e-05 -.e-05 1e-5 1e-0x 1e-0. 1e-x5
1e-.5 1ex05 1e005 1e.05 1-05 1e-51 1e+51 1.2.3e-05 99999999999999999999 1.2345678.12345678901 1.23456789012.45678901
12345678901.34567.901 1234567890123456-8 .......1234567890123456 nan x 1x x1 1/2 12&5 1,5"""


def test_words_that_are_not_read_here() -> None:
    for word in (*SYNTAX.split(), "", "\xa0", "\u0661", "1\x1e2", "1\x102", "\x00", "1\x00"):
        value, form = read(["12345678.9", word, "87654321"])
        assert form.tolist() == [2, UNREAD, WHOLE], word
        assert read([f"-{word}e-05"])[1].tolist() == [UNREAD]
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
